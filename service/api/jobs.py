"""Routes of jobs, and one event stream for the whole service: jobs, vehicles and links.

A review is a plan in words and pictures, for the person who accepts it. Unfinished work was left on a vehicle by an
interrupted run.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing
from typing import Annotated, Literal, cast
from urllib.parse import urlencode

import structlog
from fastapi import APIRouter, Depends, Header, Path, Query, Request, Response
from fastapi.sse import EventSourceResponse, ServerSentEvent

from mavcal.calib.procedures.registry import PROCEDURES
from mavcal.service.api.dependencies import MadeDep, ServiceDep
from mavcal.service.api.models.jobs import AnswerRequest, JobModel, JobRequest, JobSummary, UnfinishedModel
from mavcal.service.api.models.plans import ApplyRequest, PlanModel, PlanRequest, ReviewModel
from mavcal.service.api.models.steps import ProcedureModel
from mavcal.service.api.models.vehicles import LinkModel, VehicleModel
from mavcal.service.api.paging import page_of
from mavcal.service.api.security import OPERATE, READ, WRITE, ActorDep, SightDep
from mavcal.service.api.sight import Sight
from mavcal.service.api.views import (
    document_response,
    event_model,
    job_model,
    job_summary,
    link_model,
    plan_model,
    procedure_model,
    review_model,
    unfinished_model,
    vehicle_model,
)
from mavcal.service.core import Service
from mavcal.service.errors import PlanMissing
from mavcal.service.exports import MEDIA_TYPES, export
from mavcal.service.jobs.core.model import Accept, Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.reviews import review_of
from mavcal.service.unfinished import unfinished

log = structlog.get_logger(__name__)

LOOK_S = 0.5
"""Period of the look at vehicles and links, s."""
STEADY = {"received", "lost", "loss", "bytes_per_s", "evidence", "crc_errors"}
"""Fields that change all the time, and alone make no event."""

Name = tuple[str, str]
"""`vehicle` or `link`, and its id."""
State = VehicleModel | LinkModel
router = APIRouter(tags=["jobs"])
LastEventId = Annotated[
    int | None, Header(alias="Last-Event-ID", ge=0, le=2**62, description="id of the last message that was heard")
]


class ChangeWatch:
    """Polls vehicles and links once for all open streams, and wakes them when a state has changed."""

    def __init__(self, look: Callable[[], list[tuple[str, State]]]) -> None:
        self._ask = look
        self._states: dict[Name, tuple[str, State]] = {}
        self._news = asyncio.Event()
        self._streams = 0
        self._looking: asyncio.Task[None] | None = None

    async def changes(self) -> AsyncIterator[tuple[str, State]]:
        """Every state now, and then each one that has changed, for ever."""
        sent: dict[Name, str] = {}
        self._streams += 1
        self._look()
        if self._looking is None:
            self._looking = asyncio.create_task(self._run())
        try:
            while True:
                news = self._news
                for name, (text, state) in self._states.items():
                    if sent.get(name) != text:
                        sent[name] = text
                        yield name[0], state
                if news is self._news:  # else a look came in between
                    await news.wait()
        finally:
            self._streams -= 1
            if self._streams == 0:
                self._looking.cancel()
                self._looking = None

    async def _run(self) -> None:
        while True:
            await asyncio.sleep(LOOK_S)
            try:
                self._look()
            except Exception:  # a state that cannot be told once must not silence every stream; logged with its trace
                log.exception("vehicles and links could not be looked at")

    def _look(self) -> None:
        found = {(name, s.id): (s.model_dump_json(exclude=STEADY), s) for name, s in self._ask()}
        if {name: text for name, (text, _) in found.items()} == {
            name: text for name, (text, _) in self._states.items()
        }:
            return
        self._states = found
        news, self._news = self._news, asyncio.Event()
        news.set()


def watch_of(service: Service) -> ChangeWatch:
    """A watch over the vehicles and links of a service."""

    def states() -> list[tuple[str, State]]:
        vehicles = [("vehicle", vehicle_model(v)) for v in service.vehicles.all()]
        links = [("link", link_model(link, service.vehicles)) for link in service.links.all()]
        return [*vehicles, *links]

    return ChangeWatch(states)


def _watch(request: Request) -> ChangeWatch:
    state = request.app.state
    if getattr(state, "watch", None) is None:
        state.watch = watch_of(state.service)
    return cast(ChangeWatch, state.watch)


WatchDep = Annotated[ChangeWatch, Depends(_watch)]


async def everything(service: Service, watch: ChangeWatch, sight: Sight, after: int) -> AsyncIterator[ServerSentEvent]:
    """Events of jobs after the id `after`; vehicles and links whenever their state has changed."""
    queue: asyncio.Queue[ServerSentEvent | None] = asyncio.Queue(maxsize=1)
    reading = [
        asyncio.create_task(_states(watch, sight, queue)),
        asyncio.create_task(_events(service, sight, after, queue)),
    ]
    try:
        while (event := await queue.get()) is not None:
            yield event
    finally:
        for task in reading:
            task.cancel()
        await asyncio.gather(*reading, return_exceptions=True)


async def _states(watch: ChangeWatch, sight: Sight, queue: asyncio.Queue[ServerSentEvent | None]) -> None:
    async with aclosing(watch.changes()) as states:  # type: ignore[type-var]
        async for name, state in states:
            seen = sight.link(state) if isinstance(state, LinkModel) else state if sight.vehicle(state.id) else None
            if seen is not None:
                await queue.put(ServerSentEvent(data=seen, event=name))


async def _events(service: Service, sight: Sight, after: int, queue: asyncio.Queue[ServerSentEvent | None]) -> None:
    async with aclosing(service.jobs.subscribe(None, after)) as events:  # type: ignore[type-var]
        async for event in events:
            if sight.job_of(event.job_id):
                await queue.put(ServerSentEvent(data=event_model(event), event="job", id=str(event.id)))
    await queue.put(None)


def _job(job_id: str, service: ServiceDep) -> Job:
    return service.jobs.get(job_id)


JobDep = Annotated[Job, Depends(_job)]
"""The job of the address. A stream can answer 404 only here, before it begins."""


def _plan_of(job: Job) -> PlanModel:
    if job.plan is None:
        raise PlanMissing(f"job {job.id} has no plan (yet): its state tells why")
    return plan_model(job.plan)


@router.get("/procedures", operation_id="list_procedures", dependencies=[READ])
async def procedures() -> list[ProcedureModel]:
    """What can be calibrated, what each procedure needs, ends on, writes and cannot represent."""
    return [procedure_model(spec) for spec in PROCEDURES.values()]


@router.post("/vehicles/{vehicle_id}/jobs", operation_id="start_job", status_code=202, dependencies=[OPERATE])
async def start(vehicle_id: str, body: JobRequest, made: MadeDep, service: ServiceDep) -> JobModel:
    """Start a calibration; 409 if that vehicle has one running."""
    job = await service.jobs.submit(vehicle_id, body.kind, body.options, body.plan_options.given())
    return made(job_model(job))


@router.get("/jobs", operation_id="list_jobs", dependencies=[READ])
async def jobs(
    response: Response,
    service: ServiceDep,
    sight: SightDep,
    *,
    vehicle_id: str | None = None,
    kind: Annotated[str | None, Query(max_length=100, description="such as gyro, fit or gap")] = None,
    state: JobState | None = None,
    order: Literal["oldest", "newest"] = "oldest",
    limit: Annotated[int, Query(ge=1, le=1000, description="most jobs of a page")] = 1000,
    after: Annotated[str | None, Query(max_length=100, description="id of the last job of the page before")] = None,
) -> list[JobSummary]:
    """Jobs of every kind, a page at a time. A header `Link` with `rel="next"` leads to the next page, if any."""
    wanted = {"vehicle_id": vehicle_id, "kind": kind, "state": state}
    given = {name: value for name, value in wanted.items() if value is not None}
    asked_for = [j for j in service.jobs.list() if all(getattr(j, name) == value for name, value in given.items())]
    found = [job for job in asked_for if sight.job(job)]
    page, more = page_of(found if order == "oldest" else found[::-1], after, limit)
    if more:
        query = urlencode({**given, "order": order, "limit": limit, "after": page[-1].id}, errors="replace")
        response.headers["Link"] = f'<jobs?{query}>; rel="next"'
    return [job_summary(job) for job in page]


@router.get("/jobs/{job_id}", operation_id="get_job", dependencies=[READ])
async def job(found: JobDep) -> JobModel:
    """One job with its results."""
    return job_model(found)


@router.delete("/jobs/{job_id}", operation_id="cancel_job", dependencies=[OPERATE])
async def cancel(job_id: str, service: ServiceDep) -> JobModel:
    """Cancel a job that has not written anything."""
    return job_model(await service.jobs.cancel(job_id))


@router.post("/jobs/{job_id}/answers", operation_id="answer_job", dependencies=[OPERATE])
async def answer(job_id: str, body: AnswerRequest, service: ServiceDep) -> JobModel:
    """Answer the prompt of a job."""
    return job_model(await service.jobs.answer(job_id, body.value))


@router.get("/jobs/{job_id}/plan", operation_id="get_plan", dependencies=[READ])
async def plan(found: JobDep) -> PlanModel:
    """What would be written, why, and what it costs."""
    return _plan_of(found)


@router.post("/jobs/{job_id}/plan", operation_id="renew_plan", dependencies=[OPERATE])
async def plan_again(job_id: str, service: ServiceDep, body: PlanRequest | None = None) -> PlanModel:
    """Plan again on the vehicle's present parameters: what `apply` asks for when something has changed.

    `plan_options` decide about the plan in place of what was decided before; without them it stays so.
    """
    options = None if body is None or body.plan_options is None else body.plan_options.given()
    return _plan_of(await service.jobs.plan_again(job_id, options))


@router.post("/jobs/{job_id}/refit", operation_id="refit_job", status_code=202, dependencies=[OPERATE])
async def refit(job_id: str, service: ServiceDep) -> JobModel:
    """Fit what an interrupted job has recorded."""
    return job_model(await service.jobs.refit(job_id))


@router.post("/jobs/{job_id}/apply", operation_id="apply_plan", status_code=202, dependencies=[WRITE])
async def apply(
    job_id: str,
    body: ApplyRequest,
    service: ServiceDep,
    actor: ActorDep,
    idempotency_key: Annotated[str | None, Header(min_length=1, max_length=200)] = None,
) -> JobModel:
    """Accept the plan with this digest and write it; 409 if it is no longer the plan to be written.

    A repeated Idempotency-Key answers with the job and writes nothing, unless its write ended before anything was sent.
    """
    accept = Accept(body.plan_sha256, reboot=body.reboot, prove_s=body.prove_s, actor=actor)
    return job_model(await service.jobs.apply(job_id, accept, idempotency_key, look=body.preflight))


@router.post("/jobs/{job_id}/revert", operation_id="revert_job", status_code=202, dependencies=[WRITE])
async def revert(job_id: str, service: ServiceDep, actor: ActorDep) -> JobModel:
    """Take back what a job has written, where it still stands."""
    return job_model(await service.jobs.revert(job_id, actor))


@router.get(
    "/jobs/{job_id}/export.{form}",
    operation_id="export_job",
    dependencies=[READ],
    response_class=Response,
    responses={200: {"content": {kind: {"schema": {"type": "string"}} for kind in sorted(set(MEDIA_TYPES.values()))}}},
)
async def export_job(
    found: JobDep, service: ServiceDep, form: Annotated[str, Path(json_schema_extra={"enum": list(MEDIA_TYPES)})]
) -> Response:
    """The result as a file: param, parm, params, json, csv or html."""
    content = await asyncio.to_thread(export, found, form, service.store)
    name = f"mavcal-{found.id}.{form}"
    return Response(
        content, media_type=MEDIA_TYPES[form], headers={"Content-Disposition": f'inline; filename="{name}"'}
    )


@router.get(
    "/jobs/{job_id}/documents/{name}",
    operation_id="get_document",
    dependencies=[READ],
    response_class=Response,
    responses={200: {"content": {"application/json": {}, "text/html": {}}}},
)
async def job_document(found: JobDep, name: str, service: ServiceDep) -> Response:
    """A document that the job has made, such as the report of a diagnosis."""
    return document_response(await service.jobs.document(found.id, name))


@router.get("/jobs/{job_id}/events", operation_id="follow_job", response_class=EventSourceResponse, dependencies=[READ])
async def job_events(
    found: JobDep, service: ServiceDep, sight: SightDep, last_event_id: LastEventId = None
) -> AsyncIterator[ServerSentEvent]:
    """Everything that happens to a job, from its beginning or from Last-Event-ID on."""
    async for event in service.jobs.subscribe(found.id, last_event_id or 0):
        if not sight.job(found):  # its vehicle has lost the tag since
            return
        yield ServerSentEvent(data=event_model(event), event="job", id=str(event.sequence))


@router.get("/events", operation_id="follow_events", response_class=EventSourceResponse, dependencies=[READ])
async def events(
    service: ServiceDep, watch: WatchDep, sight: SightDep, last_event_id: LastEventId = None
) -> AsyncIterator[ServerSentEvent]:
    """Everything that happens: to any job, from now or from Last-Event-ID on, and to vehicles and links.

    Events named `job` have ids and are replayed; `vehicle` and `link` carry the present state as soon as it changes.
    """
    after = await service.store.do(service.store.last_event_id) if last_event_id is None else last_event_id
    async for event in everything(service, watch, sight, after):
        yield event


@router.get("/unfinished", operation_id="list_unfinished", dependencies=[READ])
async def list_unfinished(service: ServiceDep, sight: SightDep) -> list[UnfinishedModel]:
    """Jobs that earlier runs have left unfinished, oldest first, as they were when this service began."""
    return [unfinished_model(found) for found in service.left if sight.job(found.job)]


@router.get("/jobs/{job_id}/unfinished", operation_id="get_unfinished", dependencies=[READ])
async def get_unfinished(job_id: str, service: ServiceDep) -> UnfinishedModel:
    """What a job has sent, and what is in doubt now."""
    return unfinished_model(unfinished(service.store, service.jobs.get(job_id)))


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
