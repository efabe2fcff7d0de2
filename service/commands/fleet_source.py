"""Where ``mavcal fleet`` looks: a data directory, also beside a running service, or a service over HTTP."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.remote import service_at
from mavcal.service.errors import DataDirLocked, UnitUnknown

if TYPE_CHECKING:
    from mavcal.service.settings import Settings

Json = dict[str, Any]

ACTOR = "command line"
PAGE = 1000


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
