"""Routes of uploaded recordings; the work of a request ends when its client has disconnected."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Coroutine
from typing import Annotated, Any, TypeVar

from fastapi import APIRouter, HTTPException, Query, Request
from pydantic import ValidationError
from starlette.requests import ClientDisconnect

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.methods.names import ENTRIES
from mavcal.calib.report import to_json
from mavcal.service.api.dependencies import MadeDep, ServiceDep
from mavcal.service.api.models.fits import FitJobRequest, FitRequest, FitsModel
from mavcal.service.api.models.jobs import JobModel
from mavcal.service.api.models.recordings import (
    MethodModel,
    ReadingOptions,
    RecordingJobRequest,
    RecordingModel,
    SeriesModel,
)
from mavcal.service.api.security import OPERATE, READ, SightDep
from mavcal.service.api.views import job_model, job_summary, recording_model

T = TypeVar("T")
router = APIRouter(tags=["recordings"])
BYTES = {"type": "string", "format": "binary"}
"""Schema of a raw file; client generators skip operations whose body has no schema."""


class Body:
    """The request's body in chunks; `whole` is set when all of it is there."""

    def __init__(self, request: Request) -> None:
        self._request = request
        self.whole = asyncio.Event()

    async def chunks(self) -> AsyncIterator[bytes]:
        """The body. Raises HTTPException 408 if the client goes away."""
        try:
            async for chunk in self._request.stream():
                yield chunk
        except ClientDisconnect:
            raise _left() from None
        self.whole.set()


async def while_connected(request: Request, work: Coroutine[Any, Any, T], body: Body | None = None) -> T:
    """The result of `work`, which is cancelled when the client goes away.

    Parameters
    ----------
    request
        Whose client is watched.
    work
        The long-running work.
    body
        The body, if `work` reads it; None: it has been read.

    Raises
    ------
    HTTPException
        408, which nobody reads, if the client went away.
    """
    working = asyncio.ensure_future(work)
    gone = asyncio.ensure_future(_gone(request, body))
    try:
        await asyncio.wait({working, gone}, return_when=asyncio.FIRST_COMPLETED)
        if not working.done():
            raise _left()
        return working.result()
    finally:
        for task in (working, gone):
            task.cancel()
        await asyncio.gather(working, gone, return_exceptions=True)


async def _gone(request: Request, body: Body | None) -> None:
    if body is not None:
        await body.whole.wait()
    while (await request.receive())["type"] != "http.disconnect":
        pass


def _left() -> HTTPException:
    return HTTPException(408, "the client went away")


@router.post(
    "/recordings",
    operation_id="upload_recording",
    status_code=201,
    dependencies=[OPERATE],
    openapi_extra={"requestBody": {"required": True, "content": {"application/octet-stream": {"schema": BYTES}}}},
)
async def upload(
    request: Request,
    made: MadeDep,
    service: ServiceDep,
    name: Annotated[str, Query(min_length=1, max_length=200, description="file name, whose ending names the format")],
    reading: Annotated[str, Query(description="JSON of reading options: mapping, world, body, rate, units")] = "{}",
) -> RecordingModel:
    """Upload a recording as the body of the request."""
    body = Body(request)
    adding = service.recordings.add(name, body.chunks(), _reading(reading))
    return made(recording_model(await while_connected(request, adding, body)))


@router.get("/methods", operation_id="list_methods", dependencies=[READ])
async def methods() -> list[MethodModel]:
    """The methods that fit an uploaded recording."""
    return [MethodModel(name=name, summary=entry.summary) for name, entry in ENTRIES.items()]


@router.get("/recordings", operation_id="list_recordings", dependencies=[READ])
async def recordings(service: ServiceDep, sight: SightDep) -> list[RecordingModel]:
    """Every uploaded recording."""
    return [recording_model(row) for row in service.recordings.all()] if sight.everything else []


@router.get("/recordings/{recording_id}", operation_id="get_recording", dependencies=[READ])
async def recording(recording_id: str, service: ServiceDep) -> RecordingModel:
    """One uploaded recording, and what is in it."""
    return recording_model(service.recordings.get(recording_id))


@router.get("/recordings/{recording_id}/series", operation_id="list_series", dependencies=[READ])
async def series(recording_id: str, request: Request, service: ServiceDep) -> list[SeriesModel]:
    """The sensors of an uploaded recording over its time, thinned for a picture."""
    found = await while_connected(request, service.recordings.series(recording_id))
    return [SeriesModel.model_validate(one) for one in found]


@router.post("/recordings/{recording_id}/fits", operation_id="fit_recording", dependencies=[OPERATE])
async def fit(recording_id: str, body: FitRequest, request: Request, made: MadeDep, service: ServiceDep) -> FitsModel:
    """Run one method on an uploaded recording and wait for it; `POST /fits` does not wait.

    It is a job of kind `fit`, whose address is in Location. It is cancelled when the client goes away.
    """
    fitting = service.jobs.computing.fitted(recording_id, body.method, body.options)
    job = await while_connected(request, fitting)
    made(job_summary(job))
    return FitsModel.model_validate({"method": body.method, "fits": to_json(job.results)})


@router.post("/fits", operation_id="start_fit", status_code=202, dependencies=[OPERATE])
async def start_fit(body: FitJobRequest, made: MadeDep, service: ServiceDep) -> JobModel:
    """A job that runs one method on an uploaded recording: followed, cancelled and listed as every other job."""
    return made(job_model(await service.jobs.computing.fit(body.recording, body.method, body.options)))


@router.post("/recordings/{recording_id}/jobs", operation_id="plan_recording", status_code=202, dependencies=[OPERATE])
async def plan(recording_id: str, body: RecordingJobRequest, made: MadeDep, service: ServiceDep) -> JobModel:
    """A job that fits an uploaded recording; then it is in review, or failed if it is not of this vehicle's sensors.

    What it plans is accepted, written, proved and taken back as every other job's.
    """
    job = await service.jobs.adopt(body.vehicle_id, recording_id, body.method, body.options, body.plan_options.given())
    return made(job_model(job))


def _reading(text: str) -> dict[str, Any]:
    try:
        return ReadingOptions.model_validate_json(text).model_dump(exclude_unset=True)
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(str(p) for p in e['loc'])}: {e['msg']}".lstrip(": ") for e in error.errors())
        known = ", ".join(ReadingOptions.model_fields)
        raise InvalidInputError(f"`reading` is a JSON object of the reading options {known}: {faults}") from None
