"""The fleet as CSV: one row a unit."""

from __future__ import annotations

from collections.abc import Iterable

from mavcal.calib.fleet.standing import NAMES, day
from mavcal.service.fleet.view import FleetUnit
from mavcal.service.spreadsheet import csv_text, inert

COLUMNS = (
    *("unit", "name", "tags", "autopilot", "firmware", "connected", "silent", "verdict", "preflight_at"),
    *("accel_age_days", "gyro_age_days", "mag_age_days", "low_degc", "high_degc"),
    *("leaves_earliest", "leaves_middle", "leaves_latest", "odd", "needs_recalibration", "reasons", "sensors"),
)


def fleet_csv(units: Iterable[FleetUnit]) -> str:
    """The table as CSV."""
    return csv_text([COLUMNS, *(map(inert, _cells(row)) for row in units)])


def _cells(row: FleetUnit) -> list[str]:
    covered = [s.covered for s in row.standing.sensors if s.covered is not None]
    leaving, ages = row.standing.leaving, row.ages
    odd = [s.name for s in row.standing.sensors if s.oddness is not None and s.oddness.odd]
    presence, preflight = row.presence, row.standing.preflight
    return [
        row.unit,
        row.name,
        " ".join(row.tags),
        row.autopilot,
        row.firmware,
        "yes" if presence else "no",
        "" if presence is None else "yes" if presence.silent else "no",
        row.verdict or "",
        "" if preflight is None else day(preflight.at),
        *("" if ages.get(kind) is None else f"{ages[kind]:.1f}" for kind in NAMES),
        f"{max(c.low for c in covered):.0f}" if covered else "",
        f"{min(c.high for c in covered):.0f}" if covered else "",
        *(("", "", "") if leaving is None else map(day, (leaving.earliest, leaving.middle, leaving.latest))),
        "; ".join(odd),
        "yes" if row.standing.reasons else "no",
        " ".join(reason.text for reason in row.standing.reasons),
        "; ".join(f"{s.name} {s.newest.device_id}" for s in row.standing.sensors),
    ]
