"""``mavcal revert JOB``: take back what a job has written, where it still stands."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.output import json_option
from mavcal.service.commands.review import JobWish, run_job

if TYPE_CHECKING:
    from mavcal.service.core import Service
    from mavcal.service.jobs.model import Job
    from mavcal.service.vehicle import Vehicle


@click.command()
@click.argument("job_id", metavar="JOB")
@click.option("--connect", required=True, metavar="URL", help="Endpoint of the vehicle, as udpin:0.0.0.0:14550.")
@click.option("--data-dir", type=click.Path(path_type=Path), default=None, help="Where everything is kept.")
@click.option("--wait", type=float, default=30.0, show_default=True, help="How long to wait for a vehicle, s.")
@json_option
def command(*, job_id: str, connect: str, data_dir: Path | None, wait: float, as_json: bool) -> int:
    """Put back the values that job JOB of this data directory has replaced.

    A parameter that somebody else has set since is left alone and named. Exit code 1 if the job was not taken back.
    """
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
