"""Routes of reviews: a plan in words and pictures, for the person who accepts it."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response

from mavcal.service.api.dependencies import ServiceDep
from mavcal.service.api.jobs import JobDep
from mavcal.service.api.models.plans import ReviewModel
from mavcal.service.api.security import READ
from mavcal.service.api.views import review_model
from mavcal.service.errors import PlanMissing
from mavcal.service.reviews import review_of

router = APIRouter(tags=["jobs"])
Columns = Annotated[int | None, Query(ge=1, le=9, description="charts a row; none: all in one row")]


@router.get("/jobs/{job_id}/review", operation_id="get_review", dependencies=[READ])
async def review(job: JobDep, service: ServiceDep) -> ReviewModel:
    """What the plan of a job does, and what speaks for and against it; 409 while there is no plan."""
    return review_model(job, await review_of(job, service.store))


@router.get(
    "/jobs/{job_id}/picture.svg",
    operation_id="get_picture",
    response_class=Response,
    responses={200: {"content": {"image/svg+xml": {"schema": {"type": "string"}}}}},
    dependencies=[READ],
)
async def picture(job: JobDep, service: ServiceDep, columns: Columns = None) -> Response:
    """Each sensor before and after the plan; 409 while there is no plan, or nothing of it can be drawn."""
    found = await review_of(job, service.store, columns=columns)
    if found.picture is None:
        raise PlanMissing(f"the plan of job {job.id} has no picture: what is in force is not known")
    return Response(str(found.picture), media_type="image/svg+xml")
