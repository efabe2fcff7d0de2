"""Makes a plan from fits, and the snapshot that the plan is bound to."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.compose.early_warnings import foreseen, unknown_sensors
from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.firmware.in_force.fingerprint import calibration_snapshot, fingerprint
from mavcal.calib.firmware.in_force.origin import Origin, differences
from mavcal.calib.firmware.options import CONFIRMATIONS, Key, compose_options, key_text, parse_key, unknown_keys
from mavcal.calib.firmware.plan import Value, WritePlan, snapshot_sha256
from mavcal.calib.firmware.slots import CALIBRATED, still_held
from mavcal.calib.fit import FitResult
from mavcal.calib.procedures.spec import ProcedureSpec
from mavcal.calib.recording import Identity, Sensor
from mavcal.calib.report import to_json
from mavcal.service.errors import CaptureEnded, OtherVehicle
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.journal import same
from mavcal.service.jobs.core.model import FROM_RECORDING, Job, Result
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store.rows import SnapshotPurpose

ACCEL_KINDS = frozenset({"accel", "accel-one-axis", "accel-six-face", "imu-multi"})
"""Jobs that write an accelerometer's calibration."""
WITHOUT_ROW = "without_row"
"""Key of a job's context for the sensors without a row, see :func:`keys_without_row`."""


@dataclasses.dataclass(frozen=True)
class Planned:
    """A plan, and the parameters that it rests on."""

    plan: WritePlan
    composed_on: dict[str, Value]


def checked_plan_options(options: Mapping[str, Any], results: Sequence[FitResult] | None = None) -> dict[str, Any]:
    """`options`, if all are known and valid, and name only sensors in `results` (None: no results yet).

    Raises InvalidInputError.
    """
    only = compose_options(options).only
    if results is not None:
        wrong = unknown_keys(only, [(fit.sensor, fit.instance) for fit in results])
        if wrong:
            raise InvalidInputError(wrong)
    return dict(options)


def require_sensors_of(spec: ProcedureSpec, options: Mapping[str, Any]) -> None:
    """Raise InvalidInputError if a plan is asked for sensors that this kind of job does not calibrate."""
    wrong = [key_text(*key) for key in compose_options(options).only if key[0] not in spec.calibrated]
    if wrong:
        kinds = ", ".join(f"{sensor}0, {sensor}1 ..." for sensor in CALIBRATED if sensor in spec.calibrated)
        raise InvalidInputError(f"{spec.kind} does not calibrate {', '.join(wrong)}, but {kinds}")


def confirmed(options: Mapping[str, Any]) -> list[str]:
    """The confirmations that the operator gave for a plan, by name."""
    return [name for name in CONFIRMATIONS if options.get(name)]


def foresee(
    kind: str,
    identity: Identity,
    parameters: Mapping[str, Value],
    options: Mapping[str, Any],
    temperatures: Mapping[int, float],
) -> tuple[str, ...]:
    """Warnings about the plan of a job that has just begun, from the vehicle's parameters alone.

    Raises
    ------
    CaptureEnded
        If the plan is asked for a sensor that the vehicle does not have.
    """
    chosen = compose_options(options, accel_temperature=dict(temperatures))
    wrong = unknown_sensors(identity, parameters, chosen)
    if wrong:
        raise CaptureEnded(wrong, remedy="Start the job again with sensors of this vehicle.")
    return foreseen(identity, parameters, chosen) if kind == "thermal" else ()


def nothing_to_write(plan: WritePlan) -> Result:
    """The outcome of a job whose every sensor agrees with what is in force."""
    text = f"Nothing to write: {'; '.join(a.text for a in plan.agreements)}."
    return Result(text, proof_reason="Nothing was written, so there is nothing to prove.")


