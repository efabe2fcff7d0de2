"""``mavcal accept JOB``: write the plan of a job that waits in review, without doing the calibration again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.headless import Begun
from mavcal.service.commands.output import json_option
from mavcal.service.commands.plan_options import all_plan_options, given, options_of_plan
from mavcal.service.commands.review import JobWish, job_of, run_job
from mavcal.service.commands.whom import Whom, whom_options

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.client.models import VehicleModel


@click.command()
@click.argument("job_id", metavar="JOB")
@whom_options(chosen=False)
@click.option("--require-proof", is_flag=True, help="Exit code 3 if the streams prove a part of it, 1 if nothing.")
@click.option("--reboot", is_flag=True, help="Restart the vehicle if the plan needs it.")
@all_plan_options
@json_option
def command(
    *,
    whom: Whom,
    job_id: str,
    require_proof: bool,
    reboot: bool,
    as_json: bool,
    **more: Any,
) -> int:
    """Write what job JOB of this data directory, or of a running service, has planned, and prove it.

    The plan is made again from the job's fits and the vehicle's present parameters. Options of the plan are added to
    those that the job had. Exit code 1 if the write did not succeed; 3 if a sensor is left out, or with
    --require-proof the streams prove a part of it.
    """
    decided = given(more)
    wish = JobWish(write=True, require_proof=require_proof, reboot=reboot, as_json=as_json)

    async def begin(client: AsyncClient, vehicle: VehicleModel) -> Begun:
        job = await job_of(client, job_id, whom, vehicle)
        await client.renew_plan(job_id, plan_options=options_of_plan({**job.plan_options, **decided}))
        return Begun(await client.get_job(job_id), job.updated_at, ours=False)

    return run_job(whom, begin, wish, job_id)
