"""``mavcal calibrate``: one calibration without a panel, by the same jobs as the service."""

from __future__ import annotations

import json
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.every import Acted, run_every
from mavcal.service.commands.headless import Begun
from mavcal.service.commands.output import json_option
from mavcal.service.commands.plan_options import given, options_of_plan, plan_options
from mavcal.service.commands.review import JobWish, run_job
from mavcal.service.commands.whom import Whom, whom_options

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.client.models import VehicleModel
    from mavcal.service.commands.door import Door
    from mavcal.service.commands.screen import Screen

KINDS = (
    *("gyro", "accel", "mag", "thermal", "level"),
    *("accel-one-axis", "accel-six-face", "mag-rings", "mag-fixed-yaw", "gyro-turntable", "gyro-thread", "imu-multi"),
)
"""Those of ``calib.procedures.registry``, stated here so that help does without numpy (a test compares them)."""
HANDS_FREE = ("gyro", "level")
"""Those of ``service.fixing``, which want nothing but a vehicle at rest (a test compares them)."""


@click.command(epilog=f"KIND is one of {', '.join(KINDS)}.")
@click.argument("kind", metavar="KIND", type=click.Choice(KINDS))
@whom_options(every=True)
@click.option("--apply", "write", is_flag=True, help="Write the result to the vehicle and prove it.")
@click.option(
    "--require-proof", is_flag=True, help="With --apply: exit code 3 if the streams prove a part of it, 1 if nothing."
)
@click.option("--reboot", is_flag=True, help="With --apply: restart the vehicle if the plan needs it.")
@click.option("--option", "options", multiple=True, metavar="NAME=VALUE", help="Option of the procedure.")
@plan_options
@json_option
def command(
    *,
    whom: Whom,
    kind: str,
    write: bool,
    require_proof: bool,
    reboot: bool,
    options: tuple[str, ...],
    as_json: bool,
    **more: Any,
) -> int:
    """Calibrate one sensor of a vehicle, headless; nothing is written without --apply.

    What an interrupted run left on this vehicle is finished or taken back first. A line typed while it runs answers
    the present prompt (`finish`, or the number that it asks for). With --apply on a terminal the run asks before it
    changes how a compass is said to be mounted; a script gives --confirm-mounting.

    Exit code 0: done. 1: the calibration did not succeed, or with --require-proof the streams prove nothing of it. 3:
    done in part; a sensor is left out, or with --require-proof the streams do not prove everything that shows there.

    With --all, gyro and level, which need no hands, are done of every vehicle side by side, with --apply only: a sensor
    whose change would act after a restart alone is left out and named.
    """
    if require_proof and not write:
        raise click.UsageError("--require-proof asks for a proof of what was written: give --apply too")
    chosen, decided = parsed(options), given(more)
    if whom.every:
        if kind not in HANDS_FREE or not write or require_proof or reboot or chosen or decided:
            raise click.UsageError(f"--all is for {' and '.join(HANDS_FREE)} with --apply, and without other options")
        return run_every(whom, partial(_hands_free, kind), as_json=as_json)

    async def begin(client: AsyncClient, vehicle: VehicleModel) -> Begun:
        options = options_of_plan(decided)
        return Begun(await client.start_job(vehicle.id, kind=kind, options=chosen, plan_options=options))

    return run_job(whom, begin, JobWish(write, require_proof, reboot, as_json))


async def _hands_free(kind: str, door: Door, vehicle: VehicleModel, screen: Screen) -> Acted:
    """Calibrate and write; whether it would arm afterwards is told too."""
    from mavcal.client.enums import JobState
    from mavcal.service.commands.hands_free import mended

    came = await mended(door, vehicle.id, kind, screen, look=True)
    job, ready = came.job, came.job.readiness
    about = {"job": job.id, "kind": kind, "state": job.state.value, "text": came.text}
    text = f"{kind}: {job.state.value}: {came.text}" + ("" if ready is None else f" {ready.text}")
    document = {**about, "readiness": None if ready is None else ready.model_dump(mode="json")}
    return Acted(job.state == JobState.SUCCEEDED, text, document, in_part=came.in_part)


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
