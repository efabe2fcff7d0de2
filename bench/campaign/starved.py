"""A service that shares its processor with busy processes, as on a machine with a load of 25 on two cores.

The simulated vehicle has another processor of its own, so that what falls silent is the service. Every write has to end
verified, and no write may have stopped on the way.
"""

from __future__ import annotations

import asyncio
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from bench.campaign.criteria import Criterion
from bench.campaign.crossed.forked import Forked, ForkedVehicle
from bench.campaign.crossed.plan import OPTIONS
from bench.campaign.judge import Ending, Evidence, judge
from bench.campaign.session import SETTINGS, Session, session
from bench.campaign.tables import table
from bench.campaign.truth import Holding, holding, residuals
from mavcal.service.api.views import job_model
from mavcal.service.jobs.model import Job
from mavcal.service.jobs.states import ENDED, JobState
from mavcal.service.simvehicle import SimulatedVehicle
from mavcal.service.store import SqliteStore

OVER = ENDED | {JobState.REVIEW}
"""Back in review is a write that could not begin."""
Told = Callable[[str], None]

BUSY = 12
"""Busy processes beside the service on its one processor: a load of 13, as 25 is on two."""
SPEED = 4.0
LOOK_S = 0.05
LIMIT_S = 400.0


@dataclass(frozen=True)
class StarvedReport:
    """The outcome of a run."""

    autopilot: str
    ending: Ending
    state: str
    stopped: tuple[str, ...]
    """Why the write stopped on the way, each time."""
    late_s: float
    """The longest time by which the event loop came too late."""
    seconds: float


def run_starved(index: int, seed: int, busy: int = BUSY, told: Told = lambda _: None) -> StarvedReport:
    """One gyro job on a starved processor; `told` hears how far it is. Raises TimeoutError if it does not end."""
    cores = sorted(os.sched_getaffinity(0))
    autopilot = ("ardupilot", "px4")[index % 2]
    parameters = {"INS_GYR_CAL": 0} if autopilot == "ardupilot" else {"IMU_GYRO_CAL_EN": 0}
    config = {"thermal": False, "parameters": parameters}
    began = time.monotonic()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="mavcal-starved-")))
        os.sched_setaffinity(0, cores[-1:])
        sim = ForkedVehicle(autopilot, link="udpout", seed=seed * 1000 + index, speed=SPEED, config=config)
        stack.callback(sim.stop)
        os.sched_setaffinity(0, cores[:1])
        stack.callback(os.sched_setaffinity, 0, cores)
        for _ in range(busy):
            spinning = Forked(_spin)
            stack.callback(spinning.wait)
            stack.callback(spinning.kill)
            stack.callback(spinning.stdout.close)
            stack.callback(spinning.stdin.close)
        before = holding(sim)
        told(f"starved {index} {autopilot}: beside {busy} busy processes")
        job, stopped, late = asyncio.run(_job(folder, sim, lambda text: told(f"starved {index} {autopilot}: {text}")))
        ending = _judged(sim, job, before)
    return StarvedReport(autopilot, ending, job.state.value, stopped, late, time.monotonic() - began)


def _spin() -> int:
    while os.getppid() != 1:
        sum(range(10_000))
    return 0


async def _job(folder: Path, sim: SimulatedVehicle, told: Told) -> tuple[Job, tuple[str, ...], float]:
    late = [0.0]
    settings = replace(SETTINGS, stall_s=60.0)
    store = SqliteStore(folder)
    async with asyncio.timeout(LIMIT_S), session(folder, sim, store, settings=settings) as bench:
        watching = asyncio.create_task(_lateness(late))
        telling = asyncio.create_task(_told_states(bench, told))
        job = await bench.reviewed(sim, "gyro", OPTIONS["gyro"])
        if job.state == JobState.REVIEW:
            await bench.applied(job)
            while (job := bench.engine.get(job.id)).state not in OVER:
                await bench.obeyed(job)
                await asyncio.sleep(LOOK_S)
        watching.cancel()
        telling.cancel()
        stopped = tuple(str(row.data.get("reason")) for row in store.journal(job.id) if row.step == "stopped")
        if job.state == JobState.REVIEW:
            stopped = (*stopped, str(getattr(job.outcome, "cause", "the write did not begin")))
    return job, stopped, late[0]


async def _told_states(bench: Session, told: Told) -> None:
    """Tell every state that the job goes through."""
    began, last = time.monotonic(), ""
    while True:
        for job in bench.engine.list():
            if job.state != last:
                last = job.state
                why = getattr(job.outcome, "cause", "")
                told(f"{last} after {time.monotonic() - began:.0f} s" + (f": {why}" if why else ""))
        await asyncio.sleep(LOOK_S)


async def _lateness(late: list[float]) -> None:
    while True:
        before = time.monotonic()
        await asyncio.sleep(LOOK_S)
        late[0] = max(late[0], time.monotonic() - before - LOOK_S)


def _judged(sim: SimulatedVehicle, job: Job, before: Holding) -> Ending:
    now = holding(sim)
    fitted = [fit.instance for fit in job.results if fit.status != "refused"]
    left = residuals(sim.truth(), now.in_force, job.kind, OPTIONS[job.kind], fitted)
    return judge(Evidence(job_model(job).model_dump(mode="json"), before, now, {}), left)[0]


def starved_table(reports: Sequence[StarvedReport]) -> str:
    """Every run."""
    rows = [
        (r.autopilot, r.ending, "; ".join(r.stopped) or "never", f"{r.late_s:.2f}", f"{r.seconds:.0f}") for r in reports
    ]
    return table(("autopilot", "ending", "the write stopped", "event loop late by at most (s)", "took (s)"), rows)


def of_starved(reports: Sequence[StarvedReport]) -> list[Criterion]:
    """The criterion that starved runs must meet."""
    wrong = sum(report.ending != Ending.VERIFIED or bool(report.stopped) for report in reports)
    text = f"every write of a service beside {BUSY} busy processes on one processor ends verified, without a stop"
    return [Criterion(text, f"{wrong} of {len(reports)} do not", bool(reports) and not wrong)]
