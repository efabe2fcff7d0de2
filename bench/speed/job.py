"""How long a gyro job takes from end to end, and how much of that is the length of its data."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from bench.rows import Row, Section
from bench.running import RunningService, service
from mavcal.client.events import StateEvent
from mavcal.client.problems import VehicleArmed
from mavcal.service.simvehicle import Operator, SimulatedVehicle

SPEEDS = (1.0, 30.0)
WRITING_SPEED = 4.0
"""At most so fast while parameters are written: a disarmed vehicle is waited for on the wall clock."""
_ENDED = frozenset({"succeeded", "reverted", "failed", "cancelled", "interrupted", "in_doubt"})
_ACCEPT_WITHIN_S = 10.0


def run() -> Section:
    """The job at the speed of the clock and faster."""
    rows = []
    for speed in SPEEDS:
        states, submitted, data_s = _job(speed)
        review, data = states["review"] - submitted, data_s / speed
        measured = f"{review:.2f} s: data {data:.2f} s, ours {review - data:.2f} s; fit and plan "
        measured += f"{states['review'] - states['fitting']:.2f} s"
        rows.append(Row(f"submit -> review, vehicle x {speed:g}", "", measured))
        wrote = states["succeeded"] - states["applying"]
        rows.append(Row(f"apply -> succeeded, vehicle x {speed:g}", "", f"{wrote:.2f} s"))
    note = (
        "The data's own length is what the offsets' uncertainty needs at rest (0.01 deg/s, 5 s at least); "
        f"parameters are written with the vehicle at most {WRITING_SPEED:g} times as fast as the clock."
    )
    return Section("A gyro job from end to end", tuple(rows), (note,))


def _job(speed: float) -> tuple[dict[str, float], float, float]:
    """When each state was reached (wall clock of the service, s), when it was submitted, seconds of its data."""
    with (
        tempfile.TemporaryDirectory(prefix="mavcal-bench-") as folder,
        SimulatedVehicle("ardupilot", speed=speed, config={"parameters": {"INS_GYR_CAL": 0}}) as vehicle,
        service(vehicle.url, Path(folder) / "data") as running,
    ):
        Operator(vehicle).rest()
        vehicle_id, submitted = running.found(), time.time()
        job = running.client.start_job(vehicle_id, kind="gyro").id
        _followed(running, job, _ENDED | {"review"})
        data_s = max(float(fit.quality["duration"]) for fit in running.client.get_job(job).results)
        vehicle.call("speed", value=min(speed, WRITING_SPEED))
        _apply(running, job)
        states = _followed(running, job, _ENDED)
        if "succeeded" not in states:
            raise RuntimeError(f"the job has not succeeded: {running.client.get_job(job).outcome}")
    return states, submitted, data_s


def _followed(running: RunningService, job: str, until: frozenset[str]) -> dict[str, float]:
    """Every state with when it was reached last, from the job's first event on."""
    states: dict[str, float] = {}
    for message in running.client.follow_job(job):
        event = message.data
        if isinstance(event, StateEvent):
            states[event.data.state.value] = event.at
            if event.data.state in until:
                return states
    raise RuntimeError(f"the events of job {job} ended early")


def _apply(running: RunningService, job: str) -> None:
    """Accept the plan; a vehicle that was not seen disarmed for 2 s yet is asked again."""
    digest = running.client.get_plan(job).sha256
    until = time.monotonic() + _ACCEPT_WITHIN_S
    while True:
        try:
            running.client.apply_plan(job, plan_sha256=digest, reboot=True, prove_s=0.0, idempotency_key=job)
        except VehicleArmed:
            if time.monotonic() > until:
                raise
            time.sleep(0.1)
            continue
        return
