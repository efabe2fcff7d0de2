"""Checks whether a job may begin: on this vehicle, in this state; waits while the vehicle calibrates itself."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterable, Mapping
from typing import Any

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.procedures.protocol import Progress, Prompt, PromptStep
from mavcal.service.errors import (
    NoVehicle,
    PhysicalJobRunning,
    StoreError,
    VehicleArmed,
    VehicleBusy,
    VehicleConflict,
    VehicleSilent,
)
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.core.states import PHYSICAL, JobState
from mavcal.service.store.sql import Store
from mavcal.service.vehicle.job_vehicle import JobVehicle

WAY = "way"
"""In a job's context: the link in use when its plan was accepted."""


def require_ready(vehicle: JobVehicle, *, busy: bool = False) -> None:
    """Raise the VehicleError that prevents a job; with `busy`, an onboard calibration does not prevent it."""
    now = vehicle.condition()
    if now.silent:
        raise VehicleSilent
    if now.armed:
        raise VehicleArmed
    if now.conflict is not None:
        raise VehicleConflict(now.conflict)
    if now.calibrating and not busy:
        raise VehicleBusy("The vehicle runs a calibration of its own. Let it finish, or cancel it there.")


def require_whole(store: Store) -> None:
    """Raise StoreError while the store could not keep the journal of a write."""
    obstacle = store.obstacle()
    if obstacle is not None:
        raise StoreError(obstacle)


def require_vehicle(job: Job) -> str:
    """The id of the job's vehicle. Raises NoVehicle if it is of none."""
    if job.vehicle_id is None:
        raise NoVehicle(f"job {job.id} ({job.kind}) has no vehicle: it only computes, so there is nothing to write")
    return job.vehicle_id


def require_finite(options: Mapping[str, Any]) -> None:
    """Raise InvalidInputError if an option is no number that JSON can carry."""
    for name, value in options.items():
        try:
            json.dumps(value, allow_nan=False)
        except ValueError:
            raise InvalidInputError(f"the option {name} is {value}: give a finite number") from None


def require_free(vehicle_id: str, jobs: Iterable[Job], *, besides: str = "") -> None:
    """Raise PhysicalJobRunning if another job claims this vehicle."""
    for job in jobs:
        if job.vehicle_id != vehicle_id or job.id == besides or job.state not in PHYSICAL:
            continue
        if job.state == JobState.IN_DOUBT:
            raise PhysicalJobRunning(
                f"Job {job.id} was interrupted while it wrote to this vehicle: it is closed for new jobs until that "
                "is finished or taken back. Disarm it and keep it on the ground and in reach."
            )
        raise PhysicalJobRunning(f"Job {job.id} ({job.kind}) is {job.state} on this vehicle: wait for it or cancel it.")


async def until_idle(handle: JobHandle, vehicle: JobVehicle, settings: JobSettings) -> None:
    """Wait until the vehicle runs no onboard calibration; other obstacles are checked by the caller.

    Raises
    ------
    VehicleBusy
        If it still does after `settings.busy_s`.
    """
    loop = asyncio.get_running_loop()
    begun = loop.time()
    shown = False
    while (busy := _busy(vehicle, settings)) is not None:
        reason, left = busy
        waited = loop.time() - begun
        if waited > settings.busy_s:
            raise VehicleBusy(f"{reason}, and has not ended within {settings.busy_s:.0f} s")
        text = f"Waiting: {reason}. Keep the vehicle still; this waits for at most {settings.busy_s:.0f} s."
        handle.prompt(Prompt(PromptStep.BUSY, text))
        target = settings.busy_s if left is None else waited + left
        handle.progress(Progress(waited, target, "s", reason, eta=left))
        shown = True
        await asyncio.sleep(settings.watch_s)
    if shown:
        handle.prompt(None)


def _busy(vehicle: JobVehicle, settings: JobSettings) -> tuple[str, float | None] | None:
    """The onboard calibration that keeps the vehicle busy, and its remaining time if known, s."""
    now = vehicle.condition()
    if now.silent or now.armed or now.conflict is not None:
        return None
    if now.calibrating:
        return "the vehicle runs a calibration of its own", None
    needed = settings.started_s.get(vehicle.identity.autopilot or "", 0.0)
    if now.boot_time is not None and now.boot_time < needed:
        reason = f"the vehicle started less than {needed:.0f} s ago and may calibrate its gyros by itself"
        return reason, needed - now.boot_time
    return None
