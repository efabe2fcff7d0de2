"""``mavcal restore``: put the last verified calibration back, say after a firmware change that reset it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from mavcal.service.commands.headless import Begun
from mavcal.service.commands.output import json_option
from mavcal.service.commands.review import JobWish, run_job
from mavcal.service.commands.whom import Whom, whom_options

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.client.models import VehicleModel


@click.command()
@whom_options()
@click.option("--apply", "write", is_flag=True, help="Write the values to the vehicle.")
@click.option("--reboot", is_flag=True, help="With --apply: restart the vehicle if the plan needs it.")
@click.option("--only", metavar="SENSORS", help="Restore these sensors alone, as gyro0,accel0 (from 0).")
@json_option
def command(
    *,
    whom: Whom,
    write: bool,
    reboot: bool,
    only: str | None,
    as_json: bool,
) -> int:
    """Put the parameters of the last verified calibration back, each to where its sensor is now.

    Device ids tell the sensors apart. What cannot be mapped is said and left alone. Nothing is written without
    --apply, and never to a vehicle with another unit id. Exit code 1 if there is nothing to restore from, or if the
    write did not succeed; 3 if a sensor is left out.
    """
    sensors = [part for part in only.split(",") if part] if only else None

    async def begin(client: AsyncClient, vehicle: VehicleModel) -> Begun:
        return Begun(await client.restore_calibration(vehicle.id, only=sensors))

    return run_job(whom, begin, JobWish(write, reboot=reboot, as_json=as_json))
