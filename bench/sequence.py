"""``python -m bench.sequence``: every calibration in a row, as a person makes them, on both simulated autopilots.

Each vehicle has two inertial units and two compasses, and its board is turned by yaw 90 deg. Its external compass is
mounted otherwise than its parameters say. `--vehicle` chooses how it starts: with an older calibration in force
(earlier), with the firmware's factory defaults (factory), or just started and with late streams (late). Each job builds
on what the one before has written; `--rounds 2` does all of them twice. After each round the vehicle is restarted and
must hold what was written. Exit code 1: an outcome is neither proved nor tells its reason, a job did not succeed, or a
value was lost.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from bench.campaign.session import Session, session
from bench.rows import grid
from mavcal.calib.firmware.plan import ProofVerdict, SensorVerdict, Verification
from mavcal.service.jobs.core.model import Failure, Job
from mavcal.service.jobs.core.states import ENDED, JobState
from mavcal.service.simvehicle import Operator, SimulatedVehicle

Json = dict[str, Any]

AUTOPILOTS: Final = ("ardupilot", "px4")
KINDS: Final = ("gyro", "accel", "level", "mag", "thermal")
SPEED: Final = 20.0
WRITING_SPEED: Final = 4.0
"""Vehicle seconds per wall second: while parameters are written, the wall's delays must not look like hours."""
START_C, END_C, SPAN_C, PROOF_C = 22.0, 75.0, 48.0, 60.0
SAVED_S, BOOT_S = 5.0, 10.0
AGAIN: Final = 2
"""How often a plan is made again where PX4 has calibrated its gyroscopes meanwhile, as the job then asks for."""
"""Seconds of the vehicle's clock until PX4 has saved, and until it has started."""
OPTIONS: Final[Mapping[str, Json]] = MappingProxyType({"thermal": {"span": SPAN_C}})
DECISIONS: Final[Mapping[str, Json]] = MappingProxyType({"mag": {"confirm_mounting": True}})
"""What the operator has looked at: the external compass is mounted otherwise than stated."""
SETTINGS: Final[Mapping[str, Json]] = MappingProxyType({"ardupilot": {"INS_GYR_CAL": 0}, "px4": {"IMU_GYRO_CAL_EN": 0}})
"""Settings under which a vehicle keeps what is written."""
SENSORS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {"gyro": ("gyros",), "accel": ("accels",), "mag": ("mags",), "thermal": ("accels", "gyros")}
)
YAW_90, YAW_270 = 2, 6
AS_BOARD: Final = [YAW_90, YAW_90]
OWN_OFFSETS: Final = ("INS_GYR", "CAL_GYRO")
"""What a firmware may rewrite by itself at a start."""
VEHICLES: Final[Mapping[str, Json]] = MappingProxyType(
    {
        "earlier": {},
        # nothing says of a compass without a row that it is external: both are mounted as the board is
        "factory": {
            "factory": True,
            "mag_orientations": AS_BOARD,
            "mag_orientation_parameters": AS_BOARD,
            "parameters": {},
        },
        "late": {"stream_start_s": 2.0, "agreement_s": 10.0},
    }
)
CONFIG: Final[Json] = {
    "imu_count": 2,
    "mag_count": 2,
    "temperature": START_C,
    "board_orientation": YAW_90,
    "mag_orientations": [YAW_90, YAW_270],
    "mag_orientation_parameters": [YAW_90, 0],
}


@dataclass(frozen=True)
class Row:
    """How one calibration ended."""

    autopilot: str
    kind: str
    """The job's; or restart."""
    state: JobState
    acting: int
    """Written parameters that act on a stream."""
    proved: int
    right: int
    """Sensors that were judged and read right."""
    judged: int
    seconds: float
    reason: str
    """Why not everything is proved; empty if it is."""

    @property
    def good(self) -> bool:
        """Whether it succeeded, and everything is proved or there is a reason."""
        whole = 0 < self.acting == self.proved
        return self.state == JobState.SUCCEEDED and (whole or bool(self.reason))


async def sequence(
    autopilot: str, seed: int, kinds: Sequence[str] = KINDS, *, vehicle: str = "earlier", rounds: int = 1
) -> list[Row]:
    """Calibrate one vehicle, sensor after sensor; ends with the first job that does not succeed."""
    config = {**CONFIG, "parameters": SETTINGS[autopilot], **VEHICLES[vehicle]}
    rows: list[Row] = []
    with (
        tempfile.TemporaryDirectory(prefix="mavcal-sequence-") as folder,
        SimulatedVehicle(autopilot, seed=seed, speed=SPEED, config=config) as sim,
    ):
        async with session(Path(folder), sim) as service:
            service.operator = Operator(sim, warm_from=START_C, warm_to=END_C)
            for _ in range(rounds):
                written: dict[str, float] = {}
                for kind in kinds:
                    began = time.monotonic()
                    job = await _calibrated(service, sim, kind)
                    rows.append(row_of(autopilot, job, time.monotonic() - began))
                    if not rows[-1].good:
                        return rows
                    written |= {} if job.plan is None else {c.name: c.new for c in job.plan.changes if not c.session}
                if rounds > 1:
                    rows.append(await _restarted(autopilot, sim, written))
    return rows


