"""Routes for operators of the service: health, metrics, and discovery by host systems."""

from __future__ import annotations

import asyncio
import sys
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import JSONResponse, PlainTextResponse

from mavcal import calib
from mavcal.service.api.dependencies import ServiceDep
from mavcal.service.api.models.host import (
    AuditCheck,
    AuditPage,
    HealthModel,
    InfoModel,
    ReadinessModel,
    RegistrationModel,
    TicketModel,
)
from mavcal.service.api.models.wire import Json
from mavcal.service.api.problems import explanations
from mavcal.service.api.security import ADMIN, READ, TICKET_S, RequestGuard
from mavcal.service.hosts import cockpit_manifest, registration

router = APIRouter(tags=["host"])


@router.get("/healthz", operation_id="get_health")
async def healthz() -> HealthModel:
    """Whether the process answers."""
    return HealthModel(status="ok")


@router.get(
    "/readyz",
    operation_id="get_readiness",
    responses={
        200: {"model": ReadinessModel, "description": "Ready"},
        503: {"model": ReadinessModel, "description": "Not ready, with the reason"},
    },
)
async def readyz(service: ServiceDep) -> Response:
    """Whether jobs can be run: the store takes writes and nothing stands in the way."""
    obstacle = service.obstacle()
    if obstacle is None:
        return JSONResponse({"status": "ready"})
    return JSONResponse({"status": "not ready", "reason": obstacle}, status_code=503)


@router.get("/metrics", operation_id="get_metrics", dependencies=[READ], response_class=PlainTextResponse)
async def metrics(service: ServiceDep) -> Response:
    """Counters in the format of Prometheus."""
    from mavcal.service.counts import CONTENT_TYPE, counted

    return Response(counted(service), media_type=CONTENT_TYPE)


@router.get("/info", operation_id="get_info", dependencies=[READ])
async def info() -> InfoModel:
    """Name and versions."""
    return InfoModel(name="mavcal", version=calib.__version__, python=sys.version.split()[0])


@router.get("/register_service", operation_id="get_registration")
async def register_service() -> RegistrationModel:
    """How BlueOS lists the service."""
    return RegistrationModel.model_validate(registration())


@router.get("/cockpit_extras.json", include_in_schema=False)
async def cockpit_extras() -> Json:
    """What Cockpit shows of the service: a widget with the state of the calibrations."""
    return cockpit_manifest()


@router.get(
    "/problems/{code}",
    operation_id="explain_problem",
    response_class=PlainTextResponse,
    responses={404: {"description": "There is no such problem", "content": {"text/plain": {}}}},
)
async def explain(code: str) -> Response:
    """What a problem code means; the `type` of a problem document leads here."""
    text = explanations().get(code)
    status = 200 if text else 404
    return PlainTextResponse(text or "There is no such problem.", status_code=status)


@router.post("/api/v1/tickets", operation_id="make_ticket", status_code=201, dependencies=[READ])
async def ticket(request: Request) -> TicketModel:
    """Make a ticket for one event stream.

    A browser's EventSource cannot send headers: give it `?ticket=...` instead.
    """
    guard: RequestGuard = request.app.state.guard
    key = guard.authenticate(request)
    return TicketModel(ticket=guard.ticket(key) if key else "", valid_s=TICKET_S)


@router.get("/api/v1/audit", operation_id="list_audit", dependencies=[ADMIN])
async def audit(
    service: ServiceDep,
    after: Annotated[int, Query(ge=0, le=2**62, description="id of the last row of the page before")] = 0,
    limit: Annotated[int, Query(ge=1, le=1000, description="most rows of a page")] = 100,
) -> AuditPage:
    """Who asked for what, oldest first, a page at a time."""
    rows = await service.store.do(lambda: service.store.audit(after=after, limit=limit + 1))
    page = list(rows[:limit])
    return AuditPage(rows=page, next=page[-1].id if len(rows) > limit else None)


@router.get("/api/v1/audit/check", operation_id="check_audit", dependencies=[ADMIN])
async def check_audit(service: ServiceDep) -> AuditCheck:
    """Check the hash chain of the audit trail."""
    found = await asyncio.to_thread(service.store.check_audit)
    return AuditCheck(intact=found.intact, **vars(found))
