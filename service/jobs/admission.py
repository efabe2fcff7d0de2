"""Checks whether a job or a write may begin: on this vehicle, in this state, with this plan."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from typing import Any

from mavcal.calib.errors import InvalidInputError
from mavcal.service.errors import (
    IllegalTransition,
    NoVehicle,
    PhysicalJobRunning,
    PlanBlocked,
    PlanChanged,
    PlanMissing,
    StoreError,
    VehicleArmed,
    VehicleBusy,
    VehicleConflict,
    VehicleSilent,
)
from mavcal.service.jobs.model import Accept, Job
from mavcal.service.jobs.port import JobVehicle
from mavcal.service.jobs.states import PHYSICAL, JobState
from mavcal.service.store.protocol import Store

WAY = "way"
"""In a job's context: the link in use when its plan was accepted."""


def require_ready(vehicle: JobVehicle, *, busy: bool = False) -> None:
    """Raise the VehicleError that stands in the way of a job; with `busy` a calibration of its own does not."""
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
    """Raise StoreError while nothing may be written, because what has to be kept of a write could not be."""
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


def require_acceptable(job: Job, accept: Accept) -> None:
    """Raise the JobError that keeps the plan of `job` from being written."""
    if job.state != JobState.REVIEW:
        raise IllegalTransition(f"job {job.id} is {job.state}: only a job in review can be applied")
    if job.plan is None:
        raise PlanMissing
    if accept.plan_sha256 != job.plan.sha256:
        raise PlanChanged("this is not the digest of the job's plan: look at the plan again, then accept that one")
    if job.plan.blockers:
        raise PlanBlocked("the plan may not be written: " + "; ".join(job.plan.blockers))
    if not job.plan.changes:
        raise PlanBlocked("there is nothing to write: the vehicle holds these values already")


def request_digest(job_id: str, accept: Accept) -> str:
    """Digest of an apply request, for its idempotency key."""
    asked = [job_id, accept.plan_sha256, accept.reboot, accept.prove_s]
    return hashlib.sha256(json.dumps(asked).encode()).hexdigest()
