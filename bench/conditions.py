"""Rates reached and job times where streams begin late, our own process starves, or a link carries or loses much.

Part of ``python -m bench.slowlink --conditions``.
"""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mavcal.calib.wire import iter_tlog
from mavcal.service.core import Service, running_service
from mavcal.service.jobs.digest import read_range
from mavcal.service.jobs.model import Job
from mavcal.service.jobs.states import ENDED, JobState
from mavcal.service.settings import Settings
from mavcal.service.simvehicle import SimulatedVehicle
from mavcal.service.store.rows import SegmentPurpose
from mavcal.service.vehicle.boot_time import own_time

PARAMETERS = 1348
"""An ArduCopter 4.7 lists so many (FLIGHT_CONTROLLERS 9)."""
REST_LIMIT_S = 15.0
SLOW_LIMIT_S = 60.0
GIVE_UP_S = 300.0
SAMPLES = (26, 27, 116, 129)
TURN_S = 0.5
_STARVE = """
import os, select, signal, sys
pid, awake, asleep = int(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3])
try:
    while not select.select([sys.stdin], [], [], awake)[0]:
        os.kill(pid, signal.SIGSTOP)
        over = select.select([sys.stdin], [], [], asleep)[0]
        os.kill(pid, signal.SIGCONT)
        if over:
            break
finally:
    os.kill(pid, signal.SIGCONT)
"""


@dataclass(frozen=True)
class Condition:
    """What stands between a vehicle and us, and how long a gyro job may take to its plan."""

    name: str
    limit_s: float = REST_LIMIT_S
    config: dict[str, Any] = field(default_factory=dict)
    faults: tuple[dict[str, Any], ...] = ()
    share: float = 1.0
    """What our own process gets of a core, at most."""


def _port(baud: int) -> tuple[dict[str, Any], ...]:
    return ({"kind": "throttle", "bytes_per_s": baud / 10, "buffer_bytes": 8192.0},)


CONDITIONS = (
    *(Condition(f"streams begin {late:g} s late", config={"stream_start_s": late}) for late in (0.0, 1.0, 2.0, 3.0)),
    Condition("20 % of a core", share=0.2),
    Condition("20 % of a core, 1 s late", config={"stream_start_s": 1.0}, share=0.2),
    Condition("57600 baud", SLOW_LIMIT_S, faults=_port(57600)),
    Condition("115200 baud", SLOW_LIMIT_S, faults=_port(115200)),
    Condition("15 % lost", SLOW_LIMIT_S, faults=({"kind": "loss", "p": 0.15},)),
)


@dataclass(frozen=True)
class Reached:
    """What a job had of its vehicle under one condition."""

    condition: Condition
    autopilot: str
    kind: str
    state: JobState
    rate_hz: float
    """The slowest inertial or compass stream's, by the vehicle's stamps."""
    asking_s: float
    """From the beginning of the job until its capture began."""
    total_s: float
    """Until its plan was there."""
    said: str
    """What the job said of the link."""

    @property
    def good(self) -> bool:
        """Whether there is a plan in time."""
        return self.state is JobState.REVIEW and (self.kind != "gyro" or self.total_s <= self.condition.limit_s)


@contextmanager
def starved(share: float) -> Iterator[None]:
    """This process runs in this share of the time only, in turns of half a second."""
    if share >= 1:
        yield
        return
    command = [sys.executable, "-c", _STARVE, str(os.getpid()), str(share * TURN_S), str((1 - share) * TURN_S)]
    with subprocess.Popen(command, stdin=subprocess.PIPE):
        yield  # Popen's end closes its standard input, which ends it, and waits


