"""A campaign of vehicles on the command line: find them, go through them, and stop so that it can be resumed."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import partial

import click

from mavcal.client import AsyncClient, enums
from mavcal.service.campaigns.campaigns import CAMPAIGN
from mavcal.service.commands.campaign_items import OF_HTTP, items_of
from mavcal.service.commands.campaign_output import (
    CampaignSnapshot,
    OutputOptions,
    followed,
    print_campaign,
    write_table,
)
from mavcal.service.commands.door import HURRY_S, Door, through_door
from mavcal.service.commands.headless import Begun, begun_by, heard
from mavcal.service.commands.screen import Screen
from mavcal.service.commands.vehicles import served
from mavcal.service.commands.whom import Whom
from mavcal.service.errors import VehicleSilent
from mavcal.service.jobs.core.states import CANCELLABLE, JobState

Begin = Callable[[AsyncClient, list[str]], Awaitable[Begun]]
"""Makes the campaign for these vehicles, or goes on with one. Raises ServiceError."""
GATHER_S = 3.0
"""After the first vehicle of a link, others on it get so long to be heard: heartbeats come once a second."""


def run_vehicles(whom: Whom, begin: Begin, output: OutputOptions) -> int:
    """One campaign from `begin` to its end; the exit code."""
    return through_door(whom, partial(_run, whom=whom, begin=begin, output=output, screen=Screen(whom.place)))


def resumed(job_id: str) -> Begin:
    """Goes on with a campaign that was stopped, or follows one that goes on by itself."""

    async def begin(client: AsyncClient, _chosen: list[str]) -> Begun:

        job = await client.get_job(job_id)
        if job.kind == CAMPAIGN and job.state == enums.JobState.RUNNING:
            return Begun(job, ours=False)
        return Begun(await client.resume_campaign(job_id))

    return begin


async def _run(at: Door, *, whom: Whom, begin: Begin, output: OutputOptions, screen: Screen) -> int:
    chosen = await _heard(at, whom, screen)
    async with begun_by(begin(at.client, chosen), partial(_leave_campaign, at, screen)) as begun:
        screen.line(f"campaign {begun.job.id}")
        snapshot = await followed(lambda: _snapshot(at.client, begun.job.id), screen)
    await at.wait_for_cleanup()
    return await _print_outcome(at.client, snapshot, output, screen)


async def _snapshot(client: AsyncClient, job_id: str) -> CampaignSnapshot:
    job = await client.get_job(job_id)
    document = job.model_dump(mode="json", include={"outcome", "progress"})
    return CampaignSnapshot(job.id, job.state.value, job.options, document["outcome"], document["progress"])


async def _print_outcome(client: AsyncClient, snapshot: CampaignSnapshot, output: OutputOptions, screen: Screen) -> int:
    items = await items_of(client, snapshot.id)
    if output.table is not None:
        write_table(output.table, await client.export_items(snapshot.id, "csv"), len(items))
    documents = [item.model_dump(mode="json", exclude=OF_HTTP) for item in items]
    return print_campaign(snapshot, documents, output, screen)


async def _heard(door: Door, whom: Whom, screen: Screen) -> list[str]:
    """Ids of the vehicles on these links, or of a service; an endpoint where none is heard stands for itself."""
    if door.shared:
        return [vehicle.id for vehicle in await served(door.client, replace(whom, every=not whom.ids), screen)]
    urls = tuple(dict.fromkeys(whom.urls))
    found = await asyncio.gather(*(heard(door, url, whom.wait_s, screen) for url in urls), return_exceptions=True)
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
    unknown = sorted(set(whom.ids) - set(known))
    if unknown:
        raise click.UsageError(f"no vehicle {', '.join(unknown)} was heard: there are {', '.join(known) or 'none'}")
    return list(whom.ids) or [*known, *silent]


async def _leave_campaign(door: Door, screen: Screen, begun: Begun) -> None:
    """Leave a campaign because this process has to stop; captures end with it, writes are finished later.

    One that a service that others use went on with before is left alone.
    """
    job_id = begun.job.id
    if door.shared and not begun.ours:
        screen.line(f"stopped: the service goes on with campaign {job_id}", bold=True)
        return
    await door.client.interrupt_campaign(job_id)
    for item in await items_of(door.client, job_id):
        state = None if item.job_state is None else JobState(item.job_state.value)
        if item.job_id is not None and state in CANCELLABLE - {JobState.REVIEW}:
            await door.client.cancel_job(item.job_id)
    screen.line(f"stopped: `mavcal campaign resume {job_id}` goes on with it", bold=True)
    await door.wait_for_cleanup(HURRY_S)
