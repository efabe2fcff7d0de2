"""One life of the service in a process of its own that kills itself at a named instant.

``python -m tests.service.jobs_process DATA_DIR URL ACTION POINT OCCURRENCE``. ACTION is ``capture`` (start a gyro job),
``apply`` (accept the plan of the newest job), ``revert`` or ``resume`` (only what the store holds). POINT is one
of :class:`service.jobs.core.crashpoints.At`; at its OCCURRENCE the process gets SIGKILL, as from outside.
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from bench.campaign.cli_process import killer
from mavcal.service.jobs.core.crashpoints import At
from mavcal.service.jobs.core.states import ENDED, JobState

from .jobs_bench import Session, session

LIMIT_S = 60.0


async def live(bench: Session, action: str) -> None:
    await bench.writable()
    if action == "capture":
        await bench.engine.submit(bench.vehicle.id, "gyro", {"uncertainty": 0.02})
    elif action == "apply":
        await bench.accepted(bench.engine.list()[-1])
    elif action == "revert":
        await bench.engine.revert(bench.engine.list()[-1].id)
    job = await bench.until(bench.engine.list()[-1].id, *ENDED, JobState.REVIEW, seconds=LIMIT_S)
    sys.stderr.write(f"{job.state}: {job.outcome} {job.warnings}\n")


async def main(folder: str, url: str, action: str, point: str, occurrence: str) -> None:
    async with session(Path(folder), url, reach=killer(At(point), int(occurrence))) as bench:
        await live(bench, action)


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
