"""The plan of a job that puts the last verified calibration back; it is accepted and written like any other."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any

from mavcal.calib.errors import CalibError, FirmwareError
from mavcal.calib.firmware.in_force.fingerprint import calibration_snapshot, fingerprint
from mavcal.calib.firmware.options import compose_options
from mavcal.calib.firmware.plan import WritePlan
from mavcal.calib.firmware.slots import CALIBRATED
from mavcal.calib.preflight.restore import compose_restore, expected_names, require_same_unit
from mavcal.calib.preflight.snapshot import VerifiedCalibration
from mavcal.calib.recording import Identity
from mavcal.calib.report import to_json
from mavcal.service.errors import NothingVerified, ServiceError
from mavcal.service.jobs.admission import require_ready
from mavcal.service.jobs.handle import JobHandle
from mavcal.service.jobs.model import Failure, Result
from mavcal.service.jobs.needs import read_needed
from mavcal.service.jobs.planning import Planned, keep_plan
from mavcal.service.jobs.port import JobVehicle
from mavcal.service.jobs.preflight import History
from mavcal.service.jobs.states import JobState
from mavcal.service.jobs.write import read_values


async def require_restorable(vehicle: JobVehicle, history: History) -> None:
    """Raise NothingVerified unless there is a verified calibration, and all of it is of this very unit."""
    try:
        require_same_unit(await history(vehicle), vehicle.identity.uid)
    except FirmwareError as error:
        raise NothingVerified(str(error)) from error


async def planned_restore(
    vehicle: JobVehicle, history: Sequence[VerifiedCalibration], options: Mapping[str, Any]
) -> tuple[Identity, Planned]:
    """Who the vehicle is, and the plan on its present parameters.

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


async def restored(handle: JobHandle, vehicle_of: Callable[[JobHandle], Awaitable[JobVehicle]], known: History) -> None:
    """Plan; the job ends in review, succeeded with nothing to write, or failed.

    `vehicle_of` waits for the vehicle of a job, which after a restart of the service takes a while.
    """
    options = handle.job.context.get("plan_options", {})
    try:
        vehicle = await vehicle_of(handle)
        require_ready(vehicle)
        identity, planned = await planned_restore(vehicle, await known(vehicle), options)
        await keep_plan(handle, planned)
    except (ServiceError, CalibError) as error:
        code = str(getattr(error, "code", "calibration-error"))
        handle.move(JobState.FAILED, outcome=Failure(code, str(error), "Nothing was written."))
        return
    done = planned.plan.nothing_to_write
    handle.move(
        JobState.SUCCEEDED if done else JobState.REVIEW,
        outcome=_in_place(planned.plan) if done else None,
        fingerprint=planned.plan.fingerprint,
        plan=planned.plan,
        warnings=planned.plan.warnings,
        context={**handle.job.context, "identity": to_json(identity)},
    )


def _in_place(plan: WritePlan) -> Result:
    left = f" Left out: {'; '.join(plan.warnings)}." if plan.warnings else ""
    text = f"Nothing to restore: every parameter is as it was verified.{left}"
    return Result(text, proof_reason="Nothing was written, so there is nothing to prove.")
