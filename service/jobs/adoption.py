"""Makes a plan from fits on the vehicle's present parameters, or a whole job from fits of an uploaded recording."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from typing import Any

from mavcal.calib.errors import CalibError
from mavcal.calib.firmware.in_force.origin import Origin, unproved
from mavcal.calib.firmware.options import Key
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.recording import Identity
from mavcal.calib.report import from_json, to_json
from mavcal.service.errors import ServiceError
from mavcal.service.jobs.admission import require_ready
from mavcal.service.jobs.handle import JobHandle
from mavcal.service.jobs.model import Failure, Job
from mavcal.service.jobs.needs import read_needed, sensors_of
from mavcal.service.jobs.planning import (
    Planned,
    accel_temperatures,
    checked_plan_options,
    keep_plan,
    make_plan,
    nothing_to_write,
    require_origin,
    told_device_ids,
)
from mavcal.service.jobs.port import Computations, JobVehicle
from mavcal.service.jobs.states import JobState


async def composed(
    vehicle: JobVehicle,
    results: Sequence[FitResult],
    options: Mapping[str, Any],
    origin: Mapping[str, Any] | None,
    jobs: Iterable[Job],
    without_row: Iterable[Key] = (),
) -> tuple[Identity, Planned]:
    """Who the vehicle is, and a plan on its present parameters. `origin` of a recording must be this vehicle.

    `jobs` are all jobs: earlier ones know at which temperature an accelerometer was calibrated. `without_row`: see
    :func:`service.jobs.planning.keys_without_row`.

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
    doubt = ""
    if origin is not None:
        require_origin(from_json(origin, Origin), identity, parameters)
        doubt = unproved(from_json(origin, Origin), identity)
    earlier = tuple(jobs)
    known = accel_temperatures(earlier, vehicle.id, parameters)
    told = told_device_ids(earlier, vehicle.id, parameters) if origin is None else {}  # a log says its own ids
    return identity, await asyncio.to_thread(
        make_plan,
        results,
        parameters,
        identity,
        options,
        known,
        unproved_origin=doubt,
        without_row=without_row,
        told=told,
    )


async def adopted(
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
        identity, planned = await composed(vehicle, results, chosen, kept, jobs())
        await keep_plan(handle, planned)
    except (ServiceError, CalibError) as error:
        code = str(getattr(error, "code", "calibration-error"))
        remedy = "Remove the cause and ask for the job again; the recording is kept."
        handle.move(JobState.FAILED, outcome=Failure(code, str(error), remedy))
        return
    told = [fit.message for fit in results if fit.status == FitStatus.REFUSED]
    told += [warning for fit in results for warning in fit.warnings]
    done = planned.plan.nothing_to_write
    handle.move(
        JobState.SUCCEEDED if done else JobState.REVIEW,
        outcome=nothing_to_write(planned.plan) if done else None,
        fingerprint=planned.plan.fingerprint,
        results=tuple(results),
        plan=planned.plan,
        warnings=tuple(dict.fromkeys(told)),
        context={"identity": to_json(identity), "plan_options": chosen, "origin": kept},
    )
