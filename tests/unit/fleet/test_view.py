from __future__ import annotations

import csv
import io
from typing import get_args

import numpy as np
import pytest

from mavcal.calib.fleet.record import SensorRecord
from mavcal.calib.fleet.trend import DAY_S
from mavcal.calib.preflight.check import Check, CheckId, Verdict
from mavcal.calib.recording import Sensor
from mavcal.calib.report import to_json
from mavcal.service.api.fleet import Order
from mavcal.service.api.fleet_views import fleet_unit_model, unit_history_model
from mavcal.service.commands import fleet as fleet_command
from mavcal.service.errors import UnitUnknown
from mavcal.service.fleet.records import last_preflight, records_of_rows, sensor_row
from mavcal.service.fleet.table import COLUMNS, fleet_csv
from mavcal.service.fleet.view import Choice, FleetOrder, FleetUnit, Presence, chosen, fleet_units, page_of_units
from mavcal.service.store.rows import FleetRows, PreflightRow, SensorRow, UnitRow

from .test_standing import record

NOW = 400.0 * DAY_S


def preflight(unit: str, verdict: Verdict, day: float = 399.0) -> PreflightRow:
    check = Check(CheckId.GYRO_REST, verdict, 1.0, 0.1, 0.5, "deg/s", "It turns.")
    return PreflightRow(unit, day * DAY_S, verdict.value, {"summary": "so", "checks": [to_json(check)], "notes": []})


def rows() -> FleetRows:
    units = (
        UnitRow("uid-a", "Heron", ("boats", "lake"), "ardupilot", "4.5.7", 1.0),
        UnitRow("uid-b", "albatross", ("planes",), "px4", "1.15.0", 2.0),
        UnitRow("uid-c", "", (), "px4", "1.15.0", 3.0),
    )
    old = [record("uid-a", day=1.0), record("uid-a", Sensor.ACCEL, day=300.0, device_id=0x2B000A)]
    new = [record("uid-b", day=390.0)]
    verdicts = (preflight("uid-a", Verdict.FAIL), preflight("uid-b", Verdict.PASS))
    return FleetRows(units, tuple(map(sensor_row, [*old, *new])), verdicts)


def units(**present: Presence) -> tuple[FleetUnit, ...]:
    return fleet_units(rows(), {name.replace("_", "-"): one for name, one in present.items()}, NOW)


def names(found: tuple[FleetUnit, ...]) -> list[str]:
    return [row.unit for row in found]


def test_every_unit_has_a_row_by_name_and_those_without_one_come_last() -> None:
    there = Presence("uid-d", "px4", "1.16.0", silent=False)
    found = units(uid_d=there)
    assert names(found) == ["uid-b", "uid-a", "uid-c", "uid-d"]
    assert found[-1].presence == there
    assert (found[-1].autopilot, found[-1].firmware, found[-1].seen_at) == ("px4", "1.16.0", NOW)


def test_age_is_that_of_the_oldest_sensor() -> None:
    by_name = {row.unit: row for row in units()}
    assert by_name["uid-a"].ages == {Sensor.GYRO: 399.0, Sensor.ACCEL: 100.0}
    assert by_name["uid-a"].age == 399.0
    assert by_name["uid-c"].age is None


@pytest.mark.parametrize(
    ("choice", "expected"),
    [
        (Choice(), ["uid-b", "uid-a", "uid-c"]),
        (Choice(verdict=frozenset({"fail"})), ["uid-a"]),
        (Choice(verdict=frozenset({"pass", "none"})), ["uid-b", "uid-c"]),
        (Choice(tag="lake"), ["uid-a"]),
        (Choice(tag="lak"), []),
        (Choice(min_age_d=100.0), ["uid-a", "uid-c"]),
        (Choice(sensor="accel"), ["uid-a"]),
        (Choice(sensor="bmi088"), ["uid-a"]),
        (Choice(sensor="ICM-42688"), ["uid-b", "uid-a"]),
        (Choice(needs_recalibration=True), ["uid-a", "uid-c"]),
        (Choice(needs_recalibration=False), ["uid-b"]),
        (Choice(odd=True), []),
        (Choice(odd=False, tag="planes"), ["uid-b"]),
    ],
)
def test_rows_are_chosen(choice: Choice, expected: list[str]) -> None:
    assert names(chosen(units(), choice)) == expected


