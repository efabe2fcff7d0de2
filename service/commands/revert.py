"""``mavcal revert JOB``: take back what a job has written, where it still stands."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.output import EXIT_NO, json_option, write_json
from mavcal.service.commands.remote import async_service_at, followed, may_be_remote, one_of, show_came_of
from mavcal.service.commands.review import JobWish, run_job

if TYPE_CHECKING:
    from mavcal.service.core import Service
    from mavcal.service.jobs.model import Job
    from mavcal.service.vehicle import Vehicle


@click.command()
@click.argument("job_id", metavar="JOB")
@click.option("--connect", default=None, metavar="URL", help="Endpoint of the vehicle, as udpin:0.0.0.0:14550.")
@may_be_remote
@click.option("--data-dir", type=click.Path(path_type=Path), default=None, help="Where everything is kept.")
@click.option("--wait", type=float, default=30.0, show_default=True, help="How long to wait for a vehicle, s.")
@json_option
def command(
    *,
    job_id: str,
    connect: str | None,
    url: str | None,
    key_file: Path | None,
    data_dir: Path | None,
    wait: float,
    as_json: bool,
) -> int:
    """Put back the values that job JOB of this data directory, or of a running service, has replaced.

    A parameter that somebody else has set since is left alone and named. Exit code 1 if the job was not taken back.
    """
    one_of(connect, url)
    if url is not None:
        return asyncio.run(_at_service(url, key_file, job_id, as_json=as_json))
    assert connect is not None
    settings = load_settings(data_dir=data_dir, connect=(connect,))

    async def begin(service: Service, vehicle: Vehicle) -> Job:
        from mavcal.service.commands.headless import is_of
        from mavcal.service.commands.review import writable
        from mavcal.service.errors import OtherVehicle

        job = service.jobs.get(job_id)
        if not is_of(service, job, vehicle):
            raise OtherVehicle(f"job {job_id} is of {job.vehicle_id}, but {connect} leads to {vehicle.id}")
        await writable(vehicle, wait)
        return await service.jobs.revert(job_id)

    return run_job(settings, begin, JobWish(write=True, wait_s=wait, as_json=as_json, revert=True))


async def _at_service(url: str, key_file: Path | None, job_id: str, *, as_json: bool) -> int:
    """Have a running service take it back; the exit code."""
    from mavcal.client.enums import JobState
    from mavcal.service.commands.screen import Screen

    screen = Screen()
    async with async_service_at(url, key_file) as client:
        before = await client.get_job(job_id)
        await client.revert_job(job_id)
        job = await followed(client, job_id, screen, since=before.updated_at)
    show_came_of(job, screen)
    if as_json:
        write_json(job.model_dump(mode="json"))
    return 0 if job.state == JobState.REVERTED else EXIT_NO
