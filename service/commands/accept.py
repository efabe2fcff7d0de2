"""``mavcal accept JOB``: write the plan of a job that waits in review, without doing the calibration again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.output import json_option
from mavcal.service.commands.plan_options import all_plan_options, given
from mavcal.service.commands.review import JobWish, run_job

if TYPE_CHECKING:
    from mavcal.service.core import Service
    from mavcal.service.jobs.model import Job
    from mavcal.service.vehicle import Vehicle


@click.command()
@click.argument("job_id", metavar="JOB")
@click.option("--connect", required=True, metavar="URL", help="Endpoint of the vehicle, as udpin:0.0.0.0:14550.")
@click.option("--require-proof", is_flag=True, help="Exit code 1 unless the streams prove all of it.")
@click.option("--reboot", is_flag=True, help="Restart the vehicle if the plan needs it.")
@all_plan_options
@click.option("--data-dir", type=click.Path(path_type=Path), default=None, help="Where everything is kept.")
@click.option("--wait", type=float, default=30.0, show_default=True, help="How long to wait for a vehicle, s.")
@json_option
def command(
    *,
    job_id: str,
    connect: str,
    require_proof: bool,
    reboot: bool,
    data_dir: Path | None,
    wait: float,
    as_json: bool,
    **more: Any,
) -> int:
    """Write what job JOB of this data directory has planned, and prove it.

    The plan is made again from the job's fits and the vehicle's present parameters. Options of the plan are added to
    those that the job had. Exit code 1 if the write did not succeed.
    """
    settings = load_settings(data_dir=data_dir, connect=(connect,))
    decided = given(more)

    async def begin(service: Service, vehicle: Vehicle) -> Job:
        from mavcal.service.commands.headless import is_of
        from mavcal.service.errors import OtherVehicle

        job = service.jobs.get(job_id)
        if not is_of(service, job, vehicle):
            raise OtherVehicle(f"job {job_id} is of {job.vehicle_id}, but {connect} leads to {vehicle.id}")
        return await service.jobs.plan_again(job_id, {**job.context.get("plan_options", {}), **decided})

    wish = JobWish(write=True, require_proof=require_proof, reboot=reboot, wait_s=wait, as_json=as_json)
    return run_job(settings, begin, wish)
