"""Jobs that need no capture: fits of an uploaded recording, and restoring a verified calibration."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from typing import Any

from mavcal.calib.errors import CalibError, FirmwareError
from mavcal.calib.firmware.in_force.fingerprint import calibration_snapshot, fingerprint
from mavcal.calib.firmware.in_force.origin import Origin, unproved
from mavcal.calib.firmware.options import Key, compose_options
from mavcal.calib.firmware.plan import WritePlan
from mavcal.calib.firmware.slots import CALIBRATED
from mavcal.calib.fit import FitResult
from mavcal.calib.preflight.check import VerifiedCalibration
from mavcal.calib.preflight.restore import compose_restore, expected_names, require_same_unit
from mavcal.calib.recording import Identity
from mavcal.calib.report import from_json, to_json
from mavcal.service.errors import IllegalTransition, NothingVerified, ServiceError
from mavcal.service.jobs.calibrate.planning import (
    Planned,
    checked_plan_options,
    keep_plan,
    keys_without_row,
    make_plan,
    move_to_review,
    nothing_to_write,
    require_origin,
)
from mavcal.service.jobs.core.admission import require_ready
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import RESTORE, Failure, Job, Result, fit_messages
from mavcal.service.jobs.core.parameters import read_needed, sensors_of
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.uploads import Computations
from mavcal.service.preflights import History
from mavcal.service.vehicle.job_vehicle import JobVehicle, read_values


async def compose_plan(
    vehicle: JobVehicle,
    results: Sequence[FitResult],
    options: Mapping[str, Any],
    origin: Mapping[str, Any] | None,
    jobs: Iterable[Job],
    without_row: Iterable[Key] = (),
) -> tuple[Identity, Planned]:
    """The vehicle's identity, and a plan on its present parameters. A recording must be of this vehicle (`origin`).

    `jobs` and `without_row` are those of :func:`service.jobs.calibrate.planning.make_plan`.

    Raises
    ------
    OtherVehicle
        If the recording is of other sensors.
    VehicleError, FirmwareError, InvalidInputError
    """
    identity = await vehicle.identify()
    drift = any(fit.model.polynomial is not None for fit in results)
    read = await read_needed(vehicle, sensors_of(results), drift=drift)
    parameters = {name: reading.value for name, reading in read.items()}
    doubt = None
    if origin is not None:
        require_origin(from_json(origin, Origin), identity, parameters)
        doubt = unproved(from_json(origin, Origin), identity)
    return identity, await asyncio.to_thread(
        make_plan,
        results,
        parameters,
        identity,
        options,
        jobs,
        vehicle.id,
        unproved_origin=doubt,
        without_row=without_row,
    )


async def plan_from_recording(
    handle: JobHandle,
    vehicle_of: Callable[[JobHandle], Awaitable[JobVehicle]],
    computations: Computations,
    jobs: Callable[[], Iterable[Job]],
) -> None:
    """Fit and plan; the job ends in review, succeeded with nothing to write, or failed.

    `vehicle_of` waits for the vehicle of a job, which after a restart of the service takes a while.
    """
    order = handle.job.options
    try:
        results, origin = await computations.fit_of_vehicle(order["recording"], order["method"], order["options"])
        chosen = checked_plan_options(handle.job.context.get("plan_options", {}), results)
        kept = to_json(origin)
        vehicle = await vehicle_of(handle)
        require_ready(vehicle)
        identity, planned = await compose_plan(vehicle, results, chosen, kept, jobs())
        await keep_plan(handle, planned)
    except (ServiceError, CalibError) as error:
        remedy = "Remove the cause and ask for the job again; the recording is kept."
        handle.move(JobState.FAILED, outcome=Failure.of(error, remedy))
        return
    move_to_review(
        handle,
        planned.plan,
        nothing_to_write(planned.plan),
        results=tuple(results),
        warnings=fit_messages(results),
        context={"identity": to_json(identity), "plan_options": chosen, "origin": kept},
    )


def require_review(job: Job) -> None:
    """Raise IllegalTransition unless the job is in review."""
    if job.state != JobState.REVIEW:
        raise IllegalTransition(f"job {job.id} is {job.state}: only a job in review can be planned again")


async def plan_again(
    handle: JobHandle, vehicle: JobVehicle, options: dict[str, Any], known: History, jobs: Iterable[Job]
) -> None:
    """Compose the plan of a job in review again, on the vehicle's present parameters."""
    job = handle.job
    if job.kind == RESTORE:
        identity, planned = await compose_restore_plan(vehicle, await known(vehicle), options)
    else:
        origin, rowless = job.context.get("origin"), keys_without_row(job.context)
        identity, planned = await compose_plan(vehicle, job.results, options, origin, jobs, rowless)
    await keep_plan(handle, planned)
    require_review(handle.job)  # it may have been accepted or cancelled meanwhile
    plan = planned.plan
    context = {**handle.job.context, "identity": to_json(identity), "plan_options": options}
    data = {"sha256": plan.sha256}
    handle.change("plan", data, plan=plan, fingerprint=plan.fingerprint, context=context, outcome=None)