@pytest.mark.parametrize(
    ("order", "up", "down"),
    [
        (FleetOrder.NAME, ["uid-b", "uid-a", "uid-c"], ["uid-c", "uid-a", "uid-b"]),
        (FleetOrder.VERDICT, ["uid-a", "uid-b", "uid-c"], ["uid-b", "uid-a", "uid-c"]),
        (FleetOrder.AGE, ["uid-b", "uid-a", "uid-c"], ["uid-a", "uid-b", "uid-c"]),
        (FleetOrder.SEEN, ["uid-a", "uid-b", "uid-c"], ["uid-c", "uid-b", "uid-a"]),
    ],
)
def test_rows_are_ordered_and_what_has_no_value_is_last(order: FleetOrder, up: list[str], down: list[str]) -> None:
    assert names(chosen(units(), Choice(), order)) == up
    assert names(chosen(units(), Choice(), order, descending=True)) == down


def test_the_unit_that_leaves_its_limit_first_comes_first() -> None:
    rng = np.random.default_rng(1)

    def drifting(unit: str, days: float) -> list[SensorRecord]:
        rate = np.radians(0.5) / days
        noise = 1e-4 * rng.standard_normal(6)
        return [record(unit, day=60.0 * i, bias=(60.0 * i * rate + noise[i], 0.0, 0.0)) for i in range(6)]

    told = map(sensor_row, [*drifting("slow", 900.0), *drifting("fast", 300.0), record("once")])
    found = fleet_units(FleetRows((), tuple(told), ()), {}, NOW)
    assert names(chosen(found, Choice(), FleetOrder.LEAVING)) == ["fast", "slow", "once"]


def test_a_page_goes_on_where_the_last_one_ended() -> None:
    page, more = page_of_units(units(), None, 2)
    assert (names(page), more) == (["uid-b", "uid-a"], "uid-a")
    page, more = page_of_units(units(), more, 2)
    assert (names(page), more) == (["uid-c"], None)
    with pytest.raises(UnitUnknown):
        page_of_units(units(), "uid-z", 2)


def test_a_row_is_told_in_the_unit_of_its_limit() -> None:
    model = fleet_unit_model(next(row for row in units() if row.unit == "uid-a"))
    gyro = next(s for s in model.sensors if s.sensor == Sensor.GYRO)
    assert (gyro.type, gyro.bus, gyro.drift.unit, gyro.drift.limit) == (
        "ICM-42688",
        "SPI 1, address 0x00",
        "deg/s",
        0.5,
    )
    assert model.needs_recalibration
    assert [reason.code for reason in model.reasons] == ["age", "preflight"]
    assert model.preflight is not None
    assert model.preflight.age_s == DAY_S


def test_a_history_has_its_numbers_in_the_same_unit() -> None:
    one = record("uid-a", bias=(float(np.radians(1.0)), 0.0, 0.0))
    row = fleet_units(FleetRows((), (sensor_row(one),), ()), {}, NOW)[0]
    told = unit_history_model(row, (one,)).records[0]
    assert told.bias == pytest.approx((1.0, 0.0, 0.0))
    assert told.unit == "deg/s"


def test_the_table_has_a_row_a_unit_and_starts_no_formula() -> None:
    evil = UnitRow("uid-x", "=HYPERLINK(1)", (), "px4", "", 1.0)
    found = fleet_units(FleetRows((*rows().units, evil), rows().sensors, rows().preflights), {}, NOW)
    table = list(csv.DictReader(io.StringIO(fleet_csv(found))))
    assert tuple(table[0]) == COLUMNS
    by_unit = {row["unit"]: row for row in table}
    assert by_unit["uid-x"]["name"] == "'=HYPERLINK(1)"
    assert by_unit["uid-a"]["needs_recalibration"] == "yes"
    assert by_unit["uid-a"]["gyro_age_days"] == "399.0"
    assert by_unit["uid-a"]["tags"] == "boats lake"
    assert "ICM-42688" in by_unit["uid-b"]["sensors"]


def test_damaged_rows_are_left_out() -> None:
    assert records_of_rows([SensorRow("j", "gyro", 0, "job", "u", 1.0, {})]) == ()
    assert last_preflight(PreflightRow("u", 1.0, "pass", {"checks": [{}]})) is None
    assert last_preflight(PreflightRow("u", 1.0, "perhaps", {})) is None


def test_the_orders_are_one_list() -> None:
    assert [order.value for order in FleetOrder] == list(get_args(Order)) == list(fleet_command.ORDERS)
