"""Checks after a write whether the vehicle would arm now, and what still prevents it."""

from __future__ import annotations

from mavcal.calib.errors import CalibError
from mavcal.calib.preflight.check import Readiness, readiness, unchecked
from mavcal.calib.report import from_json, to_json
from mavcal.service.errors import ServiceError, VehicleUnknown
from mavcal.service.jobs.core.admission import require_ready, require_vehicle
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.preflights import History, Preflights
from mavcal.service.vehicle.job_vehicle import VehicleSource

READINESS = "readiness"
"""Key of the readiness in a job's context."""


async def keep_readiness(handle: JobHandle, vehicles: VehicleSource, preflights: Preflights, history: History) -> None:
    """Run a preflight after a successful write, and keep its result in the job.

    Any other use of the vehicle meanwhile has priority; the result of the write stands either way.
    """
    if handle.job.state != JobState.SUCCEEDED:
        return
    try:
        vehicle = vehicles.vehicle(require_vehicle(handle.job))
        require_ready(vehicle, busy=True)
        found = await preflights.look(vehicle, history)
    except VehicleUnknown:
        return
    except (ServiceError, CalibError) as error:
        ready = unchecked(str(error))
    else:
        ready = unchecked("something else began with the vehicle.") if found is None else readiness(found.report)
    if handle.job.state == JobState.SUCCEEDED:  # it may be taken back by now
        handle.change(READINESS, to_json(ready), context={**handle.job.context, READINESS: to_json(ready)})


def readiness_of(job: Job) -> Readiness | None:
    """Readiness after the job's write; None: the vehicle was not asked, or the write was taken back."""
    kept = job.context.get(READINESS)
    return None if kept is None or job.state != JobState.SUCCEEDED else from_json(kept, Readiness)
