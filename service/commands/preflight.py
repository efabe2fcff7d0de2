"""``mavcal preflight``: is this vehicle fit to fly, as far as its sensors and their calibration go?"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.every import with_each
from mavcal.service.commands.output import EXIT_NO, EXIT_PART, json_option, write_json
from mavcal.service.commands.place import NO_OPTIONS, CommandPlace
from mavcal.service.commands.vehicles import Found, Refusal
from mavcal.service.commands.whom import Whom, whom_options

if TYPE_CHECKING:
    from mavcal.client.models import CheckModel, FixModel, PreflightModel, VehicleModel
    from mavcal.service.commands.door import Door
    from mavcal.service.commands.screen import Screen

FIXABLE = ("gyro", "level")
"""Those of ``service.fixing``, stated here so that help does without it (a test compares them)."""

STILL_LOOKING_S = (9.5, 19.0)
"""Times at which a running preflight says so, s. A healthy vehicle on a good link is done before the first; no command
is silent for longer than 10 s."""


@click.command()
@whom_options(many=True, every=True)
@click.option("--heading", type=click.FloatRange(0.0, 360.0), default=None, help="True heading of the nose, deg.")
@click.option("--fix", default=None, metavar="KIND[,KIND]", help="Calibrate this first: gyro, level. Needs --apply.")
@click.option("--apply", "write", is_flag=True, help="With --fix: write the result to the vehicle.")
@json_option
def command(
    *,
    whom: Whom,
    heading: float | None,
    fix: str | None,
    write: bool,
    as_json: bool,
) -> int:
    """Check vehicles that stand still; nothing is written without --apply.

    This takes ten seconds, or up to 30 on a slow link or right after the vehicle's start.

    Exit code 0: every check passes. 1: a check failed, or a vehicle is armed, silent or busy. 3: nothing failed, but
    a check warns or could not be made.
    """
    from mavcal.service.commands.door import through_door
    from mavcal.service.commands.screen import Screen

    kinds = tuple(kind.strip() for kind in fix.split(",")) if fix else ()
    unknown = sorted(set(kinds) - set(FIXABLE))
    if unknown:
        raise click.UsageError(f"--fix cannot do {', '.join(unknown)}: only {', '.join(FIXABLE)} need no hands")
    if bool(kinds) != write:
        raise click.UsageError("--fix writes to the vehicle: give --apply too, or neither of them")
    screen = Screen(whom.place)
    check = partial(_checked, wish=_Wish(kinds, heading))
    done = through_door(whom, partial(with_each, whom=whom, act=check, screen=screen))
    if isinstance(done, int):
        return done
    found = [one for _, one in done]
    alone = len(found) == 1 and not whom.every
    if alone and isinstance(found[0], Refusal):
        raise found[0]
    if as_json:
        write_json(_document(done, alone=alone))
    else:
        for where, one in done:
            only = None if where.vehicle is None else where.vehicle.id
            show(one, "" if alone else where.connect, replace(whom.place, connect=where.connect, vehicle=only))
    return _exit_code(found)


@dataclass(frozen=True)
class _Wish:
    kinds: tuple[str, ...]
    heading: float | None


Answer = tuple[Found, "PreflightModel | Refusal"]


async def _checked(door: Door, vehicle: VehicleModel, screen: Screen, *, wish: _Wish) -> PreflightModel:
    screen.line(f"{vehicle.autopilot} {vehicle.firmware} as {vehicle.id}")
    fixed = await _fixed(door, vehicle, wish.kinds, screen)
    for fix in fixed:
        screen.line(f"    {fix.kind.value}: {fix.state.value}: {fix.text}")
    with _reporting_progress(screen):
        found = await door.client.run_preflight(vehicle.id, heading=wish.heading)
    return found.model_copy(update={"fixed": fixed})


async def _fixed(door: Door, vehicle: VehicleModel, kinds: Sequence[str], screen: Screen) -> list[FixModel]:
    """Outcome of each calibration; the first one that does not succeed is the last."""
    from mavcal.client.enums import Fixable, JobState
    from mavcal.client.models import FixModel
    from mavcal.service.commands.hands_free import mended

    done: list[FixModel] = []
    for kind in dict.fromkeys(kinds):
        came = await mended(door, vehicle.id, kind, screen, look=False)
        done.append(FixModel(kind=Fixable(kind), job_id=came.job.id, state=came.job.state, text=came.text))
        if came.job.state != JobState.SUCCEEDED:
            break
    return done


@contextmanager
def _reporting_progress(screen: Screen) -> Iterator[None]:
    """Report every few seconds that the preflight goes on."""
    loop = asyncio.get_running_loop()
    text = "    still looking, for 30 s at most: the link is slow, or the vehicle has just started"
    reminders = [loop.call_later(after, screen.line, text) for after in STILL_LOOKING_S]
    try:
        yield
    finally:
        for reminder in reminders:
            reminder.cancel()


def _exit_code(found: list[PreflightModel | Refusal]) -> int:
    """Exit code of the worst vehicle."""
    verdicts = {"fail" if isinstance(one, Refusal) else one.verdict.value for one in found}
    return EXIT_NO if "fail" in verdicts else EXIT_PART if verdicts - {"pass"} else 0


def _document(done: list[Answer], *, alone: bool) -> dict[str, Any]:
    """One report; of several vehicles, all of them by endpoint."""
    documents = []
    for where, one in done:
        if not isinstance(one, Refusal):
            documents.append({"connect": where.connect, **one.model_dump()})
        else:
            documents.append({**where.document, "error": {"code": one.code, "detail": str(one)}})
    if not alone:
        return {"vehicles": documents}
    return {name: value for name, value in documents[0].items() if name != "connect"}


def show(found: PreflightModel | Refusal, title: str = "", place: CommandPlace = NO_OPTIONS) -> None:
    """The report as a table, with what helps below each check that does not pass.

    Commands are named with the options of `place`.
    """
    if title:
        click.secho(title, bold=True)
    if isinstance(found, Refusal):
        click.secho(f"FAIL: {found}", bold=True)
        return
    width = max(len(check.id.value) for check in found.checks)
    for check in found.checks:
        number = _number(check)
        click.echo(f"{check.verdict.value.upper():8}{check.id.value:{width}}  {number}{check.reason}")
        if check.remedy:
            click.echo(f"{'':{width + 10}}-> {place.completed(check.remedy)}")
    for note in found.notes:
        click.echo(f"note: {note}")
    click.secho(f"{found.verdict.value.upper()}: {found.summary} ({found.seconds:.1f} s)", bold=True)


def _number(check: CheckModel) -> str:
    """Value, uncertainty and limit of a passed check; the reasons of other checks state them."""
    if check.value is None or not check.limit or check.verdict.value != "pass":
        return ""
    sd = "" if not check.sd else f" ± {check.sd:.1g}"
    return f"[{check.value:.3g}{sd} of {check.limit:.3g} {check.unit}] ".replace(" ] ", "] ")
