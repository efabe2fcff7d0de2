"""Routes of campaigns: jobs of kind `campaign`, which go through many vehicles or uploads."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import suppress
from functools import partial
from typing import Annotated, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import StreamingResponse

from mavcal.service.api.dependencies import MadeDep, ServiceDep
from mavcal.service.api.jobs import JobDep
from mavcal.service.api.models.campaigns import (
    CalibrationCampaignRequest,
    FitCampaignRequest,
    GapCampaignRequest,
    ItemModel,
    PreflightCampaignRequest,
    RestoreCampaignRequest,
)
from mavcal.service.api.models.jobs import JobModel
from mavcal.service.api.security import OPERATE, READ, ActorDep, Scope, require
from mavcal.service.api.views import item_model, job_model
from mavcal.service.campaigns import outcome as table
from mavcal.service.campaigns.begin import CalibrationOrder, RestoreOrder
from mavcal.service.campaigns.items import Item, ItemOutcome, item_from_row
from mavcal.service.campaigns.vehicles import newest_of_item
from mavcal.service.core import Service
from mavcal.service.errors import JobUnknown
from mavcal.service.jobs.core.model import Job

router = APIRouter(tags=["campaigns"])
_PAGE = 500

Outcomes = Annotated[list[ItemOutcome] | None, Query(description="only items of these outcomes")]


@router.post("/campaigns/preflight", operation_id="start_preflight_campaign", status_code=202, dependencies=[OPERATE])
async def preflight(body: PreflightCampaignRequest, made: MadeDep, service: ServiceDep) -> JobModel:
    """Check many vehicles as one job. A vehicle that is armed, silent or busy is skipped, and its item says so."""
    chosen = await _vehicles(service, body.vehicles, body.tag)
    begun = service.campaigns.preflight(chosen, at_once=body.at_once)
    return made(job_model(await begun))


@router.post("/campaigns/calibrate", operation_id="start_calibration_campaign", status_code=202, dependencies=[OPERATE])
async def calibrate(
    body: CalibrationCampaignRequest, request: Request, made: MadeDep, service: ServiceDep, actor: ActorDep
) -> JobModel:
    """Calibrate many vehicles as one job, which begins a job for each. Without `apply` their plans wait in review."""
    if body.apply:
        await require(Scope.WRITE_PARAMS)(request)
    given = body.plan_options.given()
    order = CalibrationOrder(body.kind, body.options, given, body.apply, body.reboot, actor)
    chosen = await _vehicles(service, body.vehicles, body.tag)
    return made(job_model(await service.campaigns.calibrate(chosen, order, at_once=body.at_once)))


@router.post("/campaigns/restore", operation_id="start_restore_campaign", status_code=202, dependencies=[OPERATE])
async def restore(
    body: RestoreCampaignRequest, request: Request, made: MadeDep, service: ServiceDep, actor: ActorDep
) -> JobModel:
    """Put the last verified calibration of many vehicles back as a job; without `apply` their plans wait in review."""
    if body.apply:
        await require(Scope.WRITE_PARAMS)(request)
    order = RestoreOrder(body.plan_options.given(), body.apply, body.reboot, actor)
    chosen = await _vehicles(service, body.vehicles, body.tag)
    return made(job_model(await service.campaigns.restore(chosen, order, at_once=body.at_once)))


@router.post("/campaigns/fit", operation_id="start_fit_campaign", status_code=202, dependencies=[OPERATE])
async def fit(body: FitCampaignRequest, made: MadeDep, service: ServiceDep) -> JobModel:
    """Run one method on many uploads as one job; the fits are in its items."""
    uploads, chosen = service.recordings.all(), _named(body.recordings)
    begun = service.campaigns.fit(uploads, chosen, body.method, body.options, at_once=body.at_once)
    return made(job_model(await begun))


@router.post("/campaigns/gap", operation_id="start_gap_campaign", status_code=202, dependencies=[OPERATE])
async def gap(body: GapCampaignRequest, made: MadeDep, service: ServiceDep) -> JobModel:
    """Diagnose the sim-to-real gap of many uploads as one job; the reports are documents of its items."""
    uploads, chosen = service.recordings.all(), _named(body.recordings)
    begun = service.campaigns.gap(uploads, chosen, body.sim, body.nominal, at_once=body.at_once)
    return made(job_model(await begun))


@router.post("/campaigns/{job_id}/resume", operation_id="resume_campaign", status_code=202, dependencies=[OPERATE])
async def resume(job_id: str, request: Request, service: ServiceDep) -> JobModel:
    """Go on with a campaign that was interrupted; what has ended is not done again."""
    if service.jobs.get(job_id).options.get("apply"):
        await require(Scope.WRITE_PARAMS)(request)
    return job_model(await service.campaigns.campaigns.resume(job_id))


@router.post("/campaigns/{job_id}/interrupt", operation_id="interrupt_campaign", dependencies=[OPERATE])
async def interrupt(job_id: str, service: ServiceDep) -> JobModel:
    """Stop a running campaign so that it can be resumed; jobs that it has begun go on."""
    return job_model(await service.campaigns.campaigns.interrupt(job_id))


@router.get("/jobs/{job_id}/items", operation_id="list_items", dependencies=[READ])
async def items(
    response: Response,
    service: ServiceDep,
    found: JobDep,
    outcome: Outcomes = None,
    after: Annotated[int, Query(ge=0, le=2**31, description="number of the last item of the page before")] = 0,
    limit: Annotated[int, Query(ge=1, le=1000, description="most rows of a page")] = 100,
) -> list[ItemModel]:
    """Items of a campaign, a page at a time; other jobs have none. A header `Link` leads to the next page, if any."""
    page = await _page(service, found.id, outcome, after, limit + 1)
    if len(page) > limit:
        page = page[:limit]
        asked = [*(("outcome", o.value) for o in outcome or ()), ("after", page[-1].number), ("limit", limit)]
        response.headers["Link"] = f'<items?{urlencode(asked)}>; rel="next"'
    return [item_model(item, found.id, _job_of(item, found.id, service)) for item in page]


@router.get(
    "/jobs/{job_id}/items.{form}",
    operation_id="export_items",
    dependencies=[READ],
    response_class=Response,
    responses={200: {"content": {"text/csv": {"schema": {"type": "string"}}}}},
)
async def export_items(
    service: ServiceDep, found: JobDep, form: Literal["csv"], outcome: Outcomes = None
) -> StreamingResponse:
    """The outcome of a campaign as a table: one line an item."""
    headers = {"Content-Disposition": f'inline; filename="mavcal-{found.id}.{form}"'}
    return StreamingResponse(_lines(service, found.id, outcome), media_type="text/csv", headers=headers)


async def _lines(service: Service, job_id: str, outcome: Sequence[ItemOutcome] | None) -> AsyncIterator[str]:
    yield table.head()
    after = 0
    while page := await _page(service, job_id, outcome, after, _PAGE):
        yield table.lines(page)
        after = page[-1].number


async def _page(
    service: Service, job_id: str, outcome: Sequence[ItemOutcome] | None, after: int, limit: int
) -> list[Item]:
    wanted = None if outcome is None else [o.value for o in outcome]
    ask = partial(service.store.items, job_id, after=after, limit=limit, outcomes=wanted)
    return [item_from_row(row) for row in await service.store.do(ask)]


def _job_of(item: Item, campaign_id: str, service: Service) -> Job | None:
    """The job of an item, also while that runs; None: it has none, or it was forgotten."""
    if item.outcome is ItemOutcome.RUNNING:
        return newest_of_item(service.jobs.list(), campaign_id, item)
    with suppress(JobUnknown):
        return None if item.job_id is None else service.jobs.get(item.job_id)
    return None


async def _vehicles(service: Service, asked: Sequence[str], tag: str | None) -> Sequence[str]:
    """Ids of the vehicles that are named, or of all that are heard; with a `tag`: of those that carry it.

    One that is named and not heard stays: it may be heard later, and else its item says that it was not.
    """
    named = _named(asked)
    chosen = tuple(vehicle.id for vehicle in service.vehicles.all()) if named is None else named
    if tag is None:
        return chosen
    carrying = await service.fleet.tagged(tag)
    return tuple(vehicle for vehicle in chosen if vehicle in carrying)


def _named(asked: Sequence[str]) -> tuple[str, ...] | None:
    return None if asked == "all" else tuple(asked)
