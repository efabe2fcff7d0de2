"""A campaign of vehicles on the command line: find them, go through them, and stop so that it can be resumed."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcal.service.commands.campaign_told import Telling, followed, tell
from mavcal.service.commands.place import place_of
from mavcal.service.errors import VehicleSilent

if TYPE_CHECKING:
    from mavcal.service.commands.screen import Screen
    from mavcal.service.core import Service
    from mavcal.service.jobs.core.model import Job
    from mavcal.service.settings import Settings

    Begin = Callable[[Service, tuple[str, ...]], Awaitable[Job]]
    """Makes the campaign for these vehicles, or goes on with one. Raises ServiceError, CalibError."""

GATHER_S = 3.0
"""After the first vehicle of a link, others on it get so long to be heard: heartbeats come once a second."""


@dataclass(frozen=True)
class VehicleWish:
    """Which vehicles, and how the outcome is wanted."""

    urls: tuple[str, ...]
    ids: tuple[str, ...] = ()
    wait_s: float = 30.0
    table: Path | None = None
    as_json: bool = False


def run_vehicles(settings: Settings, begin: Begin, wish: VehicleWish) -> int:
    """One campaign from `begin` to its end; the exit code."""
    from mavcal.service.commands.screen import Screen
    from mavcal.service.logs import configure_logging

    configure_logging(as_json=settings.log_json)
    return asyncio.run(_run(settings, begin, wish, Screen(place_of(settings))))


def resumed(job_id: str) -> Begin:
    """Goes on with a campaign that was stopped, or follows one that goes on by itself."""

    async def begin(service: Service, _chosen: tuple[str, ...]) -> Job:
        from mavcal.service.campaigns.campaigns import CAMPAIGN
        from mavcal.service.jobs.core.states import JobState

        job = service.jobs.get(job_id)
        if job.kind == CAMPAIGN and job.state == JobState.RUNNING:
            return job
        return await service.campaigns.campaigns.resume(job_id)

    return begin


async def _run(settings: Settings, begin: Begin, wish: VehicleWish, screen: Screen) -> int:
    from mavcal.service.commands.headless import HURRY_S, stoppable, tidied
    from mavcal.service.core import running_service

    with stoppable() as caught:
        try:
            async with running_service(settings) as service:
                chosen = await _heard(service, wish, screen)
                job = await begin(service, chosen)
                screen.line(f"campaign {job.id}")
                try:
                    job = await followed(lambda: service.jobs.get(job.id), screen)
                except asyncio.CancelledError:
                    await _put_down(service, job.id)
                    screen.line(f"stopped: `mavcal campaign resume {job.id}` goes on with it", bold=True)
                    await tidied(service, HURRY_S)
                    raise
                await tidied(service)
                rows = await service.store.do(lambda: service.store.items(job.id, limit=_ALL))
                return tell(job, rows, Telling(wish.table, wish.as_json), screen)
        except asyncio.CancelledError:
            if not caught:
                raise
            return 128 + caught[0]


_ALL = 1_000_000


async def _heard(service: Service, wish: VehicleWish, screen: Screen) -> tuple[str, ...]:
    """Ids of the vehicles on these links; an endpoint where none is heard stands for itself."""
    from mavcal.service.commands.headless import heard

    urls = tuple(dict.fromkeys(wish.urls))
    found = await asyncio.gather(*(heard(service, url, wish.wait_s, screen) for url in urls), return_exceptions=True)
    silent = []
    for url, one in zip(urls, found, strict=True):
        if isinstance(one, VehicleSilent):
            screen.line(str(one))
            silent.append(url)
        elif isinstance(one, BaseException):
            raise one
    if len(silent) < len(urls):
        await asyncio.sleep(GATHER_S)
    links = {one.link for one in found if not isinstance(one, BaseException)}
    known = [vehicle.id for vehicle in service.vehicles.all() if links.intersection(vehicle.links)]
    unknown = sorted(set(wish.ids) - set(known))
    if unknown:
        raise click.UsageError(f"no vehicle {', '.join(unknown)} was heard: there are {', '.join(known) or 'none'}")
    return wish.ids or (*known, *silent)


async def _put_down(service: Service, campaign_id: str) -> None:
    """Leave a campaign because this process has to stop; captures end with it, writes are finished later."""
    from mavcal.service.campaigns.vehicles import BEGUN_BY
    from mavcal.service.jobs.core.states import CANCELLABLE, JobState

    await service.campaigns.campaigns.interrupt(campaign_id)
    for job in service.jobs.list():
        ours = (job.context.get(BEGUN_BY) or {}).get("id") == campaign_id
        if ours and job.state in CANCELLABLE - {JobState.REVIEW}:
            await service.jobs.cancel(job.id)
