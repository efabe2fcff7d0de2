"""``mavcal fleet``: every unit of a data directory or of a running service, and what people call them."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from mavcal.service.commands.fleet_source import FleetQuery, opened
from mavcal.service.commands.jobs import table
from mavcal.service.commands.output import json_option, write_json
from mavcal.service.commands.remote import may_be_remote
from mavcal.service.commands.whom import data_dir_option

Command = TypeVar("Command", bound=Callable[..., Any])

HEAD = ("unit", "name", "tags", "autopilot", "preflight", "age", "leaves its limit", "calibrate")
ORDERS = ("name", "verdict", "age", "leaving", "seen")
"""Those of :class:`service.fleet.view.FleetOrder`, stated here so that help does without it (a test compares them)."""
VERDICTS = ("pass", "warn", "fail", "unknown", "none")


def _where(command: Command) -> Command:
    """Where the fleet is: a data directory, or a running service."""
    return data_dir_option(may_be_remote(command))


@click.group(invoke_without_command=True)
@_where
@click.option("--verdict", multiple=True, type=click.Choice(VERDICTS), help="Last preflight; several: any.")
@click.option("--tag", default=None, help="Only units with this tag.")
@click.option("--min-age", type=click.FloatRange(0.0), default=None, metavar="DAYS", help="Calibrated so long ago.")
@click.option("--sensor", default=None, help="Only units with this kind (accel, gyro, mag) or type of sensor.")
@click.option("--needs-recalibration", is_flag=True, help="Only units that should be calibrated again, with why.")
@click.option("--odd", is_flag=True, help="Only units with a sensor unlike others of its type.")
@click.option("--order", type=click.Choice(ORDERS), default="name", show_default=True, help="What to order by.")
@click.option("--descending", is_flag=True, help="The largest value, or the last name, first.")
@click.option("--csv", "as_csv", is_flag=True, help="A table for spreadsheets, one row a unit.")
@json_option
@click.pass_context
def command(
    ctx: click.Context,
    /,
    *,
    data_dir: Path | None,
    url: str | None,
    key_file: Path | None,
    as_csv: bool,
    as_json: bool,
    **chosen: Any,
) -> int | None:
    """List every unit: last preflight, age and drift of its calibrations, and why it should be calibrated again.

    A running service may go on meanwhile. Exit code 0 whatever the list says.
    """
    if ctx.invoked_subcommand is not None:
        ctx.obj = {"data_dir": data_dir, "url": url, "key_file": key_file}
        return None
    with opened(data_dir, url, key_file) as source:
        query = FleetQuery(**{**chosen, "verdict": tuple(chosen["verdict"])})
        if as_csv:
            click.echo(source.csv(query), nl=False)
            return 0
        units = source.units(query)
    if as_json:
        write_json({"units": units})
        return 0
    show(units)
    return 0


def show(units: list[dict[str, Any]]) -> None:
    """The units as a table, with the reasons of those that should be calibrated again below it."""
    if not units:
        click.echo("no unit matches")
        return
    for line in table([HEAD, *map(_cells, units)]):
        click.echo(line)
    for unit in units:
        for reason in unit["reasons"]:
            click.echo(f"{unit['name'] or unit['unit']}: {reason['text']}")
        for sensor in unit["sensors"]:
            if sensor["oddness"] is not None and sensor["oddness"]["odd"]:
                click.echo(f"{unit['name'] or unit['unit']}: {_odd(sensor)}")


def _odd(sensor: dict[str, Any]) -> str:
    odd = sensor["oddness"]
    return (
        f"{sensor['sensor']} {sensor['instance'] + 1} is {odd['distance']:.1f} robust standard deviations from the "
        f"middle of {odd['group']} {sensor['type']}, limit {odd['limit']:.1f}: look at it."
    )


def _cells(unit: dict[str, Any]) -> tuple[str, ...]:
    from mavcal.calib.fleet.standing import day

    preflight, leaving = unit["preflight"], unit["leaving"]
    leaves = ""
    if leaving is not None:
        begin, end = leaving["earliest"], leaving["latest"]
        leaves = day(begin) if begin is None else f"{day(begin)} to {day(end)}"
    return (
        unit["unit"],
        unit["name"],
        " ".join(unit["tags"]),
        " ".join(filter(None, (unit["autopilot"], unit["firmware"].split(" ")[0]))),
        "" if preflight is None else f"{preflight['verdict']} {_ago(preflight['age_s'])} ago",
        "" if unit["age_days"] is None else f"{unit['age_days']:.0f} d",
        leaves,
        "yes" if unit["needs_recalibration"] else "no",
    )


def _ago(seconds: float) -> str:
    for size, name in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= size:
            return f"{seconds / size:.0f} {name}"
    return f"{seconds:.0f} s"


def _within(function: Command) -> Command:
    """A subcommand that takes the options of place before or after its name, and gets the opened source."""

    @_where
    @json_option
    @click.pass_obj
    @functools.wraps(function)
    def run(outer: dict[str, Any], /, *, as_json: bool, **given: Any) -> Any:
        place = {name: given.pop(name) or outer[name] for name in ("data_dir", "url", "key_file")}
        with opened(**place) as source:
            return function(source, as_json=as_json, **given)

    return run  # type: ignore[return-value]


@command.command("name")
@click.argument("unit")
@click.argument("name")
@_within
def name_(source: Any, *, unit: str, name: str, as_json: bool) -> int:
    """Call UNIT by a NAME, which stays with its hardware id; an empty one takes it away."""
    return _changed(source.change(unit, name=name), as_json=as_json)


@command.command("tag")
@click.argument("unit")
@click.option("--add", multiple=True, metavar="TAG", help="A tag to add; several.")
@click.option("--remove", multiple=True, metavar="TAG", help="A tag to take away; several.")
@_within
def tag_(source: Any, *, unit: str, add: tuple[str, ...], remove: tuple[str, ...], as_json: bool) -> int:
    """Add tags to UNIT or take them away."""
    if not (add or remove):
        raise click.UsageError("give --add TAG, --remove TAG, or both")
    tags = sorted((set(source.unit(unit)["tags"]) | set(add)) - set(remove))
    return _changed(source.change(unit, tags=tags), as_json=as_json)


def _changed(unit: dict[str, Any], *, as_json: bool) -> int:
    if as_json:
        write_json(unit)
    else:
        click.echo(f"{unit['unit']}: {unit['name'] or 'no name'}; tags: {' '.join(unit['tags']) or 'none'}")
    return 0
