"""Whether a link may be closed: not while a write needs it (DESIGN 6, rule 2)."""

from __future__ import annotations

from collections.abc import Iterable

from mavcal.service.errors import LinkBusy, VehicleUnknown
from mavcal.service.jobs.core.admission import WAY
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import WRITING, JobState
from mavcal.service.link import Link
from mavcal.service.vehicle import VehicleRegistry


def require_unneeded(link: Link, vehicles: VehicleRegistry, jobs: Iterable[Job]) -> None:
    """Raise LinkBusy if a write runs over this link, or is in doubt, and no other link leads to that vehicle."""
    for job in jobs:
        if job.state in WRITING and job.vehicle_id is not None and _needed(link, vehicles, job):
            raise LinkBusy(_refusal(link, job))


def _needed(link: Link, vehicles: VehicleRegistry, job: Job) -> bool:
    try:
        vehicle = vehicles.get(job.vehicle_id or "")
    except VehicleUnknown:  # not heard since a restart: it was spoken to over this link last
        return job.context.get(WAY) == link.id
    carrying = [channel.link for channel in vehicle.channels.alive]
    return link in vehicle.links and not any(other is not link for other in carrying)


def _refusal(link: Link, job: Job) -> str:
    stands = f"job {job.id} ({job.kind}) is {job.state.value.replace('_', ' ')} on vehicle {job.vehicle_id}"
    if job.state is JobState.IN_DOUBT:
        return (
            f"{stands}, which is heard on no other link than {link.id}: keep it disarmed and in reach until the write "
            "is finished or taken back, or open another link to it first"
        )
    return f"{stands} over link {link.id}: wait for its end, or open another link to the vehicle first"
