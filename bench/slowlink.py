"""``python -m bench.slowlink``: where the time of a gyro job goes on a slow link, from the first byte to the proof.

A simulated vehicle has as many parameters as a real one. It speaks in real time, through a port of 57600 baud and
through one that carries 5 kB/s and loses 2 % of all frames in both directions. Every phase is taken from the job's own
events and journal. Exit code 1: a job did not succeed, or took longer than it may.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.rows import grid
from mavcal.service.core import Service, running_service
from mavcal.service.jobs.core.model import Accept, Job
from mavcal.service.jobs.core.states import ENDED, JobState
from mavcal.service.settings import Settings
from mavcal.service.simvehicle import SimulatedVehicle
from mavcal.service.store.rows import EventRow, SnapshotPurpose
from tests.vehicles import first_vehicle

LIMIT_S = 60.0
GIVE_UP_S = 900.0
FURTHER = 700
"""With these the simulated vehicle lists more than 900 parameters."""


PHASES = (
    "finding the vehicle",
    "waiting for its start",
    "to the first prompt",
    "capture, read again, fit",
    "accept: plan against vehicle",
    "before the first parameter",
    "writing",
    "read-back",
    "restart",
    "read-back after the restart",
    "proof",
    "message rates back",
)


@dataclass(frozen=True)
class Wire:
    """A link: what it carries, what it loses, and how long a gyro job may take on it."""

    name: str
    bytes_per_s: float
    loss: float
    buffer_bytes: float
    """What waits in the vehicle's port before streams are held back; a real one was seen to hold more than a second."""
    limit_s: float | None


WIRES = (
    Wire("57600 baud", 5760.0, 0.0, 8192.0, LIMIT_S),
    Wire("5 kB/s, 2 % lost", 5000.0, 0.02, 2048.0, None),
)


@dataclass(frozen=True)
class Timed:
    """One job: how it ended, and the seconds of each phase in order."""

    wire: Wire
    autopilot: str
    state: str
    outcome: str
    phases: tuple[tuple[str, float], ...]
    longest_silence_s: float
    """The longest time in which the job said nothing."""
    parameters: int = 0
    """How many the plan rests on."""
    told: tuple[str, ...] = ()
    """What the progress said, in order."""

    @property
    def total_s(self) -> float:
        """From opening the link to the end."""
        return sum(seconds for _, seconds in self.phases)

    @property
    def good(self) -> bool:
        """Whether it succeeded in time."""
        return self.state == JobState.SUCCEEDED and (self.wire.limit_s is None or self.total_s <= self.wire.limit_s)


def throttled(sim: SimulatedVehicle, wire: Wire, speed: float = 1.0) -> None:
    """Put this wire between the vehicle and everybody else."""
    sim.call("fault", kind="throttle", bytes_per_s=wire.bytes_per_s * speed, buffer_bytes=wire.buffer_bytes)
    if wire.loss:
        sim.call("fault", kind="loss", p=wire.loss)


async def timed(wire: Wire, autopilot: str, *, speed: float = 1.0, further: int = FURTHER, seed: int = 3) -> Timed:
    """Run one gyro job with its write and proof. `speed` makes vehicle and wire faster alike."""
    parameters = {"INS_GYR_CAL": 0} if autopilot == "ardupilot" else {"IMU_GYRO_CAL_EN": 0}
    config = {"thermal": False, "parameters": parameters, "further_parameters": further}
    with (
        tempfile.TemporaryDirectory(prefix="mavcal-slowlink-") as folder,
        SimulatedVehicle(autopilot, seed=seed, speed=speed, config=config) as sim,
    ):
        sim.call("still")
        throttled(sim, wire, speed)
        settings = Settings(data_dir=Path(folder), connect=(sim.url,))
        began = time.time()
        async with running_service(settings) as service:
            heard: list[EventRow] = []
            listening = asyncio.create_task(_listen(service, heard))
            job = await _carried(service)
            await asyncio.wait_for(service.jobs.wait_for_cleanup(), GIVE_UP_S)
            listening.cancel()
            return _measured(service, job, heard, wire, autopilot, began)


async def _listen(service: Service, heard: list[EventRow]) -> None:
    """Keep every event: those of progress are dropped at a job's end."""
    async for event in service.jobs.subscribe():
        heard.append(event)


