"""Common part of the commands that run a job without a panel: find the vehicle, follow the job, stop in order."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import aclosing, asynccontextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mavcal.service.commands.door import HURRY_S, Door
from mavcal.service.commands.keyboard import Answer
from mavcal.service.commands.output import AnsweredNo
from mavcal.service.commands.screen import Screen
from mavcal.service.errors import ServiceError, VehicleSilent, VehicleUnknown

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.client.jobs import JobModel
    from mavcal.client.models import JobSummary, UnfinishedModel, VehicleModel
    from mavcal.service.jobs.core.states import JobState

QUIET_S = 3.0
"""Silence after which the wait for a vehicle is reported, s."""
DOUBT_S = 120.0
"""How long a job in doubt is awaited, s; the next run on this data directory continues it."""
LOOK_S = 0.05
"""Period of the question whether a vehicle has been heard, s."""
PAGE = 1000
"""Jobs of a page, at most."""


async def heard(door: Door, url: str, wait: float, screen: Screen) -> VehicleModel:
    """The vehicle at the other end of this link, and of no other that the data directory remembers.

    Raises VehicleSilent if none is heard within `wait` seconds; meanwhile `screen` says what is waited for.
    """
    link_id = await door.open(url)
    announcing = asyncio.create_task(_announce_wait(door.client, link_id, url, wait, screen))
    try:
        async with asyncio.timeout(wait):
            while not (found := await on_link(door.client, link_id)):  # noqa: ASYNC110 - a service is asked
                await asyncio.sleep(LOOK_S)
            return found[0]
    except TimeoutError:
        reason = await _reason(door.client, link_id)
        raise VehicleSilent(
            f"no vehicle was heard on {url} within {wait:g} s{reason}: check its power and the link"
        ) from None
    finally:
        announcing.cancel()


async def on_link(client: AsyncClient, link_id: str) -> list[VehicleModel]:
    """The vehicles of this link that have said who they are, in the order in which they were found."""
    if not (await client.get_link(link_id)).vehicles:
        return []
    return [vehicle for vehicle in await client.list_vehicles() if link_id in vehicle.links and vehicle.firmware]


async def _reason(client: AsyncClient, link_id: str) -> str:
    reason = (await client.get_link(link_id)).reason
    return f" ({reason})" if reason else ""


async def _announce_wait(client: AsyncClient, link_id: str, url: str, wait: float, screen: Screen) -> None:
    """Say that a vehicle is waited for, once for every reason."""
    shown: set[str] = set()
    while True:
        await asyncio.sleep(QUIET_S)
        if (why := await _reason(client, link_id)) not in shown:
            shown.add(why)
            screen.line(f"waiting up to {wait:g} s for a vehicle on {url}{why}")


def state_of(job: JobSummary | JobModel) -> JobState:
    """The state of a job as a member of ``service.jobs.core.states``."""
    from mavcal.service.jobs.core.states import JobState

    return JobState(job.state.value)


def rests(job: JobSummary | JobModel) -> bool:
    """Whether the job has ended, or its plan waits to be accepted."""
    from mavcal.service.jobs.core.states import ENDED, JobState

    return state_of(job) in ENDED | {JobState.REVIEW}


async def follow(
    client: AsyncClient, job_id: str, screen: Screen, since: float = 0.0, *, doubt_s: float = DOUBT_S
) -> JobModel:
    """Show what happens after that time until the job rests, or stays in doubt for too long.

    `since` is in s since 1970, by the clock of the service. A doubt is reported once, however often the vehicle falls
    silent and comes back.
    """
    from mavcal.service.jobs.core.states import JobState

    loop = asyncio.get_running_loop()
    shown: set[str] = set()
    job = await client.get_job(job_id)
    with suppress(TimeoutError):
        async with asyncio.timeout(None) as limit, aclosing(client.follow_job(job_id)) as events:  # type: ignore[type-var]
            if state_of(job) is JobState.IN_DOUBT:
                limit.reschedule(loop.time() + doubt_s)
            async for message in events:
                event = message.data
                if event.at <= since:
                    continue
                show_event(event.kind, event.data.model_dump(mode="json"), screen)
                if event.kind != "state":
                    continue
                job = await client.get_job(job_id)  # the event may be an old one
                if rests(job):
                    return job
                if state_of(job) is not JobState.IN_DOUBT:
                    limit.reschedule(None)
                elif limit.when() is None:
                    for sentence in (await client.get_unfinished(job_id)).ending:
                        if sentence not in shown:  # a busy machine puts a job in doubt again and again
                            screen.line(sentence, bold=True)
                        shown.add(sentence)
                    limit.reschedule(loop.time() + doubt_s)
    return await client.get_job(job_id)


def answering(client: AsyncClient, job_id: str, screen: Screen) -> Answer:
    """Passes typed lines to a job, and shows its refusals."""

    async def answer(line: str) -> None:
        try:
            await client.answer_job(job_id, value=line)
        except (ServiceError, AnsweredNo) as error:
            screen.line(f"    {error}")

    return answer


def show_event(kind: str, data: Mapping[str, Any], screen: Screen) -> None:
    """One event of a job, if it is one that a person reads."""
    if kind == "prompt" and data:
        screen.prompt(data["text"])
    elif kind == "progress":
        screen.progress(data)
    elif kind == "warning":
        screen.line(f"    note: {data['text']}")


async def left_over(door: Door) -> list[UnfinishedModel]:
    """Jobs that earlier runs have left unfinished; of a shared service only writes that are in doubt now."""
    from mavcal.client.enums import JobState

    begun = await door.client.list_unfinished()
    if not door.shared:
        return begun
    doubted = await jobs_of(door.client, state=JobState.IN_DOUBT)
    ids = dict.fromkeys([*(found.job.id for found in begun), *(job.id for job in doubted)])
    now = [await door.client.get_unfinished(job_id) for job_id in ids]
    return [found for found in now if found.writing and not found.ended]


async def recovered(
    door: Door, vehicle: VehicleModel, left: Sequence[UnfinishedModel], screen: Screen, *, doubt_s: float = DOUBT_S
) -> tuple[UnfinishedModel, ...]:
    """Jobs of earlier runs on this vehicle, after they were finished.

    `left` are these jobs as they were when the service began; they go on by themselves once the vehicle is heard.
    """
    client, ended = door.client, []
    for found in left:
        job = found.job
        if not await is_of(client, job, vehicle):
            continue
        screen.line(found.beginning, bold=True)
        if found.writing:
            await follow(client, job.id, screen, found.at, doubt_s=doubt_s)
        else:
            await client.cancel_job(job.id)
        now = await client.get_unfinished(job.id)
        for sentence in now.ending:
            screen.line(f"    {sentence}")
        ended.append(now)
    return tuple(ended)


async def is_of(client: AsyncClient, job: JobSummary | JobModel, vehicle: VehicleModel) -> bool:
    """Whether the job is of this vehicle, which may have had another name when it began."""
    if job.vehicle_id is None:
        return False
    with suppress(VehicleUnknown):
        return (await client.get_vehicle(job.vehicle_id)).id == vehicle.id
    return False


async def jobs_of(client: AsyncClient, **wanted: Any) -> list[JobSummary]:
    """Every job that is `wanted`, oldest first."""
    found: list[JobSummary] = []
    while page := await client.list_jobs(limit=PAGE, after=found[-1].id if found else None, **wanted):
        found += page
        if len(page) < PAGE:
            break
    return found


def recovery_document(found: UnfinishedModel) -> dict[str, Any]:
    """A job that was recovered, or could not be, as JSON."""
    about = found.job.model_dump(mode="json", include={"id", "kind", "vehicle_id", "state", "outcome"})
    return {**about, "parameters": [standing.model_dump(mode="json") for standing in found.standing]}


@dataclass(frozen=True)
class Begun:
    """A job that a command goes on with."""

    job: JobModel
    since: float = 0.0
    """Time up to which events are older than this command, s since 1970 by the clock of the service."""
    ours: bool = True
    """Whether this command has started it, and may cancel it."""


@asynccontextmanager
async def begun_by(making: Awaitable[Begun], leave: Callable[[Begun], Awaitable[None]]) -> AsyncIterator[Begun]:
    """Await the new job for the block; on cancellation, even while it is being created, `leave` handles it."""
    made = asyncio.ensure_future(making)
    try:
        yield await asyncio.shield(made)
    except asyncio.CancelledError:
        with suppress(TimeoutError, ServiceError, AnsweredNo):
            async with asyncio.timeout(HURRY_S):
                begun = await made
            await leave(begun)
        raise


async def leave_job(door: Door, screen: Screen, begun: Begun) -> None:
    """Leave a job because this process stops: cancel it if it wrote nothing, else print what it leaves behind."""
    from mavcal.service.jobs.core.states import CANCELLABLE, WRITING, JobState

    job_id = begun.job.id
    found = await door.client.get_unfinished(job_id)
    job, state = found.job, state_of(found.job)
    if begun.ours and state in CANCELLABLE - {JobState.REVIEW}:
        await door.client.cancel_job(job_id)
        screen.line(f"stopped: job {job_id} ({job.kind}) was cancelled, nothing was written", bold=True)
    elif state in WRITING:
        may = f"{', '.join(found.sent)} may hold new values" if found.sent else "nothing was sent yet"
        screen.line(f"stopped while job {job_id} ({job.kind}) is {state.value}: {may}.", bold=True)
        if door.shared:
            screen.line(f"The service goes on with it: `mavcal follow {job_id}` shows what comes of it.")
        else:
            screen.line("`mavcal recover` finishes it or takes it back, and so does the next calibration.")
    else:
        screen.line(f"stopped: job {job_id} ({job.kind}) is {state.value}", bold=True)
    await door.wait_for_cleanup(HURRY_S)
