"""Tells who controls the message rates of a vehicle, and which jobs claim it."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Iterator

from mavcal.service.errors import VehicleUnknown
from mavcal.service.jobs.model import Job
from mavcal.service.jobs.port import VehicleSource
from mavcal.service.jobs.preflight import Preflights
from mavcal.service.jobs.states import PHYSICAL
from mavcal.service.jobs.tidying import Tidying

TAKING_UP = "The service is finishing what was interrupted at its last stop; the vehicle is asked for samples then."


def claim_of(
    vehicle_id: str, jobs: Iterable[Job], running: Collection[str], tidying: Tidying, preflights: Preflights
) -> str | None:
    """In a sentence, for who would like to watch; None: nothing has them.

    `running`: the ids of jobs whose task is not over, whatever their state says.
    """
    for job in jobs:
        if job.vehicle_id == vehicle_id and (job.state in PHYSICAL or job.id in running):
            return f"A job ({job.kind}) has chosen which messages the vehicle sends; these are shown."
    if preflights.holds(vehicle_id):
        return "A preflight has chosen which messages the vehicle sends; these are shown."
    if tidying.holds(vehicle_id):
        return "The message rates are still those of the last job; they are put back first."
    return None


def named_now(jobs: Iterable[Job], vehicles: VehicleSource) -> Iterator[Job]:
    """Jobs, and of those that claim a vehicle the name that it has by now: another link may have named it before."""
    for job in jobs:
        if job.vehicle_id is None or job.state not in PHYSICAL:
            yield job
            continue
        try:
            yield dataclasses.replace(job, vehicle_id=vehicles.vehicle(job.vehicle_id).id)
        except VehicleUnknown:
            yield job
