"""From fits to a plan, and the snapshot that the plan is bound to."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from calib.errors import InvalidInputError
from calib.firmware.compose import ComposeOptions, compose
from calib.firmware.fingerprint import calibration_snapshot, fingerprint
from calib.firmware.origin import Origin, differences
from calib.firmware.plan import Value, WritePlan, snapshot_sha256
from calib.fit import FitResult
from calib.recording import Identity, Sensor
from calib.report import plan_to_json
from service.errors import OtherVehicle
from service.jobs.handle import JobHandle
from service.jobs.journal import same
from service.jobs.model import Job
from service.jobs.states import JobState
from service.store.rows import SnapshotPurpose

ACCEL_KINDS = frozenset({"accel", "accel-one-axis", "accel-six-face", "imu-multi"})
"""Jobs that write an accelerometer's calibration."""
FROM_RECORDING = "recording"
"""Kind of a job whose fits are of an uploaded recording: it begins in review."""


@dataclasses.dataclass(frozen=True)
class Planned:
    """A plan, and the parameters that it rests on."""

    plan: WritePlan
    composed_on: dict[str, Value]


PLAN_OPTIONS = tuple(f.name for f in dataclasses.fields(ComposeOptions) if f.type == "bool")
"""What the operator may decide about a plan, each true or false."""


def checked_plan_options(options: Mapping[str, Any]) -> dict[str, bool]:
    """`options` if every one is known and a switch. Raises InvalidInputError."""
    for name, value in options.items():
        if name not in PLAN_OPTIONS:
            raise InvalidInputError(f"a plan has no option {name}; its options are: {', '.join(PLAN_OPTIONS)}")
        if not isinstance(value, bool):
            raise InvalidInputError(f"option {name} of a plan is a switch: give true or false, not {value!r}")
    return dict(options)


def accel_temperatures(jobs: Iterable[Job], vehicle_id: str, parameters: Mapping[str, Value]) -> dict[int, float]:
    """Temperature (degC) at which the accelerometer calibration in force was taken, by instance, as far as we know.

    From the newest accelerometer job of this vehicle, if every value that it wrote still stands.
    """
    ours = [job for job in jobs if job.vehicle_id == vehicle_id and _of_accel(job) and job.plan is not None]
    written = [job for job in ours if job.state == JobState.SUCCEEDED]
    if not written:
        return {}
    newest = max(written, key=lambda job: job.updated_at)
    assert newest.plan is not None
    for change in newest.plan.changes:
        counts = change.sensor == Sensor.ACCEL and not change.session
        if counts and not (change.name in parameters and same(parameters[change.name], change.new, change.kind)):
            return {}
    results = [fit for fit in newest.results if fit.sensor == Sensor.ACCEL]
    return {fit.instance: fit.temperature for fit in results if fit.temperature is not None}


def _of_accel(job: Job) -> bool:
    """Whether the job writes an accelerometer's calibration."""
    if job.kind == FROM_RECORDING:
        return any(fit.sensor == Sensor.ACCEL for fit in job.results)
    return job.kind in ACCEL_KINDS


def require_origin(origin: Origin, identity: Identity, parameters: Mapping[str, Value]) -> None:
    """Raise OtherVehicle if the vehicle does not carry the sensors that a recording's fits are of."""
    reasons = differences(origin, identity, parameters)
    if reasons:
        raise OtherVehicle(f"not for this vehicle: {'; '.join(reasons)}")


def origin_to_json(origin: Origin) -> dict[str, Any]:
    """As plain data, for a job's context."""
    return {**dataclasses.asdict(origin), "mounting": dict(origin.mounting)}


def origin_from_json(data: Mapping[str, Any]) -> Origin:
    """The inverse of :func:`origin_to_json`."""
    sensors = tuple((str(sensor), int(instance), int(device)) for sensor, instance, device in data["sensors"])
    return Origin(data["autopilot"], data["uid"], sensors, dict(data["mounting"]))


def make_plan(
    results: Sequence[FitResult],
    parameters: Mapping[str, Value],
    identity: Identity,
    switches: Mapping[str, bool],
    temperatures: Mapping[int, float],
) -> Planned:
    """Compose what to write. Raises FirmwareError if the firmware cannot take it at all.

    `switches` are plan options, `temperatures` those of :func:`accel_temperatures`.
    """
    chosen: dict[str, Any] = dict(switches)
    options = ComposeOptions(accel_temperature=dict(temperatures), **chosen)
    plan = compose(results, parameters, fingerprint(identity, parameters), options=options)
    return Planned(plan, calibration_snapshot(parameters))


def keep_plan(handle: JobHandle, planned: Planned) -> None:
    """Bring plan and snapshot onto the disk. Raises DiskFull."""
    plan = planned.plan
    handle.store.add_snapshot(
        handle.id,
        handle.now(),
        SnapshotPurpose.COMPOSED_ON,
        snapshot_sha256(planned.composed_on),
        planned.composed_on,
    )
    handle.store.add_plan(handle.id, plan.sha256, handle.now(), plan_to_json(plan))


def identity_to_json(identity: Identity) -> dict[str, Any]:
    """As plain data, for a job's context."""
    return dataclasses.asdict(identity)


def identity_from_json(data: Mapping[str, Any]) -> Identity:
    """The inverse of :func:`identity_to_json`."""
    firmware = data["firmware"]
    return Identity(**{**data, "firmware": None if firmware is None else tuple(firmware)})
