"""Campaigns through uploads: a fit or a diagnosis of each, in a child process with limits."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TypeVar

from mavcal.calib.report import to_json
from mavcal.service.campaigns.campaigns import ItemTurn
from mavcal.service.campaigns.items import ItemEnd, of_diagnosis, of_fits
from mavcal.service.computations import REPORT
from mavcal.service.errors import ChildrenBusy
from mavcal.service.jobs.uploads import MOST_STARTS, Computations

T = TypeVar("T")

_PAUSE_S = 0.5


@dataclass
class UploadWork:
    """Work on each upload in a child process with limits."""

    computations: Computations
    lane: asyncio.Semaphore
    most_starts: int | None = MOST_STARTS

    async def cancelled(self, turn: ItemTurn) -> str:
        """See ItemWork."""
        return "The campaign was cancelled; the computation was ended."


class UploadFits(UploadWork):
    """Fits each upload by one method. Options: `method`, `options`."""

    async def run(self, turn: ItemTurn) -> ItemEnd:
        """See ItemWork."""
        method, options = turn.options["method"], turn.options["options"]
        fits = await _patiently(lambda: self.computations.fit(turn.item.subject, method, options))
        return of_fits(to_json(fits), method)


class UploadGaps(UploadWork):
    """A diagnosis of each upload against the same simulation. Options: `sim`, `nominal`."""

    async def run(self, turn: ItemTurn) -> ItemEnd:
        """See ItemWork."""
        sim, nominal = turn.options["sim"], turn.options["nominal"]
        found = await _patiently(lambda: self.computations.diagnose(turn.item.subject, sim, nominal))
        report = json.loads(next(d.body for d in found.documents if d.name == REPORT))
        return of_diagnosis(turn.item, found.summary, report, found.documents)


async def _patiently(compute: Callable[[], Awaitable[T]]) -> T:
    """Retry while the children are busy: no client waits for an item."""
    while True:
        try:
            return await compute()
        except ChildrenBusy:
            await asyncio.sleep(_PAUSE_S)
