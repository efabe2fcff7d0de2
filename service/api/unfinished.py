"""Routes of what interrupted runs have left on vehicles."""

from __future__ import annotations

from fastapi import APIRouter

from mavcal.service.api.dependencies import ServiceDep
from mavcal.service.api.models.jobs import UnfinishedModel
from mavcal.service.api.security import READ, SightDep
from mavcal.service.api.views import unfinished_model
from mavcal.service.unfinished import unfinished

router = APIRouter(tags=["jobs"])


@router.get("/unfinished", operation_id="list_unfinished", dependencies=[READ])
async def list_unfinished(service: ServiceDep, sight: SightDep) -> list[UnfinishedModel]:
    """Jobs that earlier runs have left unfinished, oldest first, as they were when this service began."""
    return [unfinished_model(found) for found in service.left if sight.job(found.job)]


@router.get("/jobs/{job_id}/unfinished", operation_id="get_unfinished", dependencies=[READ])
async def get_unfinished(job_id: str, service: ServiceDep) -> UnfinishedModel:
    """What a job has sent, and what is in doubt now."""
    return unfinished_model(unfinished(service.store, service.jobs.get(job_id)))
