"""``mavcal calibrate``: one calibration without a panel, by the same jobs as the service."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.output import json_option
from mavcal.service.commands.plan_options import given, plan_options
from mavcal.service.commands.review import JobWish, run_job

if TYPE_CHECKING:
    from mavcal.service.core import Service
    from mavcal.service.jobs.model import Job
    from mavcal.service.vehicle import Vehicle

KINDS = (
    *("gyro", "accel", "mag", "thermal", "level"),
    *("accel-one-axis", "accel-six-face", "mag-rings", "gyro-turntable", "gyro-thread", "imu-multi"),
)
"""Those of ``calib.procedures.registry``, stated here so that help does without numpy (a test compares them)."""


@click.command()
@click.argument("kind", type=click.Choice(KINDS))
@click.option("--connect", required=True, metavar="URL", help="Endpoint of the vehicle, as udpin:0.0.0.0:14550.")
@click.option("--apply", "write", is_flag=True, help="Write the result to the vehicle and prove it.")
@click.option("--require-proof", is_flag=True, help="With --apply: exit code 1 unless the streams prove all of it.")
@click.option("--reboot", is_flag=True, help="With --apply: restart the vehicle if the plan needs it.")
@click.option("--option", "options", multiple=True, metavar="NAME=VALUE", help="Option of the procedure.")
@plan_options
@click.option("--data-dir", type=click.Path(path_type=Path), default=None, help="Where everything is kept.")
@click.option("--wait", type=float, default=30.0, show_default=True, help="How long to wait for a vehicle, s.")
@json_option
def command(
    *,
    kind: str,
    connect: str,
    write: bool,
    require_proof: bool,
    reboot: bool,
    options: tuple[str, ...],
    data_dir: Path | None,
    wait: float,
    as_json: bool,
    **more: Any,
) -> int:
    """Calibrate one sensor of a vehicle, headless; nothing is written without --apply.

    What an interrupted run left on this vehicle is finished or taken back first. A line typed while it runs answers
    the present prompt (`finish`, or the number that it asks for). With --apply on a terminal the run asks before it
    changes how a compass is said to be mounted; a script gives --confirm-mounting. Exit code 1 if the calibration did
    not succeed; with --require-proof also if the streams do not prove everything that shows there.
    """
    if require_proof and not write:
        raise click.UsageError("--require-proof asks for a proof of what was written: give --apply too")
    settings = load_settings(data_dir=data_dir, connect=(connect,))
    chosen, decided = parsed(options), given(more)

    async def begin(service: Service, vehicle: Vehicle) -> Job:
        return await service.jobs.submit(vehicle.id, kind, chosen, decided)

    return run_job(settings, begin, JobWish(write, require_proof, reboot, wait, as_json))


def parsed(options: tuple[str, ...], *, words: bool = False) -> dict[str, Any]:
    """``NAME=VALUE`` pairs; a value is a number, true or false, and with `words` it may be a word too."""
    found: dict[str, Any] = {}
    for item in options:
        name, equals, value = item.partition("=")
        try:
            found[name.strip()] = json.loads(value)
        except ValueError:
            equals = equals if words else ""
            found[name.strip()] = value.strip()
        if not equals:
            raise click.UsageError(f"{item!r} is not NAME=VALUE with a number, true or false", ctx=None)
    return found
