"""``mavcal accept JOB``: write the plan of a job that waits in review, without doing the calibration again."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.output import EXIT_NO, EXIT_PART, json_option, write_json
from mavcal.service.commands.place import CommandPlace
from mavcal.service.commands.plan_options import all_plan_options, given, options_of_plan
from mavcal.service.commands.remote import async_service_at, followed, may_be_remote, one_of, show_came_of
from mavcal.service.commands.review import JobWish, job_of, run_job, show_plan

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.client.jobs import JobModel
    from mavcal.client.models import VehicleModel
    from mavcal.service.commands.screen import Screen


@click.command()
@click.argument("job_id", metavar="JOB")
@click.option("--connect", default=None, metavar="URL", help="Endpoint of the vehicle, as udpin:0.0.0.0:14550.")
@may_be_remote
@click.option("--require-proof", is_flag=True, help="Exit code 3 if the streams prove a part of it, 1 if nothing.")
@click.option("--reboot", is_flag=True, help="Restart the vehicle if the plan needs it.")
@all_plan_options
@click.option("--data-dir", type=click.Path(path_type=Path), default=None, help="Where everything is kept.")
@click.option("--wait", type=float, default=30.0, show_default=True, help="How long to wait for a vehicle, s.")
@json_option
def command(
    *,
    job_id: str,
    connect: str | None,
    url: str | None,
    key_file: Path | None,
    require_proof: bool,
    reboot: bool,
    data_dir: Path | None,
    wait: float,
    as_json: bool,
    **more: Any,
) -> int:
    """Write what job JOB of this data directory, or of a running service, has planned, and prove it.

    The plan is made again from the job's fits and the vehicle's present parameters. Options of the plan are added to
    those that the job had. Exit code 1 if the write did not succeed; 3 if a sensor is left out, or with
    --require-proof the streams prove a part of it.
    """
    one_of(connect, url)
    decided = given(more)
    wish = JobWish(connect or "", write=True, require_proof=require_proof, reboot=reboot, wait_s=wait, as_json=as_json)
    if url is not None:
        return asyncio.run(_at_service(url, key_file, job_id, decided, wish))
    assert connect is not None
    settings = load_settings(data_dir=data_dir, connect=())

    async def begin(client: AsyncClient, vehicle: VehicleModel) -> tuple[JobModel, float]:
        job = await job_of(client, job_id, connect, vehicle)
        await client.renew_plan(job_id, plan_options=options_of_plan({**job.plan_options, **decided}))
        return await client.get_job(job_id), job.updated_at

    return run_job(settings, begin, wish)


async def _at_service(url: str, key_file: Path | None, job_id: str, decided: dict[str, Any], wish: JobWish) -> int:
    """Have a running service plan again and write; the exit code."""
    from mavcal.service.commands.screen import Screen

    screen = Screen(CommandPlace(url=url, key_file=key_file))
    async with async_service_at(url, key_file) as client:
        job = await _accepted(client, job_id, decided, wish, screen)
    show_came_of(job, screen)
    if wish.as_json:
        write_json(job.model_dump(mode="json"))
    if _good(job, wish):
        return EXIT_PART if job.left_out else 0
    return EXIT_PART if _partly_proved(job) and _good(job, replace(wish, require_proof=False)) else EXIT_NO


async def _accepted(
    client: AsyncClient, job_id: str, decided: dict[str, Any], wish: JobWish, screen: Screen
) -> JobModel:
    job = await client.get_job(job_id)
    plan = await client.renew_plan(job_id, plan_options=options_of_plan({**job.plan_options, **decided}))
    show_plan(plan, screen)
    job = await client.get_job(job_id)
    if plan.blockers or not plan.changes:
        return job
    await client.apply_plan(job_id, plan_sha256=plan.sha256, reboot=wish.reboot)
    return await followed(client, job_id, screen, since=job.updated_at)


def _good(job: JobModel, wish: JobWish) -> bool:
    """As :func:`review.good`, of a job that a service tells about."""
    from mavcal.client.enums import JobState, ProofLevel

    proved = job.outcome is not None and job.outcome.kind == "result" and job.outcome.proof == ProofLevel.FULL
    unneeded = job.plan is not None and not job.plan.changes
    return job.state == JobState.SUCCEEDED and (proved or unneeded or not wish.require_proof)


def _partly_proved(job: JobModel) -> bool:
    from mavcal.client.enums import ProofLevel

    return job.outcome is not None and job.outcome.kind == "result" and job.outcome.proof == ProofLevel.PARTIAL
