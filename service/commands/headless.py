"""What the commands share that run a job without a panel: find the vehicle, follow a job, stop in an orderly way."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mavcal.service.commands.screen import Screen
    from mavcal.service.core import Service
    from mavcal.service.jobs.core.model import Job
    from mavcal.service.link import Link
    from mavcal.service.unfinished import Unfinished
    from mavcal.service.vehicle import Vehicle

QUIET_S = 3.0
"""A vehicle that is not heard by then is said to be waited for."""
DOUBT_S = 120.0
"""How long a job in doubt is waited for; the next run on this data directory goes on with it."""
TIDY_S = 30.0
"""How long the vehicle may take to confirm its old message rates."""
HURRY_S = 5.0
"""The same for a run that was told to stop."""


async def heard(service: Service, url: str, wait: float, screen: Screen) -> Vehicle:
    """The vehicle at the other end of this link, and of no other that the data directory remembers.

    Raises VehicleSilent if none is heard within `wait` seconds; meanwhile `screen` says what is waited for.
    """
    from mavcal.service.errors import VehicleSilent

    link = await service.links.open(url, remember=False, trusted=True)
    telling = asyncio.create_task(_tell_wait(link, url, wait, screen))
    try:
        async with asyncio.timeout(wait):
            return await service.vehicles.wait_for_vehicle(link)
    except TimeoutError:
        said = f" ({link.reason})" if link.reason else ""
        raise VehicleSilent(
            f"no vehicle was heard on {url} within {wait:g} s{said}: check its power and the link"
        ) from None
    finally:
        telling.cancel()


async def _tell_wait(link: Link, url: str, wait: float, screen: Screen) -> None:
    """Say that a vehicle is waited for, once for every reason."""
    told: set[str] = set()
    while True:
        await asyncio.sleep(QUIET_S)
        if link.reason not in told:
            told.add(link.reason)
            why = f" ({link.reason})" if link.reason else ""
            screen.line(f"waiting up to {wait:g} s for a vehicle on {url}{why}")


async def follow(service: Service, job_id: str, screen: Screen, after: int = 0, *, doubt_s: float = DOUBT_S) -> Job:
    """Show what happens after that event until the job ends, waits for acceptance, or stays in doubt for too long.

    What is in doubt is said once, however often the vehicle falls silent and comes back.
    """
    from mavcal.service.jobs.core.states import ENDED, JobState
    from mavcal.service.unfinished import ending, unfinished

    loop = asyncio.get_running_loop()
    told: set[str] = set()
    with suppress(TimeoutError):
        async with asyncio.timeout(None) as limit:
            if service.jobs.get(job_id).state is JobState.IN_DOUBT:
                limit.reschedule(loop.time() + doubt_s)
            async for event in service.jobs.subscribe(None, after):
                if event.job_id != job_id:
                    continue
                show_event(event.kind, event.data, screen)
                job = service.jobs.get(job_id)
                if job.state in ENDED | {JobState.REVIEW}:
                    return job
                if job.state is not JobState.IN_DOUBT:
                    limit.reschedule(None)
                elif limit.when() is None:
                    for sentence in ending(unfinished(service.store, job)):
                        if sentence not in told:  # a busy machine puts a job in doubt again and again
                            screen.line(sentence, bold=True)
                        told.add(sentence)
                    limit.reschedule(loop.time() + doubt_s)
    return service.jobs.get(job_id)


def show_event(kind: str, data: Mapping[str, Any], screen: Screen) -> None:
    """One event of a job, if it is one that a person reads."""
    if kind == "prompt" and data:
        screen.prompt(data["text"])
    elif kind == "progress":
        screen.progress(data)
    elif kind == "warning":
        screen.line(f"    note: {data['text']}")


@dataclass(frozen=True)
class Earlier:
    """What earlier runs left unfinished, as it was when this one began."""

    found: tuple[Unfinished, ...]
    event_id: int
    """The newest event then: what has happened since belongs to the recovery."""


def earlier(service: Service) -> Earlier:
    """To be asked before the vehicle is heard: from then on the engine goes on with these jobs by itself."""
    from mavcal.service.unfinished import left_over

    return Earlier(left_over(service.store, service.jobs.list()), service.store.last_event_id())


async def recovered(
    service: Service, vehicle: Vehicle, left: Earlier, screen: Screen, *, doubt_s: float = DOUBT_S
) -> tuple[Unfinished, ...]:
    """Bring to an end what earlier runs left unfinished on this vehicle; every such job, as it stands afterwards."""
    from mavcal.service.unfinished import beginning, ending, unfinished

    told = []
    for found in left.found:
        if not is_of(service, found.job, vehicle):
            continue
        screen.line(beginning(found), bold=True)
        if found.writing:
            await follow(service, found.job.id, screen, left.event_id, doubt_s=doubt_s)
        else:
            await service.jobs.cancel(found.job.id)
        now = unfinished(service.store, service.jobs.get(found.job.id))
        for sentence in ending(now):
            screen.line(f"    {sentence}")
        told.append(now)
    return tuple(told)


def is_of(service: Service, job: Job, vehicle: Vehicle) -> bool:
    """Whether the job is of this vehicle."""
    from mavcal.service.errors import VehicleUnknown

    if job.vehicle_id is None:
        return False
    with suppress(VehicleUnknown):
        return service.vehicles.get(job.vehicle_id) is vehicle
    return False


def told_of(found: Unfinished) -> dict[str, Any]:
    """A job that was recovered, or could not be, as JSON."""
    from mavcal.service.jobs.core.codec import to_json

    return {
        "id": found.job.id,
        "kind": found.job.kind,
        "vehicle_id": found.job.vehicle_id,
        "state": found.job.state.value,
        "outcome": to_json(found.job.outcome),
        "parameters": [vars(s) for s in found.standing],
    }


async def tidied(service: Service, seconds: float = TIDY_S) -> None:
    """Give the vehicle time to take its old message rates back; what is missing then, the next run does."""
    with suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await service.jobs.tidied()


async def put_down(service: Service, job_id: str, screen: Screen) -> None:
    """Leave a job because this process has to stop: cancel what wrote nothing, say what a write leaves behind."""
    from mavcal.service.jobs.core.states import CANCELLABLE, WRITING, JobState
    from mavcal.service.unfinished import unfinished

    job = service.jobs.get(job_id)
    if job.state in CANCELLABLE - {JobState.REVIEW}:
        await service.jobs.cancel(job_id)
        screen.line(f"stopped: job {job_id} ({job.kind}) was cancelled, nothing was written", bold=True)
    elif job.state in WRITING:
        names = unfinished(service.store, job).names
        may = f"{names} may hold new values" if names else "nothing was sent yet"
        screen.line(f"stopped while job {job_id} ({job.kind}) is {job.state.value}: {may}.", bold=True)
        screen.line("`mavcal recover` finishes it or takes it back, and so does the next calibration.")
    else:
        screen.line(f"stopped: job {job_id} ({job.kind}) is {job.state.value}", bold=True)
    await tidied(service, HURRY_S)


@contextmanager
def stoppable() -> Iterator[list[int]]:
    """SIGINT and SIGTERM cancel the present task; the list says which signals came."""
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    caught: list[int] = []

    def stop(number: int) -> None:
        caught.append(number)
        if task is not None:
            task.cancel()

    numbers = (signal.SIGINT, signal.SIGTERM)
    with suppress(NotImplementedError):  # not on every system: there the interpreter's own handling stays
        for number in numbers:
            loop.add_signal_handler(number, stop, number)
    try:
        yield caught
    finally:
        with suppress(NotImplementedError):
            for number in numbers:
                loop.remove_signal_handler(number)
