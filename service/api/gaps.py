"""Routes of gap diagnoses."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Request, Response
from fastapi.responses import FileResponse

from mavcal.service.api.addresses import relative
from mavcal.service.api.dependencies import ServiceDep
from mavcal.service.api.models import GapModel, GapRequest, GapSummary
from mavcal.service.api.security import Scope, require
from mavcal.service.api.views import gap_model, gap_summary

router = APIRouter(tags=["gaps"])
READ = Depends(require(Scope.READ))
OPERATE = Depends(require(Scope.OPERATE))


@router.post("/gaps", status_code=202, dependencies=[OPERATE])
async def diagnose(body: GapRequest, request: Request, response: Response, service: ServiceDep) -> GapSummary:
    """Diagnose the sim-to-real gap of an uploaded recording; 429 if too many diagnoses are waiting."""
    model = gap_summary(service.gaps.start(body.real, body.sim, body.nominal))
    response.headers["Location"] = relative(request, model.href)
    return model


@router.get("/gaps", dependencies=[READ])
async def gaps(service: ServiceDep) -> list[GapSummary]:
    """Every diagnosis, oldest first, without its report."""
    return [gap_summary(row) for row in service.gaps.all()]


@router.get("/gaps/{gap_id}", dependencies=[READ])
async def gap(gap_id: str, service: ServiceDep) -> GapModel:
    """Where a diagnosis stands, and its report once it is done."""
    report = service.gaps.report(gap_id)  # which may find that the diagnosis failed
    return gap_model(service.gaps.get(gap_id), report)


@router.get(
    "/gaps/{gap_id}/report.html",
    dependencies=[READ],
    response_class=FileResponse,
    responses={200: {"content": {"text/html": {}}}},
)
async def page(gap_id: str, service: ServiceDep) -> FileResponse:
    """The report as a page; 409 while there is none."""
    return FileResponse(service.gaps.page(gap_id), media_type="text/html")
