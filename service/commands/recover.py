"""``mavcal recover``: finish or take back what an interrupted run left on a vehicle, and nothing else."""

from __future__ import annotations

import asyncio
from functools import partial

import click

from mavcal.service.commands.door import Door, through_door
from mavcal.service.commands.headless import left_over, recovered, recovery_document
from mavcal.service.commands.output import EXIT_NO, json_option, write_json
from mavcal.service.commands.screen import Screen
from mavcal.service.commands.vehicles import vehicle_of
from mavcal.service.commands.whom import Whom, whom_options
from mavcal.service.errors import VehicleSilent


@click.command()
@whom_options(wait_s=120.0, wait_help="How long to wait for the vehicle, and for a write in doubt to be resolved, s.")
@json_option
def command(*, whom: Whom, as_json: bool) -> int:
    """Finish or take back writes that were interrupted, by the journal of the data directory.

    A running service does that by itself: with --url it is followed until it is done.

    Exit code 0: nothing is in doubt on this vehicle. 1: something still is; the parameters are listed.
    """
    return through_door(whom, partial(_recover, whom=whom, screen=Screen(whom.place), as_json=as_json))


async def _recover(at: Door, *, whom: Whom, screen: Screen, as_json: bool) -> int:
    try:
        return await _recovered(at, whom, screen, as_json=as_json)
    except asyncio.CancelledError:
        goes_on = "the service goes on with what is still in doubt"
        stays = "what is still in doubt stays so until the next `mavcal recover`"
        screen.line(f"stopped; {goes_on if at.shared else stays}", bold=True)
        raise


async def _recovered(at: Door, whom: Whom, screen: Screen, as_json: bool) -> int:

    left = await left_over(at)
    try:
        vehicle = await vehicle_of(at, whom, screen)
    except VehicleSilent:
        for found in left:
            for sentence in found.ending:
                screen.line(sentence)
        raise
    screen.line(f"{vehicle.autopilot} {vehicle.firmware} as {vehicle.id}")
    done = await recovered(at, vehicle, left, screen, doubt_s=whom.wait_s)
    await at.wait_for_cleanup()
    ours = {found.job.id for found in done}
    now = [await at.client.get_unfinished(found.job.id) for found in left if found.job.id not in ours]
    others = [found for found in now if not found.ended]
    doubt = [found for found in done if not found.ended]
    for found in others:
        job = found.job
        screen.line(f"job {job.id} ({job.kind}) of {job.vehicle_id} is {job.state.value}")
    if as_json:
        named = {"recovered": done, "in_doubt": doubt, "of_other_vehicles": others}
        write_json(
            {"vehicle_id": vehicle.id, **{key: [recovery_document(f) for f in some] for key, some in named.items()}}
        )
    if not done:
        screen.line("nothing is in doubt on this vehicle", bold=True)
    return EXIT_NO if doubt else 0