async def _carried(service: Service) -> Job:
    (link,) = service.links.all()
    async with asyncio.timeout(GIVE_UP_S):
        vehicle = await first_vehicle(service.vehicles, link)
        job = await service.jobs.submit(vehicle.id, "gyro")
        job = await _until(service, job.id)
        if job.state is not JobState.REVIEW or job.plan is None:
            return job
        while not vehicle.writable().ok:  # noqa: ASYNC110 - time alone changes it
            await asyncio.sleep(0.05)
        await service.jobs.apply(job.id, Accept(job.plan.sha256, reboot=True, prove_s=0.0))
        return await _until(service, job.id)


async def _until(service: Service, job_id: str) -> Job:
    while (job := service.jobs.get(job_id)).state not in ENDED | {JobState.REVIEW}:  # noqa: ASYNC110 - a bench
        await asyncio.sleep(0.05)
    return job


def _measured(
    service: Service, job: Job, events: Sequence[EventRow], wire: Wire, autopilot: str, began: float
) -> Timed:
    """Cut the time at what the job has written down."""
    ended = time.time()
    states = {e.data["state"]: e.at for e in events if e.kind == "state"}
    first: dict[str, float] = {}
    last: dict[str, float] = {}
    for row in service.store.journal(job.id):
        first.setdefault(row.step, row.at)
        last[row.step] = row.at
    marks = (
        job.created_at,
        _up_at(events),
        next((e.at for e in events if e.kind == "prompt" and _asks(e)), None),
        states.get("review"),
        first.get("accepted"),
        first.get("send"),
        last.get("echo"),
        first.get("read_back"),
        first.get("rebooted"),
        last.get("read_back") if "rebooted" in first else None,
        last.get("verified"),
        ended,
    )
    phases, at = [], began
    for name, mark in zip(PHASES, marks, strict=True):
        if mark is not None and mark >= at:
            phases.append((name, mark - at))
            at = mark
    said = [began, *(e.at for e in events), ended]
    silence = max(b - a for a, b in itertools.pairwise(said))
    outcome = "" if job.outcome is None else str(job.outcome)
    kept = service.store.snapshot(job.id, SnapshotPurpose.COMPOSED_ON)
    return Timed(
        wire,
        autopilot,
        job.state.value,
        outcome,
        tuple(phases),
        silence,
        0 if kept is None else len(kept.body),
        tuple(e.data["text"] for e in events if e.kind == "progress"),
    )


def _asks(event: EventRow) -> bool:
    """Whether a prompt is the procedure's: one that waits for the vehicle's own start asks nothing."""
    return bool(event.data) and event.data["step"] != "busy"


def _up_at(events: Sequence[EventRow]) -> float | None:
    """When the vehicle had been up for long enough, where that was waited for."""
    prompts = [e for e in events if e.kind == "prompt"]
    if not prompts or _asks(prompts[0]):
        return None
    return next((e.at for e in prompts if not e.data), None)


def table(runs: Sequence[Timed]) -> str:
    """Seconds by phase, one column a run, as Markdown."""
    rows: list[tuple[str, ...]] = []
    for name in PHASES:
        seconds = [dict(run.phases).get(name) for run in runs]
        if any(seconds):
            rows.append((name, *("-" if s is None else f"{s:.1f}" for s in seconds)))
    rows.append(("**total**", *(f"**{run.total_s:.1f}**" for run in runs)))
    rows.append(("longest silence", *(f"{run.longest_silence_s:.1f}" for run in runs)))
    rows.append(("ended", *(f"{run.state} {run.outcome}" if not run.good else run.state for run in runs)))
    return grid(("seconds", *(f"{run.autopilot}, {run.wire.name}" for run in runs)), rows)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.slowlink", description=__doc__)
    parser.add_argument("--autopilot", choices=("ardupilot", "px4"), action="append", default=None)
    parser.add_argument("--wire", type=int, choices=range(len(WIRES)), action="append", default=None)
    args = parser.parse_args(argv)
    wires = [WIRES[i] for i in (args.wire if args.wire is not None else range(len(WIRES)))]
    runs = [asyncio.run(timed(wire, name)) for name in args.autopilot or ("ardupilot", "px4") for wire in wires]
    print(table(runs))
    return int(not all(run.good for run in runs))


if __name__ == "__main__":
    sys.exit(main())
