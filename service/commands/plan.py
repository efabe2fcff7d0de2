"""``mavcal plan METHOD FILE``: turn the fit of a recording into a plan for the vehicle that made it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.calib.methods import METHODS
from mavcal.service.commands.calibrate import parsed
from mavcal.service.commands.headless import Begun
from mavcal.service.commands.output import json_option
from mavcal.service.commands.plan_options import all_plan_options, given, options_of_plan
from mavcal.service.commands.reading import readable_file, reading_options, split_reading
from mavcal.service.commands.review import JobWish, run_job
from mavcal.service.commands.whom import Whom, whom_options

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.client.models import VehicleModel

CHUNK = 1 << 20


@click.command()
@click.argument("method", type=click.Choice(list(METHODS)))
@click.argument("file")
@whom_options()
@click.option("--apply", "write", is_flag=True, help="Write the result to the vehicle and prove it.")
@click.option(
    "--require-proof", is_flag=True, help="With --apply: exit code 3 if the streams prove a part of it, 1 if nothing."
)
@click.option("--reboot", is_flag=True, help="With --apply: restart the vehicle if the plan needs it.")
@click.option("--option", "options", multiple=True, metavar="NAME=VALUE", help="Option of the method.")
@all_plan_options
@reading_options
@json_option
def command(
    *,
    whom: Whom,
    method: str,
    file: str,
    write: bool,
    require_proof: bool,
    reboot: bool,
    options: tuple[str, ...],
    as_json: bool,
    **more: Any,
) -> int:
    """Fit FILE and plan what it means for the vehicle; nothing is written without --apply.

    The log must be of this vehicle: the same sensors and the same board id. With --apply on a terminal the run asks
    about a log without a board id; a script gives --confirm-other-unit. The audit trail keeps who confirmed it. FILE
    is copied to where recordings are kept.

    Exit code 1 if there is no plan, or if its write did not succeed; 3 if a sensor is left out, or with
    --require-proof the streams prove a part of it.
    """
    if require_proof and not write:
        raise click.UsageError("--require-proof asks for a proof of what was written: give --apply too")
    path, chosen, decided = readable_file(file), parsed(options, words=True), given(more)
    reading, _ = split_reading(more)
    from mavcal.client.requests import ReadingOptions

    async def begin(client: AsyncClient, vehicle: VehicleModel) -> Begun:
        kept = await client.upload_recording(_chunks(path), name=path.name, reading=ReadingOptions(**reading))
        planned = client.plan_recording(
            kept.id, method=method, vehicle_id=vehicle.id, options=chosen, plan_options=options_of_plan(decided)
        )
        return Begun(await planned)

    return run_job(whom, begin, JobWish(write, require_proof, reboot, as_json))


async def _chunks(path: Path) -> AsyncIterator[bytes]:
    with path.open("rb") as file:
        while chunk := await asyncio.to_thread(file.read, CHUNK):
            yield chunk
