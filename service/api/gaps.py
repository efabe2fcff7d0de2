"""Routes of gap diagnoses: the jobs of kind `gap`, as diagnoses with their reports."""

from __future__ import annotations

from fastapi import APIRouter, Response

from mavcal.service.api.dependencies import MadeDep, ServiceDep
from mavcal.service.api.models.gaps import GapModel, GapRequest, GapSummary
from mavcal.service.api.security import OPERATE, READ, SightDep
from mavcal.service.api.views import document_response, gap_model, gap_summary
from mavcal.service.computations import PAGE, REPORT
from mavcal.service.core import Service
from mavcal.service.errors import GapUnfinished, GapUnknown, JobUnknown
from mavcal.service.jobs.core.model import Failure, Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.uploads import GAP

router = APIRouter(tags=["gaps"])


@router.post("/gaps", operation_id="diagnose_gap", status_code=202, dependencies=[OPERATE])
async def diagnose(body: GapRequest, made: MadeDep, service: ServiceDep) -> GapSummary:
    """Diagnose the sim-to-real gap of an uploaded recording; 429 if too many diagnoses are waiting."""
    return made(gap_summary(await service.jobs.computing.diagnose(body.real, body.sim, body.nominal, body.limit_s)))


@router.get("/gaps", operation_id="list_gaps", dependencies=[READ])
async def gaps(service: ServiceDep, sight: SightDep) -> list[GapSummary]:
    """Every diagnosis, oldest first, without its report."""
    return [gap_summary(job) for job in service.jobs.list() if job.kind == GAP and sight.job(job)]


@router.get("/gaps/{gap_id}", operation_id="get_gap", dependencies=[READ])
async def gap(gap_id: str, service: ServiceDep) -> GapModel:
    """Where a diagnosis stands, and its report once it is done."""
    job = _diagnosis(gap_id, service)
    done = job.state == JobState.SUCCEEDED
    return gap_model(job, await service.jobs.document(gap_id, REPORT) if done else None)


@router.get(
    "/gaps/{gap_id}/report.html",
    operation_id="get_gap_report",
    dependencies=[READ],
    response_class=Response,
    responses={200: {"content": {"text/html": {}}}},
)
async def page(gap_id: str, service: ServiceDep) -> Response:
    """The report as a page; 409 while there is none."""
    job = _diagnosis(gap_id, service)
    if job.state != JobState.SUCCEEDED:
        why = f": {job.outcome.cause}" if isinstance(job.outcome, Failure) else ""
        raise GapUnfinished(f"the diagnosis is {job.state}{why}")
    return document_response(await service.jobs.document(gap_id, PAGE))


def _diagnosis(gap_id: str, service: Service) -> Job:
    try:
        job = service.jobs.get(gap_id)
    except JobUnknown:
        job = None
    if job is None or job.kind != GAP:
        raise GapUnknown(f"there is no gap diagnosis {gap_id}; GET /api/v1/gaps lists them")
    return job
