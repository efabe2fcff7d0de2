"""The fleet as rows: filtered, sorted and in pages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import lru_cache

from mavcal.calib.fleet.record import SensorRecord
from mavcal.calib.fleet.standing import LastPreflight, SensorStanding, UnitStanding, fleet_standing
from mavcal.calib.fleet.trend import DAY_S, bias_trend
from mavcal.calib.preflight.check import Verdict
from mavcal.calib.recording import Sensor
from mavcal.service.errors import UnitUnknown
from mavcal.service.fleet.records import last_preflight, records_of_rows
from mavcal.service.store.rows import FleetRows, PreflightRow

_trend = lru_cache(maxsize=16384)(bias_trend)  # a trend rests on its measurements alone, whenever it is asked for


class FleetOrder(StrEnum):
    """Sort key of rows; rows without such a value come last."""

    NAME = "name"
    VERDICT = "verdict"
    AGE = "age"
    LEAVING = "leaving"
    SEEN = "seen"


@dataclass(frozen=True)
class Presence:
    """A vehicle that is on a link now."""

    vehicle_id: str
    autopilot: str
    firmware: str
    silent: bool


@dataclass(frozen=True)
class FleetUnit:
    """One unit as a row."""

    unit: str
    name: str
    tags: tuple[str, ...]
    autopilot: str
    firmware: str
    seen_at: float | None
    presence: Presence | None
    """None: not on a link, or not checked."""
    standing: UnitStanding
    report: PreflightRow | None
    """The last preflight as it was kept."""
    now: float

    @property
    def ages(self) -> dict[Sensor, float | None]:
        """Days since the oldest calibration of each kind of sensor; None: one of them has none."""
        found: dict[Sensor, float | None] = {}
        for sensor in self.standing.sensors:
            kind, at = sensor.newest.sensor, sensor.calibrated_at
            age = None if at is None else (self.now - at) / DAY_S
            known = found.get(kind, 0.0)
            found[kind] = None if age is None or known is None else max(age, known)
        return found

    @property
    def age(self) -> float | None:
        """Days since the oldest calibration; None: a sensor has none, or none is known."""
        ages = list(self.ages.values())
        known = [age for age in ages if age is not None]
        return max(known) if known and len(known) == len(ages) else None

    @property
    def verdict(self) -> Verdict | None:
        """Verdict of the last preflight; None: there was none."""
        return None if self.standing.preflight is None else self.standing.preflight.verdict


@dataclass(frozen=True)
class Choice:
    """Filter of rows; None: all."""

    verdict: frozenset[str] = field(default_factory=frozenset)
    """Verdicts of the last preflight, or ``none``; empty: any."""
    tag: str | None = None
    min_age_d: float | None = None
    """Calibrated so long ago, or never."""
    sensor: str | None = None
    """A kind (accel, gyro, mag) or the type of a part; upper and lower case alike."""
    needs_recalibration: bool | None = None
    odd: bool | None = None
    """Whether a sensor is unlike others of its type."""

    def takes(self, row: FleetUnit) -> bool:
        """Whether the row matches."""
        verdict = "none" if row.verdict is None else row.verdict.value
        return (
            (not self.verdict or verdict in self.verdict)
            and (self.tag is None or self.tag in row.tags)
            and (self.min_age_d is None or row.age is None or row.age >= self.min_age_d)
            and (self.sensor is None or any(_is(s, self.sensor.lower()) for s in row.standing.sensors))
            and (self.needs_recalibration is None or self.needs_recalibration == bool(row.standing.reasons))
            and self.odd in (None, any(s.oddness is not None and s.oddness.odd for s in row.standing.sensors))
        )


def _is(sensor: SensorStanding, kind: str) -> bool:
    return kind in (sensor.newest.sensor.value, sensor.newest.type.lower())


def fleet_units(rows: FleetRows, present: Mapping[str, Presence], now: float) -> tuple[FleetUnit, ...]:
    """Every unit that is known or present, in the order of their names; for a thread of its own."""
    known = {row.id: row for row in rows.units}
    records: dict[str, list[SensorRecord]] = {}
    for record in records_of_rows(rows.sensors):
        records.setdefault(record.unit, []).append(record)
    reports = {row.unit_id: row for row in rows.preflights}
    preflights: dict[str, LastPreflight] = {}
    for unit, row in reports.items():
        if (found := last_preflight(row)) is not None:
            preflights[unit] = found
    names = {*known, *records, *reports, *present}
    standings = fleet_standing({unit: records.get(unit, []) for unit in names}, preflights, now, _trend)
    units = []
    for unit, standing in standings.items():
        row_, there = known.get(unit), present.get(unit)
        made_by = records.get(unit, [])
        autopilot = there.autopilot if there else row_.autopilot if row_ else ""
        units.append(
            FleetUnit(
                unit,
                row_.name if row_ else "",
                row_.tags if row_ else (),
                autopilot or (made_by[-1].autopilot if made_by else ""),
                (there.firmware if there else "") or (row_.firmware if row_ else ""),
                now if there and not there.silent else row_.seen_at if row_ and row_.seen_at else None,
                there,
                standing,
                reports.get(unit),
                now,
            )
        )
    return tuple(sorted(units, key=_by_name))


def chosen(
    units: Sequence[FleetUnit], choice: Choice, order: FleetOrder = FleetOrder.NAME, *, descending: bool = False
) -> tuple[FleetUnit, ...]:
    """The chosen rows in order; `descending` reverses it, except that rows without a value stay last."""
    taken = [row for row in units if choice.takes(row)]
    if order is FleetOrder.NAME:
        return tuple(reversed(taken)) if descending else tuple(taken)
    valued = [(value, row) for row in taken if (value := _value(row, order)) is not None]
    without = [row for row in taken if _value(row, order) is None]
    return (*(row for _, row in sorted(valued, key=lambda pair: -pair[0] if descending else pair[0])), *without)


_WORST_FIRST = (Verdict.FAIL, Verdict.WARN, Verdict.UNKNOWN, Verdict.PASS)


def _value(row: FleetUnit, order: FleetOrder) -> float | None:
    if order is FleetOrder.VERDICT:
        return None if row.verdict is None else float(_WORST_FIRST.index(row.verdict))
    if order is FleetOrder.AGE:
        return row.age
    if order is FleetOrder.SEEN:
        return row.seen_at
    leaving = row.standing.leaving
    if leaving is None:
        return None
    return next((at for at in (leaving.earliest, leaving.middle, leaving.latest) if at is not None), math.inf)


def _by_name(row: FleetUnit) -> tuple[bool, str, str]:
    return not row.name, row.name.lower(), row.unit


def page_of_units(
    units: Sequence[FleetUnit], after: str | None, limit: int
) -> tuple[tuple[FleetUnit, ...], str | None]:
    """The rows behind the unit `after`, at most `limit`, and the unit that the next page begins behind.

    Raises
    ------
    UnitUnknown
        If the unit `after` is not among them.
    """
    begin = 0
    if after is not None:
        begin = next((i for i, row in enumerate(units, 1) if row.unit == after), 0)
        if begin == 0:
            raise UnitUnknown(f"there is no unit {after} to go on from: begin with the first page")
    page = tuple(units[begin : begin + limit])
    return page, page[-1].unit if begin + limit < len(units) else None
