"""A campaign of vehicles on the command line: find them, go through them, and stop so that it can be resumed."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcal.service.commands.campaign_told import Seen, Telling, followed, tell, write_table
from mavcal.service.commands.place import place_of
from mavcal.service.errors import VehicleSilent

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.client.jobs import JobModel
    from mavcal.client.models import ItemModel
    from mavcal.service.commands.door import Door
    from mavcal.service.commands.screen import Screen
    from mavcal.service.settings import Settings

    Begin = Callable[[AsyncClient, list[str]], Awaitable[JobModel]]
    """Makes the campaign for these vehicles, or goes on with one. Raises ServiceError."""

GATHER_S = 3.0
"""After the first vehicle of a link, others on it get so long to be heard: heartbeats come once a second."""
PAGE = 1000
"""Items of a page, at most."""


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

    async def begin(client: AsyncClient, _chosen: list[str]) -> JobModel:
        from mavcal.client.enums import JobState
        from mavcal.service.campaigns.campaigns import CAMPAIGN

        job = await client.get_job(job_id)
        if job.kind == CAMPAIGN and job.state == JobState.RUNNING:
            return job
        return await client.resume_campaign(job_id)

    return begin


async def _run(settings: Settings, begin: Begin, wish: VehicleWish, screen: Screen) -> int:
    from mavcal.service.commands.door import HURRY_S, door
    from mavcal.service.commands.headless import stoppable

    with stoppable() as caught:
        try:
            async with door(settings, wish.urls) as at:
                job = await begin(at.client, await _heard(at, wish, screen))
                screen.line(f"campaign {job.id}")
                try:
                    seen = await followed(lambda: _seen(at.client, job.id), screen)
                except asyncio.CancelledError:
                    await _put_down(at.client, job.id)
                    screen.line(f"stopped: `mavcal campaign resume {job.id}` goes on with it", bold=True)
                    await at.tidied(HURRY_S)
                    raise
                await at.tidied()
                return await _told(at.client, seen, wish, screen)
        except asyncio.CancelledError:
            if not caught:
                raise
            return 128 + caught[0]


async def _seen(client: AsyncClient, job_id: str) -> Seen:
    job = await client.get_job(job_id)
    told = job.model_dump(mode="json", include={"outcome", "progress"})
    return Seen(job.id, job.state.value, job.options, told["outcome"], told["progress"])


async def _told(client: AsyncClient, seen: Seen, wish: VehicleWish, screen: Screen) -> int:
    items = await _items(client, seen.id)
    if wish.table is not None:
        write_table(wish.table, await client.export_items(seen.id, "csv"), len(items))
    left_away = {"job_state", "preflight", "fits", "documents"}
    told = [item.model_dump(mode="json", exclude=left_away) for item in items]
    return tell(seen, told, Telling(as_json=wish.as_json), screen)


async def _items(client: AsyncClient, job_id: str) -> list[ItemModel]:
    found: list[ItemModel] = []
    while page := await client.list_items(job_id, after=found[-1].number if found else None, limit=PAGE):
        found += page
    return found


async def _heard(door: Door, wish: VehicleWish, screen: Screen) -> list[str]:
    """Ids of the vehicles on these links; an endpoint where none is heard stands for itself."""
    from mavcal.service.commands.headless import heard

    urls = tuple(dict.fromkeys(wish.urls))
    found = await asyncio.gather(*(heard(door, url, wish.wait_s, screen) for url in urls), return_exceptions=True)
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
    known = [vehicle.id for vehicle in await door.client.list_vehicles() if links.intersection(vehicle.links)]
    unknown = sorted(set(wish.ids) - set(known))
    if unknown:
        raise click.UsageError(f"no vehicle {', '.join(unknown)} was heard: there are {', '.join(known) or 'none'}")
    return list(wish.ids) or [*known, *silent]


async def _put_down(client: AsyncClient, campaign_id: str) -> None:
    """Leave a campaign because this process has to stop; captures end with it, writes are finished later."""
    from mavcal.service.jobs.core.states import CANCELLABLE, JobState

    await client.interrupt_campaign(campaign_id)
    for item in await _items(client, campaign_id):
        state = None if item.job_state is None else JobState(item.job_state.value)
        if item.job_id is not None and state in CANCELLABLE - {JobState.REVIEW}:
            await client.cancel_job(item.job_id)
