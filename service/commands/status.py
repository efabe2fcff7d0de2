"""``mavcal status``: which vehicles these links reach, their state, and what was calibrated last."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime
from typing import Any

import click

from mavcal.service.commands.door import Door, door
from mavcal.service.commands.headless import jobs_of
from mavcal.service.commands.output import EXIT_NO, json_option, write_json
from mavcal.service.commands.screen import Screen
from mavcal.service.commands.vehicles import Found, vehicles_of
from mavcal.service.commands.whom import Whom, whom_options


@click.command()
@whom_options(many=True, every=True)
@json_option
def command(*, whom: Whom, as_json: bool) -> int:
    """Say of each vehicle who it is, whether it may be written to, and what was calibrated last.

    Nothing is asked of it but who it is. Exit code 1 if a vehicle was not heard.
    """
    found = asyncio.run(_status(whom, Screen(whom.place)))
    if as_json:
        write_json({"vehicles": found})
    else:
        for one in found:
            _show(one)
    return EXIT_NO if any("error" in one for one in found) else 0


async def _status(whom: Whom, screen: Screen) -> list[dict[str, Any]]:

    async with door(whom) as at:
        return [await _one(at, found) for found in await vehicles_of(at, whom, screen)]


async def _one(door: Door, found: Found) -> dict[str, Any]:
    from mavcal.client.enums import JobState

    if found.vehicle is None:
        return found.document
    done = await jobs_of(door.client, vehicle_id=found.vehicle.id, state=JobState.SUCCEEDED)
    calibrated = {job.kind: {"job": job.id, "at": job.updated_at} for job in done}
    return {"connect": found.connect, **found.vehicle.model_dump(mode="json"), "calibrated": calibrated}


def _show(one: dict[str, Any]) -> None:
    click.secho(one["connect"], bold=True)
    if "error" in one:
        click.echo(f"  {one['error']['detail']}")
        return
    click.echo(f"  {one['autopilot']} {one['firmware']} as {one['id']}")
    click.echo(f"  {'armed' if one['armed'] else 'disarmed'}, {one['landed']}, {one['loss']:.1%} of its messages lost")
    for obstacle in one["obstacles"]:
        click.echo(f"  not to be written to: {obstacle}")
    for kind, last in one["calibrated"].items():
        when = datetime.fromtimestamp(last["at"], UTC).strftime("%Y-%m-%d %H:%M")
        click.echo(f"  {kind} calibrated {when} UTC by job {last['job']}")
    if not one["calibrated"]:
        click.echo("  no calibration of it is known here")