async def _restarted(autopilot: str, sim: SimulatedVehicle, written: Mapping[str, float]) -> Row:
    """Whether the vehicle still holds what was written, after its power was off."""
    began = time.monotonic()
    await asyncio.to_thread(sim.wait, SAVED_S)
    await asyncio.to_thread(_reboot, sim)
    stored = (await sim.acall("parameters"))["stored"]
    lost = [n for n, new in written.items() if not n.startswith(OWN_OFFSETS) and stored.get(n) != new]
    state = JobState.FAILED if lost else JobState.SUCCEEDED
    kept = len(written) - len(lost)
    reason = f"lost: {', '.join(lost)}" if lost else f"all {kept} values are still there"
    return Row(autopilot, "restart", state, len(written), kept, 0, 0, time.monotonic() - began, reason)


def _reboot(sim: SimulatedVehicle) -> None:
    """Restart it and wait for its first seconds: its clock counts from 0 again, a moment after the command."""
    before = sim.state()["time"]
    sim.call("reboot")
    while not BOOT_S < sim.state()["time"] < before:
        time.sleep(0.1)


async def _decisions(kind: str, sim: SimulatedVehicle) -> Json:
    """What the operator has looked at, and ids of sensors for which a PX4 may have no row yet."""
    decided = dict(DECISIONS.get(kind, {}))
    truth = (await sim.acall("truth"))["truth"]
    if truth["autopilot"] == "px4" and kind in SENSORS:
        decided["device_ids"] = {
            f"{name[:-1]}{i}": sensor["id"] for name in SENSORS[kind] for i, sensor in enumerate(truth[name])
        }
    return decided


async def _calibrated(service: Session, sim: SimulatedVehicle, kind: str) -> Job:
    """One job from its start to its end, by an operator who does what the prompts say."""
    job = await service.reviewed(sim, kind, dict(OPTIONS.get(kind, {})), await _decisions(kind, sim))
    if job.state != JobState.REVIEW or job.plan is None or job.plan.blockers or not job.plan.changes:
        return job
    if kind == "thermal":
        await sim.acall("temperature", value=PROOF_C)
    await sim.acall("speed", value=WRITING_SPEED)
    job = await _written(service, job)
    for _ in range(AGAIN):
        if job.state == JobState.REVIEW and isinstance(job.outcome, Failure) and "Plan again" in job.outcome.cause:
            job = await _written(service, await service.engine.plan_again(job.id))
    await sim.acall("speed", value=SPEED)
    await asyncio.to_thread(service.operator.rest)
    return job


async def _written(service: Session, job: Job) -> Job:
    """Accept the plan, and do what is asked for until the write has ended or the plan waits again."""
    await service.applied(job)
    while (job := service.engine.get(job.id)).state not in ENDED | {JobState.REVIEW}:
        await service.obeyed(job)
        await asyncio.sleep(0.05)
    return job


def row_of(autopilot: str, job: Job, seconds: float) -> Row:
    """What to show of a job."""
    check = job.verification or Verification(())
    acting = [p for p in check.parameters if p.acts_on_stream]
    judged = [c for c in check.sensors if c.verdict != SensorVerdict.NOT_OBSERVABLE]
    return Row(
        autopilot,
        job.kind,
        job.state,
        len(acting),
        sum(p.verdict == ProofVerdict.PROVED for p in acting),
        sum(c.verdict == SensorVerdict.RIGHT for c in judged),
        len(judged),
        seconds,
        reason_of(job, check),
    )


def reason_of(job: Job, check: Verification) -> str:
    """Why not everything is proved."""
    if isinstance(job.outcome, Failure):
        return job.outcome.cause
    if job.plan is not None and (job.plan.blockers or not job.plan.changes):
        return "; ".join(job.plan.blockers) or "nothing to write: what is in force agrees with the fit"
    texts: dict[str, list[str]] = {}
    for p in check.parameters:
        if p.acts_on_stream and p.verdict != ProofVerdict.PROVED:
            texts.setdefault(p.text, []).append(p.name)
    if texts:
        return "; ".join(f"{', '.join(names)}: {text}" for text, names in texts.items())
    if not any(p.acts_on_stream for p in check.parameters):
        return next((p.text for p in check.parameters), "nothing was checked")
    return ""


def table(rows: Sequence[Row]) -> str:
    """The rows as a table in Markdown."""
    head = ("autopilot", "job", "ended", "proved", "sensors right", "s", "reason")
    cells = []
    for r in rows:
        counts = (f"{r.proved} of {r.acting}", f"{r.right} of {r.judged}", f"{r.seconds:.0f}")
        reason = r.reason or "every parameter that shows is proved"
        cells.append((r.autopilot, r.kind, r.state.value, *counts, reason))
    return grid(head, cells)


def main(argv: Sequence[str] | None = None) -> int:
    """Run both autopilots and print the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.sequence", description=__doc__)
    parser.add_argument("--autopilot", choices=AUTOPILOTS, action="append")
    parser.add_argument("--seed", type=int, default=61)
    parser.add_argument("--kind", choices=KINDS, action="append")
    parser.add_argument("--vehicle", choices=VEHICLES, default="earlier")
    parser.add_argument("--rounds", type=int, default=1)
    args = parser.parse_args(argv)
    kinds = args.kind or KINDS
    autopilots = args.autopilot or AUTOPILOTS
    rows = [
        row
        for autopilot in autopilots
        for row in asyncio.run(sequence(autopilot, args.seed, kinds, vehicle=args.vehicle, rounds=args.rounds))
    ]
    print(table(rows))
    restarts = args.rounds if args.rounds > 1 else 0
    expected = len(autopilots) * (args.rounds * len(kinds) + restarts)
    return 0 if len(rows) == expected and all(row.good for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
