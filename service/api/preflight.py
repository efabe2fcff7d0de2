"""Routes of preflights, and of putting the last verified calibration back."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from mavcal.service.api.addresses import relative
from mavcal.service.api.dependencies import ServiceDep
from mavcal.service.api.models.jobs import JobModel
from mavcal.service.api.models.preflight import PreflightModel, PreflightRequest, RestoreRequest
from mavcal.service.api.security import OPERATE, ActorDep, Scope, require
from mavcal.service.api.views import job_model, preflight_model
from mavcal.service.fixing import Fix, Fixable, fixed

router = APIRouter(tags=["vehicles"])


@router.post("/vehicles/{vehicle_id}/preflight", operation_id="run_preflight", dependencies=[OPERATE])
async def run(
    vehicle_id: str, body: PreflightRequest, request: Request, service: ServiceDep, actor: ActorDep
) -> PreflightModel:
    """Check a vehicle that stands still, in ten seconds (30 on a slow link).

    409 while it is armed, silent, or has a job running.
    """
    service.vehicles.get(vehicle_id)
    mended: tuple[Fix, ...] = ()
    if body.fix:
        await require(Scope.WRITE_PARAMS)(request)
        mended = await fixed(service.jobs, vehicle_id, [Fixable(kind) for kind in body.fix], actor=actor)
    return preflight_model(await service.jobs.preflight(vehicle_id, heading=body.heading), mended)


@router.post(
    "/vehicles/{vehicle_id}/restore", operation_id="restore_calibration", status_code=202, dependencies=[OPERATE]
)
async def restore(
    vehicle_id: str, body: RestoreRequest, request: Request, response: Response, service: ServiceDep
) -> JobModel:
    """Plan to put the last verified calibration of this unit back, mapped by device id; `apply` writes the plan.

    409 if no calibration of this very unit was verified here.
    """
    model = job_model(await service.jobs.restore(vehicle_id, body.given()))
    response.headers["Location"] = relative(request, model.href)
    return model
