"""A link that stays open goes on in another telemetry log now and then, so that old ones can be forgotten."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import structlog

from mavcal.service.errors import StoreError
from mavcal.service.link import Link
from mavcal.service.settings import RetentionSettings

log = structlog.get_logger(__name__)

PERIOD_S = 10.0
HOUR_S = 3600.0


@dataclass
class Rotation:
    """Looks at the open links; `rotated` is called when one has begun another file.

    A capture and the window of a check keep their link's file until they end: a segment of a job lies in one file.
    """

    links: Callable[[], Iterable[Link]]
    settings: RetentionSettings
    rotated: Callable[[], None]
    clock: Callable[[], float] = time.monotonic

    async def run(self) -> None:
        """Check the links at intervals, until cancelled."""
        while True:
            await asyncio.sleep(PERIOD_S)
            self.look()

    def look(self) -> None:
        """Have every link whose file is large or old enough go on in another one."""
        for link in self.links():
            if not self._due(link):
                continue
            try:
                begun = link.rotate()
            except StoreError as error:  # it goes on in the old one, and is asked again
                log.warning("no other telemetry log could be begun", link=link.id, reason=str(error))
                continue
            if begun:
                log.info("telemetry log begun", link=link.id, path=str(link.tlog.path))
                self.rotated()

    def _due(self, link: Link) -> bool:
        """Whether the file is large or old enough to be closed; an empty one never is."""
        held = link.tlog
        old = self.clock() - held.begun_at >= self.settings.tlog_hours * HOUR_S
        return held.position > 0 and (old or held.position >= self.settings.tlog_bytes)