def accel_temperatures(jobs: Iterable[Job], vehicle_id: str, parameters: Mapping[str, Value]) -> dict[int, float]:
    """Temperature (degC) of the accelerometer calibration in force, by instance, where known.

    It is that of the newest accelerometer job of this vehicle, if the vehicle still has every value written.
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
    held = {(c.sensor, c.instance) for c in newest.plan.changes}
    held |= {(a.sensor, a.instance) for a in newest.plan.agreements}
    results = [fit for fit in newest.results if fit.sensor == Sensor.ACCEL and (fit.sensor, fit.instance) in held]
    return {fit.instance: fit.temperature for fit in results if fit.temperature is not None}


def held_device_ids(jobs: Iterable[Job], vehicle_id: str, parameters: Mapping[str, Value]) -> dict[Key, int]:
    """Device ids stated for an earlier write to this vehicle, by sensor, where its rows still hold them.

    Without them the next job would take the rows in order, and might write into the row of another sensor.
    """
    found: dict[Key, int] = {}
    written = [job for job in jobs if job.vehicle_id == vehicle_id and job.state == JobState.SUCCEEDED]
    for job in sorted(written, key=lambda job: job.updated_at):
        found |= stated_device_ids(job)
    return still_held(found, parameters)


def stated_device_ids(job: Job) -> dict[Key, int]:
    """Device ids that were stated for this job, of the sensors that its plan wrote."""
    if job.plan is None or job.plan.fingerprint.autopilot != "px4":
        return {}
    about = {(change.sensor, change.instance) for change in job.plan.changes}
    ids = compose_options(job.context.get("plan_options", {})).device_ids
    return {key: device for key, device in ids.items() if key in about}


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


def make_plan(
    results: Sequence[FitResult],
    parameters: Mapping[str, Value],
    identity: Identity,
    options: Mapping[str, Any],
    jobs: Iterable[Job],
    vehicle_id: str,
    *,
    unproved_origin: str | None = None,
    without_row: Iterable[Key] = (),
) -> Planned:
    """Compose what to write. Raises FirmwareError if the firmware cannot take it at all.

    Parameters
    ----------
    results, parameters, identity
        The fits, and the vehicle's present parameters and identity.
    options
        Those of the plan, as plain data.
    jobs, vehicle_id
        Every job: earlier ones of this vehicle know what its parameters do not say.
    unproved_origin
        Of fits of a recording, what :func:`calib.firmware.in_force.origin.unproved` says; None: of a capture.
    without_row
        See :func:`keys_without_row`.
    """
    known, rowless = tuple(jobs), frozenset(without_row)
    chosen = compose_options(
        options,
        accel_temperature=accel_temperatures(known, vehicle_id, parameters),
        unproved_origin=unproved_origin or "",
        without_row=rowless,
    )
    # a recording says its own device ids
    stated = held_device_ids(known, vehicle_id, parameters) if unproved_origin is None else {}
    given = {(key[0], device) for key, device in chosen.device_ids.items()}
    earlier = {k: device for k, device in stated.items() if k not in rowless and (k[0], device) not in given}
    chosen = dataclasses.replace(chosen, device_ids={**earlier, **chosen.device_ids})
    plan = compose(results, parameters, fingerprint(identity, parameters), options=chosen)
    return Planned(plan, calibration_snapshot(parameters))


def keys_without_row(context: Mapping[str, Any]) -> tuple[Key, ...]:
    """The sensors without a calibration row, by PX4's messages in this job's capture."""
    return tuple(parse_key(text) for text in context.get(WITHOUT_ROW, ()))


def move_to_review(handle: JobHandle, plan: WritePlan, nothing: Result, **changes: Any) -> None:
    """Move a planned job to review, or end it with the outcome `nothing` if there is nothing to write."""
    done = plan.nothing_to_write
    handle.move(
        JobState.SUCCEEDED if done else JobState.REVIEW,
        outcome=nothing if done else None,
        fingerprint=plan.fingerprint,
        plan=plan,
        **changes,
    )


async def keep_plan(handle: JobHandle, planned: Planned) -> None:
    """Store plan and snapshot. Raises DiskFull."""
    plan, at, store = planned.plan, handle.now(), handle.store
    body, digest = to_json(plan), snapshot_sha256(planned.composed_on)

    def keep() -> None:
        store.add_snapshot(handle.id, at, SnapshotPurpose.COMPOSED_ON, digest, planned.composed_on)
        store.add_plan(handle.id, plan.sha256, at, body)

    await store.do(keep)
