"""``mavcal revert JOB``: take back what a job has written, where it still stands."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.every import Acted, Whom, all_option, connect_option, run_every
from mavcal.service.commands.every import one_of as one_endpoint
from mavcal.service.commands.output import EXIT_NO, json_option, write_json
from mavcal.service.commands.place import CommandPlace
from mavcal.service.commands.remote import async_service_at, followed, may_be_remote, one_of, show_came_of
from mavcal.service.commands.review import JobWish, job_of, run_job, taken_back, writable

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.client.jobs import JobModel
    from mavcal.client.models import VehicleModel
    from mavcal.service.commands.door import Door


@click.command()
@click.argument("job_id", metavar="[JOB]", required=False)
@connect_option
@all_option
@may_be_remote
@click.option("--data-dir", type=click.Path(path_type=Path), default=None, help="Where everything is kept.")
@click.option("--wait", type=float, default=30.0, show_default=True, help="How long to wait for a vehicle, s.")
@json_option
def command(
    *,
    job_id: str | None,
    urls: tuple[str, ...],
    every: bool,
    url: str | None,
    key_file: Path | None,
    data_dir: Path | None,
    wait: float,
    as_json: bool,
) -> int:
    """Put back the values that job JOB of this data directory, or of a running service, has replaced.

    With --all it takes back every write of each vehicle, the last one first.

    A parameter that somebody else has set since is left alone and named. Exit code 1 if a job was not taken back; a
    vehicle to which nothing was written is no failure.
    """
    if (job_id is None) != every:
        raise click.UsageError("name the JOB, or give --all to take back every write of every vehicle")
    if every:
        if url is not None:
            raise click.UsageError("--all takes the vehicles of --connect or of the data directory, not of a --url")
        whom = Whom(urls, every, wait)

        async def act(door: Door, vehicle: VehicleModel) -> Acted:
            return await _all_writes(door.client, vehicle, wait)

        return run_every(whom.settings(data_dir), whom, act, as_json=as_json)
    name = str(job_id)
    one_of(urls[0] if urls else None, url)
    if url is not None:
        return asyncio.run(_at_service(url, key_file, name, as_json=as_json))
    connect = one_endpoint(urls)
    settings = load_settings(data_dir=data_dir, connect=())

    async def begin(client: AsyncClient, vehicle: VehicleModel) -> tuple[JobModel, float]:
        before = await job_of(client, name, connect, vehicle)
        await writable(client, vehicle, wait)
        return await client.revert_job(name), before.updated_at

    return run_job(settings, begin, JobWish(connect, write=True, wait_s=wait, as_json=as_json, revert=True))


async def _at_service(url: str, key_file: Path | None, job_id: str, *, as_json: bool) -> int:
    """Have a running service take it back; the exit code."""
    from mavcal.client.enums import JobState
    from mavcal.service.commands.screen import Screen

    screen = Screen(CommandPlace(url=url, key_file=key_file))
    async with async_service_at(url, key_file) as client:
        before = await client.get_job(job_id)
        await client.revert_job(job_id)
        job = await followed(client, job_id, screen, since=before.updated_at)
    show_came_of(job, screen)
    if as_json:
        write_json(job.model_dump(mode="json"))
    return 0 if job.state == JobState.REVERTED else EXIT_NO


async def _all_writes(client: AsyncClient, vehicle: VehicleModel, wait: float) -> Acted:
    """Take back every job that has written to this vehicle, the newest first: each finds the values that it wrote."""
    from mavcal.client.enums import JobState
    from mavcal.service.commands.hands_free import wait_for_job
    from mavcal.service.commands.headless import is_of, jobs_of

    written = [job for job in await jobs_of(client, state=JobState.SUCCEEDED) if job.last_write is not None]
    ours = [job for job in sorted(written, key=lambda j: -j.updated_at) if await is_of(client, job, vehicle)]
    if not ours:
        text = "nothing was written to it by a job of this data directory"
        return Acted(good=True, text=text, document={"jobs": []})
    done: list[JobModel] = []
    for job in ours:
        await writable(client, vehicle, wait)
        await client.revert_job(job.id)
        done.append(await wait_for_job(client, job.id))
        if not taken_back(done[-1]):
            break  # an older one must not put values back over what is in doubt
    told = [{"job": job.id, "kind": job.kind, "state": job.state.value, "text": _said(job)} for job in done]
    lines = [f"job {job.id} ({job.kind}) is {job.state.value}: {_said(job)}" for job in done]
    waiting = [f"job {job.id} ({job.kind}) was not tried" for job in ours[len(done) :]]
    return Acted(taken_back(done[-1]), " ".join([*lines, *waiting]), {"jobs": told})


def _said(job: JobModel) -> str:
    return "" if job.outcome is None else getattr(job.outcome, "text", "") or getattr(job.outcome, "cause", "")
