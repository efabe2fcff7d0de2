"""``mavcal fleet``: every unit of a data directory or of a running service, and what people call them.

A data directory is read also beside a running service; changing a unit there is for its service alone.
"""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.jobs import table
from mavcal.service.commands.output import json_option, write_json
from mavcal.service.commands.remote import Command, may_be_remote, service_at
from mavcal.service.commands.whom import data_dir_option
from mavcal.service.errors import DataDirLocked, UnitUnknown

if TYPE_CHECKING:
    from mavcal.service.settings import Settings

Json = dict[str, Any]

ACTOR = "command line"
PAGE = 1000

HEAD = ("unit", "name", "tags", "autopilot", "preflight", "age", "leaves its limit", "calibrate")
ORDERS = ("name", "verdict", "age", "leaving", "seen")
"""Those of :class:`service.fleet.view.FleetOrder`, stated here so that help does without it (a test compares them)."""
VERDICTS = ("pass", "warn", "fail", "unknown", "none")


@dataclass(frozen=True)
class FleetQuery:
    """Which units are wanted, and in which order, as the command line has them."""

    verdict: tuple[str, ...] = ()
    tag: str | None = None
    min_age: float | None = None
    sensor: str | None = None
    needs_recalibration: bool = False
    odd: bool = False
    order: str = "name"
    descending: bool = False


class LocalFleet:
    """A data directory. Reading goes on beside a running service; changing does not."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings

    def units(self, query: FleetQuery) -> list[Json]:
        """The documents of REST of the units that are wanted."""
        from mavcal.service.api.fleet_views import fleet_unit_model

        return [fleet_unit_model(row).model_dump(mode="json") for row in self._chosen(query)]

    def csv(self, query: FleetQuery) -> str:
        """The same as a table."""
        from mavcal.service.fleet.table import fleet_csv

        return fleet_csv(self._chosen(query))

    def unit(self, unit_id: str) -> Json:
        """One unit. Raises UnitUnknown."""
        found = [unit for unit in self.units(FleetQuery()) if unit["unit"] == unit_id]
        if not found:
            raise UnitUnknown(f"there is no unit {unit_id}: `mavcal fleet` lists them")
        return found[0]

    def change(self, unit_id: str, *, name: str | None = None, tags: Sequence[str] | None = None) -> Json:
        """Give it a name or tags. Raises UnitUnknown."""
        from pydantic import ValidationError

        from mavcal.service.api.models.fleet import UnitRequest
        from mavcal.service.fleet.book import renamed
        from mavcal.service.storing import open_store

        try:
            asked = UnitRequest(name=name, tags=None if tags is None else list(tags))
        except ValidationError as error:
            raise click.UsageError("; ".join(e["msg"] for e in error.errors())) from None
        self.unit(unit_id)
        try:
            store = open_store(self._settings)
        except DataDirLocked as error:
            raise DataDirLocked(f"{error}, or give the running service's --url") from error
        try:
            detail = asked.model_dump(exclude_none=True)
            store.add_audit(time.time(), ACTOR, "change unit", unit_id, detail)
            renamed(store, unit_id, asked.name, asked.tags)
        finally:
            store.close()
        return self.unit(unit_id)

    def _chosen(self, query: FleetQuery) -> Any:
        from mavcal.service.fleet.view import Choice, FleetOrder, chosen, fleet_units
        from mavcal.service.storing import fleet_of

        units = fleet_units(fleet_of(self._settings), {}, time.time())
        choice = Choice(
            frozenset(query.verdict),
            query.tag,
            query.min_age,
            query.sensor,
            query.needs_recalibration or None,
            query.odd or None,
        )
        return chosen(units, choice, FleetOrder(query.order), descending=query.descending)


class RemoteFleet:
    """A running service; its methods are those of :class:`LocalFleet`."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def units(self, query: FleetQuery) -> list[Json]:
        """The documents of REST of the units that are wanted."""
        found: list[Json] = []
        after = None
        while True:
            page = self._client.list_fleet(limit=PAGE, after=after, **_asked(query))
            found += [unit.model_dump(mode="json") for unit in page]
            if len(page) < PAGE:
                return found
            after = page[-1].unit

    def csv(self, query: FleetQuery) -> str:
        """The same as a table."""
        return str(self._client.export_fleet(**_asked(query)))

    def unit(self, unit_id: str) -> Json:
        """One unit. Raises UnitUnknown."""
        return dict(self._client.get_unit(unit_id).model_dump(mode="json"))

    def change(self, unit_id: str, *, name: str | None = None, tags: Sequence[str] | None = None) -> Json:
        """Give it a name or tags. Raises UnitUnknown."""
        given = None if tags is None else list(tags)
        return dict(self._client.change_unit(unit_id, name=name, tags=given).model_dump(mode="json"))


FleetSource = LocalFleet | RemoteFleet


@contextmanager
def opened(data_dir: Path | None, url: str | None, key_file: Path | None) -> Iterator[FleetSource]:
    """The source that the options name."""
    if url is None:
        yield LocalFleet(load_settings(data_dir=data_dir))
        return
    if data_dir is not None:
        raise click.UsageError("give --data-dir or --url, not both")
    with service_at(url, key_file) as client:
        yield RemoteFleet(client)


def _asked(query: FleetQuery) -> Json:
    asked = dataclasses.asdict(query)
    asked["min_age_days"] = asked.pop("min_age")
    asked["verdict"] = list(query.verdict) or None
    for flag in ("needs_recalibration", "odd"):
        asked[flag] = asked[flag] or None
    return asked


def _where(command: Command) -> Command:
    """Source of the fleet: a data directory, or a running service."""
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