async def require_restorable(vehicle: JobVehicle, history: History) -> None:
    """Raise NothingVerified unless there is a verified calibration, and all of it is of this very unit."""
    try:
        require_same_unit(await history(vehicle), vehicle.identity.uid)
    except FirmwareError as error:
        raise NothingVerified(str(error)) from error


async def compose_restore_plan(
    vehicle: JobVehicle, history: Sequence[VerifiedCalibration], options: Mapping[str, Any]
) -> tuple[Identity, Planned]:
    """The vehicle's identity, and the plan on its present parameters.

    Raises
    ------
    FirmwareError
        If a verified calibration is of another unit, or there is none.
    VehicleError, InvalidInputError
    """
    identity = await vehicle.identify()
    require_same_unit(history, identity.uid)
    read = await read_needed(vehicle, CALIBRATED, drift=True)
    asked = set(read)
    while missing := expected_names(history, identity.autopilot, {n: r.value for n, r in read.items()}) - asked:
        asked |= missing
        read |= await read_values(vehicle, sorted(missing), absent=True)
    parameters = {name: reading.value for name, reading in read.items()}
    kinds = {name: reading.kind for name, reading in read.items()}
    plan = await asyncio.to_thread(
        compose_restore,
        history,
        parameters,
        kinds,
        fingerprint(identity, parameters),
        options=compose_options(options),
    )
    return identity, Planned(plan, calibration_snapshot(parameters))


async def plan_restore(
    handle: JobHandle, vehicle_of: Callable[[JobHandle], Awaitable[JobVehicle]], known: History
) -> None:
    """Plan; the job ends in review, succeeded with nothing to write, or failed.

    `vehicle_of` waits for the vehicle of a job, which after a restart of the service takes a while.
    """
    options = handle.job.context.get("plan_options", {})
    try:
        vehicle = await vehicle_of(handle)
        require_ready(vehicle)
        identity, planned = await compose_restore_plan(vehicle, await known(vehicle), options)
        await keep_plan(handle, planned)
    except (ServiceError, CalibError) as error:
        handle.move(JobState.FAILED, outcome=Failure.of(error, "Nothing was written."))
        return
    move_to_review(
        handle,
        planned.plan,
        _in_place(planned.plan),
        warnings=planned.plan.warnings,
        context={**handle.job.context, "identity": to_json(identity)},
    )


def _in_place(plan: WritePlan) -> Result:
    left = f" Left out: {'; '.join(plan.warnings)}." if plan.warnings else ""
    text = f"Nothing to restore: every parameter is as it was verified.{left}"
    return Result(text, proof_reason="Nothing was written, so there is nothing to prove.")
