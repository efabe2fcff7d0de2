"""The tables of the fleet, in SQL that every back end understands."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection

from mavcal.service.store.database import Row, Session
from mavcal.service.store.rows import FleetRows, PreflightRow, SensorRow, UnitRow
from mavcal.service.store.sqlrows import SqlRows, dump, object_of

Read = Callable[[str, Row], list[Row]]


class FleetTables(SqlRows):
    """Units, what was measured of their sensors, and their last preflights."""

    def fleet(self, unit_id: str | None = None) -> FleetRows:
        """Everything about every unit, or about one."""
        return read_fleet(self._read, unit_id)

    def unit(self, unit_id: str) -> UnitRow | None:
        """A unit, or None."""
        return next(map(_unit, self._read("SELECT * FROM fleet_units WHERE unit_id = ?", (unit_id,))), None)

    def save_unit(self, row: UnitRow) -> None:
        """Insert or replace a unit."""
        with self._write() as db:
            db.execute(
                "INSERT INTO fleet_units VALUES (?, ?, ?, ?, ?, ?) ON CONFLICT (unit_id) DO UPDATE SET "
                "name = excluded.name, tags = excluded.tags, autopilot = excluded.autopilot, "
                "firmware = excluded.firmware, seen_at = excluded.seen_at",
                (row.id, row.name, json.dumps(list(row.tags)), row.autopilot, row.firmware, row.seen_at),
            )

    def see_unit(self, unit_id: str, autopilot: str, firmware: str, at: float) -> None:
        """Keep what a unit said of itself; its name and tags stay."""
        with self._write(durable=False) as db:
            db.execute(
                "INSERT INTO fleet_units VALUES (?, '', '[]', ?, ?, ?) ON CONFLICT (unit_id) DO UPDATE SET "
                "autopilot = excluded.autopilot, firmware = excluded.firmware, seen_at = excluded.seen_at",
                (unit_id, autopilot, firmware, at),
            )

    def add_sensor_records(self, source_id: str, rows: Collection[SensorRow], *, keep: int = 0) -> None:
        """Keep what one job or preflight measured; `keep`: of the preflights of that unit only the newest so many."""
        with self._write() as db:
            db.execute("INSERT INTO fleet_sources VALUES (?) ON CONFLICT (source_id) DO NOTHING", (source_id,))
            for row in rows:
                db.execute(
                    "INSERT INTO sensor_records VALUES (?, ?, ?, ?, ?, ?, ?) "
                    "ON CONFLICT (source_id, sensor, instance) DO NOTHING",
                    (source_id, row.sensor, row.instance, row.source, row.unit_id, row.at, dump(row.body)),
                )
            for unit_id in {row.unit_id for row in rows} if keep else ():
                _keep_newest(db, unit_id, keep)

    def drop_sensor_records(self, source_id: str) -> None:
        """Forget what a job measured; one that is not there is no error."""
        with self._write() as db:
            db.execute("DELETE FROM sensor_records WHERE source_id = ?", (source_id,))
            db.execute("DELETE FROM fleet_sources WHERE source_id = ?", (source_id,))

    def fleet_sources(self) -> frozenset[str]:
        """Jobs and preflights whose measurements were taken."""
        return frozenset(str(r[0]) for r in self._read("SELECT source_id FROM fleet_sources"))

    def save_preflight(self, row: PreflightRow) -> None:
        """Keep the last preflight of a unit, instead of the one before."""
        with self._write() as db:
            db.execute(
                "INSERT INTO fleet_preflights VALUES (?, ?, ?, ?) ON CONFLICT (unit_id) DO UPDATE SET "
                "at = excluded.at, verdict = excluded.verdict, body = excluded.body",
                (row.unit_id, row.at, row.verdict, dump(row.body)),
            )


def read_fleet(read: Read, unit_id: str | None = None) -> FleetRows:
    """Everything about every unit, or about one, by the function `read`."""
    of = (unit_id, unit_id)  # null: of all
    units = read("SELECT * FROM fleet_units WHERE CAST(? AS TEXT) IS NULL OR unit_id = ? ORDER BY unit_id", of)
    sensors = read(
        "SELECT * FROM sensor_records WHERE CAST(? AS TEXT) IS NULL OR unit_id = ? "
        "ORDER BY at, source_id, sensor, instance",
        of,
    )
    preflights = read(
        "SELECT * FROM fleet_preflights WHERE CAST(? AS TEXT) IS NULL OR unit_id = ? ORDER BY unit_id", of
    )
    return FleetRows(
        tuple(map(_unit, units)),
        tuple(SensorRow(r[0], r[1], r[2], r[3], r[4], r[5], object_of(r[6])) for r in sensors),
        tuple(PreflightRow(r[0], r[1], r[2], object_of(r[3])) for r in preflights),
    )


def _keep_newest(db: Session, unit_id: str, keep: int) -> None:
    old = db.execute(
        "SELECT source_id, max(at) AS newest FROM sensor_records WHERE unit_id = ? AND source = 'preflight' "
        "GROUP BY source_id ORDER BY newest DESC, source_id",
        (unit_id,),
    )[keep:]
    for source_id, _ in old:
        db.execute("DELETE FROM sensor_records WHERE source_id = ?", (source_id,))
        db.execute("DELETE FROM fleet_sources WHERE source_id = ?", (source_id,))


def _unit(row: Row) -> UnitRow:
    return UnitRow(row[0], row[1], _tags(row[2]), row[3], row[4], row[5])


def _tags(text: str) -> tuple[str, ...]:
    """Tags of a row; a damaged one has none, so that users limited to tagged vehicles do not see it."""
    try:
        found = json.loads(text)
    except ValueError:
        return ()
    return tuple(tag for tag in found if isinstance(tag, str)) if isinstance(found, list) else ()
