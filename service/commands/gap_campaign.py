"""Runs a campaign: writes cases to files, has child processes diagnose them, and pairs answers with labels."""

from __future__ import annotations

import asyncio
import json
import tempfile
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mavcal.calib.errors import CalibError
from mavcal.calib.withheld_check import AirCase, Case, CaseAnswer, check_of
from mavcal.service.children import DIAGNOSE, Children, Limits
from mavcal.service.errors import ChildEnded

Json = dict[str, Any]

TIMEOUT_S = 300.0
"""Limit for a case of one minute, with room for a busy machine."""
MEMORY_BYTES = 1 << 32
"""Memory limit of a case; more than in a service, so that no case fails for lack of memory."""


@dataclass(frozen=True)
class Diagnoser:
    """Has files diagnosed by processes that see only their random names."""

    children: Children
    limits: Limits

    async def ask(self, order: Mapping[str, Any]) -> Json:
        """``{report, seconds}`` or ``{error, seconds}``: an error in the diagnosis is an answer too.

        `order` is that of :func:`service.children.tasks.diagnose`.
        """
        began = asyncio.get_running_loop().time()
        try:
            done = await self.children.run(DIAGNOSE, order, self.limits)
        except (CalibError, ChildEnded) as error:
            spent = asyncio.get_running_loop().time() - began
            return {"error": f"{type(error).__name__}: {error}", "seconds": spent}
        return {"report": done["report"], "seconds": done["seconds"]}


@asynccontextmanager
async def diagnoser(folder: Path, *, processes: int = 1, timeout_s: float = TIMEOUT_S) -> AsyncIterator[Diagnoser]:
    """A diagnoser that keeps what it needs in `folder`, which is its own."""
    children = Children(folder, most=processes)
    try:
        yield Diagnoser(children, Limits(MEMORY_BYTES, timeout_s, timeout_s))
    finally:
        await children.stop()


@dataclass(frozen=True)
class Plan:
    """The cases as (tier, seed) pairs, whether selection is nested in the folds, and the number of processes."""

    cases: Sequence[tuple[str, int]]
    nested: bool
    processes: int


def run(plan: Plan, record: Callable[[Json], None]) -> None:
    """Diagnose every case; `record` gets ``{label, report, error, seconds}``, one at a time, in no order."""
    asyncio.run(_run(plan, record))


async def _run(plan: Plan, record: Callable[[Json], None]) -> None:
    todo = iter(plan.cases)
    with tempfile.TemporaryDirectory(prefix="mavcal-gap-") as made:
        folder = Path(made)
        async with diagnoser(folder / "children", processes=plan.processes) as diagnosing, asyncio.TaskGroup() as group:
            for _ in range(plan.processes):
                group.create_task(_drive(diagnosing, todo, folder, record, nested=plan.nested))


async def _drive(
    diagnosing: Diagnoser,
    todo: Iterator[tuple[str, int]],
    folder: Path,
    record: Callable[[Json], None],
    *,
    nested: bool,
) -> None:
    for tier, seed in todo:
        case = await asyncio.to_thread(check_of(tier).case, tier, seed)
        record(await one(diagnosing, case, folder, nested=nested))


async def one(diagnosing: Diagnoser, case: Case | AirCase, folder: Path, *, nested: bool) -> Json:
    """Label and answer of one case, written to a pair of files and diagnosed.

    A table cannot state the layout of the motors, so the order does.
    """
    paths = {side: folder / f"{case.id}_{side}.npz" for side in ("real", "sim")}
    for side, columns in (("real", case.real), ("sim", case.sim)):
        np.savez(paths[side], allow_pickle=False, **columns)
    parts = {side: {"path": str(path)} for side, path in paths.items()}
    order: Json = {**parts, "nominal": [], "without": list(case.without), "nested": nested, "limit_s": None}
    if isinstance(case, AirCase):
        order["frame"] = case.frame
    answer = await diagnosing.ask(order)
    for path in paths.values():
        path.unlink()
    return {"label": dict(case.label), **answer}


def answers(lines: Iterable[str]) -> list[CaseAnswer]:
    """The recorded answers, one JSON object a line."""
    found = []
    for line in lines:
        row = json.loads(line)
        found.append(CaseAnswer(row["label"], row.get("report") or {}, row.get("error"), float(row["seconds"])))
    return found