async def reached(condition: Condition, autopilot: str, kind: str, *, seed: int = 3) -> Reached:
    """Run one job up to its plan."""
    kept = {"INS_GYR_CAL": 0} if autopilot == "ardupilot" else {"IMU_GYRO_CAL_EN": 0}
    config = {"thermal": False, "parameters": kept, "further_parameters": _further(autopilot), **condition.config}
    with (
        tempfile.TemporaryDirectory(prefix="mavcal-slowlink-") as folder,
        SimulatedVehicle(autopilot, seed=seed, config=config) as sim,
    ):
        sim.call("still") if kind == "gyro" else sim.call("script", name="tumble")
        for fault in condition.faults:
            sim.call("fault", **fault)
        async with running_service(Settings(data_dir=Path(folder), connect=(sim.url,))) as service:
            async with asyncio.timeout(GIVE_UP_S):
                vehicle = await service.vehicles.wait_for_vehicle(service.links.all()[0])
                while (now := vehicle.state.boot_time) is None or now < _started_s(autopilot):  # noqa: ASYNC110
                    await asyncio.sleep(0.05)
                with starved(condition.share):
                    began = time.time()
                    job = await service.jobs.submit(vehicle.id, kind)
                    while (job := service.jobs.get(job.id)).state not in ENDED | {JobState.REVIEW}:  # noqa: ASYNC110
                        await asyncio.sleep(0.05)
                    total_s = time.time() - began
            return _told(service, job, condition, autopilot, began, total_s)


def _further(autopilot: str) -> int:
    with SimulatedVehicle(autopilot) as sim:
        return PARAMETERS - len(sim.call("parameters")["stored"])


def _started_s(autopilot: str) -> float:
    """A PX4 calibrates its gyros by itself until then: that is not the link's time."""
    return 10.5 if autopilot == "px4" else 1.0


def _told(service: Service, job: Job, condition: Condition, autopilot: str, began: float, total_s: float) -> Reached:
    rows = [row for row in service.store.segments(job.id, SegmentPurpose.CAPTURE) if row.end_byte is not None]
    stamps: dict[int, list[float]] = {}
    first = 0.0
    for row in rows:
        for at, frame in iter_tlog(read_range(row.path, row.start_byte, row.end_byte)):
            first = first or at / 1e6
            if frame.message_id in SAMPLES and (stamp := own_time(frame)) is not None:
                stamps.setdefault(frame.message_id, []).append(stamp)
    rates = [(len(t) - 1) / (t[-1] - t[0]) for t in stamps.values() if len(t) > 2 and t[-1] > t[0]]
    said = "; ".join(text for text in job.warnings if "link" in text)
    asking_s = max(first - began, 0.0) if first else total_s
    return Reached(condition, autopilot, job.kind, job.state, min(rates, default=0.0), asking_s, total_s, said)


def table(runs: Sequence[Reached]) -> str:
    """One row a condition and kind of job, as Markdown."""
    head = ["condition", "job"]
    autopilots = list(dict.fromkeys(run.autopilot for run in runs))
    for name in autopilots:
        head += [f"{name}: Hz", "s until the capture", "s until the plan"]
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    cells = {(run.condition.name, run.kind, run.autopilot): run for run in runs}
    for condition, kind in dict.fromkeys((run.condition.name, run.kind) for run in runs):
        row = [condition, kind]
        for name in autopilots:
            run = cells.get((condition, kind, name))
            row += ["–"] * 3 if run is None else [f"{run.rate_hz:.0f}", f"{run.asking_s:.1f}", f"{run.total_s:.1f}"]
        lines.append("| " + " | ".join(row) + " |")
    return "\n".join(lines)


def run(autopilots: Sequence[str], kinds: Sequence[str], conditions: Sequence[Condition]) -> list[Reached]:
    """All of them, one after the other; each is printed as it ends."""
    runs = []
    for kind in kinds:
        for condition in conditions:
            for autopilot in autopilots:
                runs.append(asyncio.run(reached(condition, autopilot, kind)))
                print(f"{autopilot}, {condition.name}, {kind}: {runs[-1].total_s:.1f} s", file=sys.stderr)
    return runs


def main(autopilots: Sequence[str], kinds: Sequence[str]) -> int:
    """Print the table; 1: a job was not done in time."""
    runs = run(autopilots, kinds, CONDITIONS)
    print(table(runs))
    for one in runs:
        if one.said or not one.good:
            print(f"{one.autopilot}, {one.condition.name}, {one.kind}: {one.state.value}; {one.said}")
    return int(not all(one.good for one in runs))
