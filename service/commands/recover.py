"""``mavcal recover``: finish or take back what an interrupted run left on a vehicle, and nothing else."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.output import EXIT_NO, json_option, write_json
from mavcal.service.commands.place import place_of

if TYPE_CHECKING:
    from mavcal.service.commands.screen import Screen


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

    settings = load_settings(data_dir=data_dir, connect=(connect,))
    configure_logging(as_json=settings.log_json)
    return asyncio.run(_recover(settings, wait, Screen(place_of(settings)), as_json))


async def _recover(settings: Any, wait: float, screen: Screen, as_json: bool) -> int:
    from mavcal.service.commands.headless import stoppable

    with stoppable() as caught:
        try:
            return await _recovered(settings, wait, screen, as_json)
        except asyncio.CancelledError:
            if not caught:
                raise
            screen.line("stopped; what is still in doubt stays so until the next `mavcal recover`", bold=True)
            return 128 + caught[0]


async def _recovered(settings: Any, wait: float, screen: Screen, as_json: bool) -> int:
    from mavcal.service.commands.headless import earlier, heard, recovered, tidied, told_of
    from mavcal.service.core import running_service
    from mavcal.service.errors import VehicleSilent
    from mavcal.service.unfinished import ending, left_over

    async with running_service(settings) as service:
        left = earlier(service)
        try:
            vehicle = await heard(service, settings.connect[0], wait, screen)
        except VehicleSilent:
            for found in left.found:
                for sentence in ending(found):
                    screen.line(sentence)
            raise
        screen.line(f"{vehicle.identity.autopilot} {vehicle.identity.version_text} as {vehicle.id}")
        done = await recovered(service, vehicle, left, screen, doubt_s=wait)
        await tidied(service)
        others = [f for f in left_over(service.store, service.jobs.list()) if all(f.job.id != d.job.id for d in done)]
    doubt = [found for found in done if not found.ended]
    for found in others:
        screen.line(f"job {found.job.id} ({found.job.kind}) of {found.job.vehicle_id} is {found.job.state.value}")
    if as_json:
        named = {"recovered": done, "in_doubt": doubt, "of_other_vehicles": others}
        write_json({"vehicle_id": vehicle.id, **{key: [told_of(f) for f in some] for key, some in named.items()}})
    if not done:
        screen.line("nothing is in doubt on this vehicle", bold=True)
    return EXIT_NO if doubt else 0
