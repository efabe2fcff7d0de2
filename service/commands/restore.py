"""``mavcal restore``: put the last verified calibration back, say after a firmware change that reset it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.output import json_option
from mavcal.service.commands.review import JobWish, run_job

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.client.jobs import JobModel
    from mavcal.client.models import VehicleModel


@click.command()
@click.option("--connect", required=True, metavar="URL", help="Endpoint of the vehicle, as udpin:0.0.0.0:14550.")
@click.option("--apply", "write", is_flag=True, help="Write the values to the vehicle.")
@click.option("--reboot", is_flag=True, help="With --apply: restart the vehicle if the plan needs it.")
@click.option("--only", metavar="SENSORS", help="Restore these sensors alone, as gyro0,accel0 (from 0).")
@click.option("--data-dir", type=click.Path(path_type=Path), default=None, help="Where everything is kept.")
@click.option("--wait", type=float, default=30.0, show_default=True, help="How long to wait for a vehicle, s.")
@json_option
def command(
    *,
    connect: str,
    write: bool,
    reboot: bool,
    only: str | None,
    data_dir: Path | None,
    wait: float,
    as_json: bool,
) -> int:
    """Put the parameters of the last verified calibration back, each to where its sensor is now.

    Device ids tell the sensors apart. What cannot be mapped is said and left alone. Nothing is written without
    --apply, and never to a vehicle with another unit id. Exit code 1 if there is nothing to restore from, or if the
    write did not succeed; 3 if a sensor is left out.
    """
    settings = load_settings(data_dir=data_dir, connect=())
    sensors = [part for part in only.split(",") if part] if only else None

    async def begin(client: AsyncClient, vehicle: VehicleModel) -> tuple[JobModel, float]:
        return await client.restore_calibration(vehicle.id, only=sensors), 0.0

    return run_job(settings, begin, JobWish(connect, write, reboot=reboot, wait_s=wait, as_json=as_json))
