"""``mavcal recover``: finish or take back what an interrupted run left on a vehicle, and nothing else."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.output import EXIT_NO, json_option, write_json
from mavcal.service.commands.place import place_of

if TYPE_CHECKING:
    from mavcal.service.commands.screen import Screen
    from mavcal.service.settings import Settings


@click.command()
@click.option("--connect", required=True, metavar="URL", help="Endpoint of the vehicle, as udpin:0.0.0.0:14550.")
@click.option("--data-dir", type=click.Path(path_type=Path), default=None, help="Where everything is kept.")
@click.option(
    "--wait",
    type=float,
    default=120.0,
    show_default=True,
    help="How long to wait for the vehicle, and for a write in doubt to be resolved, s.",
)
@json_option
def command(connect: str, data_dir: Path | None, wait: float, as_json: bool) -> int:
    """Finish or take back writes that were interrupted, by the journal of the data directory.

    Exit code 0: nothing is in doubt on this vehicle. 1: something still is; the parameters are listed.
    """
    from mavcal.service.commands.screen import Screen
    from mavcal.service.logs import configure_logging

    settings = load_settings(data_dir=data_dir, connect=())
    configure_logging(as_json=settings.log_json)
    screen = Screen(replace(place_of(settings), connect=connect))
    return asyncio.run(_recover(settings, connect, wait, screen, as_json))


async def _recover(settings: Settings, connect: str, wait: float, screen: Screen, as_json: bool) -> int:
    from mavcal.service.commands.headless import stoppable

    with stoppable() as caught:
        try:
            return await _recovered(settings, connect, wait, screen, as_json)
        except asyncio.CancelledError:
            if not caught:
                raise
            screen.line("stopped; what is still in doubt stays so until the next `mavcal recover`", bold=True)
            return 128 + caught[0]


async def _recovered(settings: Settings, connect: str, wait: float, screen: Screen, as_json: bool) -> int:
    from mavcal.service.commands.door import door
    from mavcal.service.commands.headless import heard, recovered, told_of
    from mavcal.service.errors import VehicleSilent

    async with door(settings, (connect,)) as at:
        left = await at.client.list_unfinished()
        try:
            vehicle = await heard(at, connect, wait, screen)
        except VehicleSilent:
            for found in left:
                for sentence in found.ending:
                    screen.line(sentence)
            raise
        screen.line(f"{vehicle.autopilot} {vehicle.firmware} as {vehicle.id}")
        done = await recovered(at, vehicle, left, screen, doubt_s=wait)
        await at.tidied()
        ours = {found.job.id for found in done}
        now = [await at.client.get_unfinished(found.job.id) for found in left if found.job.id not in ours]
        others = [found for found in now if not found.ended]
    doubt = [found for found in done if not found.ended]
    for found in others:
        job = found.job
        screen.line(f"job {job.id} ({job.kind}) of {job.vehicle_id} is {job.state.value}")
    if as_json:
        named = {"recovered": done, "in_doubt": doubt, "of_other_vehicles": others}
        write_json({"vehicle_id": vehicle.id, **{key: [told_of(f) for f in some] for key, some in named.items()}})
    if not done:
        screen.line("nothing is in doubt on this vehicle", bold=True)
    return EXIT_NO if doubt else 0
