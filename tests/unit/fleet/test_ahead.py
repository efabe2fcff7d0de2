"""Trends of the fleet are computed ahead, and a page makes those of its own units alone."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from mavcal.calib.fleet.record import ObservationSource, SensorRecord
from mavcal.calib.recording import Sensor
from mavcal.service.fleet import view
from mavcal.service.fleet.ahead import TrendsAhead
from mavcal.service.fleet.records import sensor_row
from mavcal.service.store import SqliteStore

DAY_S = 86400.0


@pytest.fixture
def store(tmp_path: Path) -> Iterator[SqliteStore]:
    store = SqliteStore(tmp_path)
    for unit in ("a", "b", "c"):
        measure(store, unit, day=0.0, applied=True)
        for day in (10.0, 20.0, 30.0):
            measure(store, unit, day)
    view._trend.cache_clear()
    yield store
    store.close()


def measure(store: SqliteStore, unit: str, day: float, *, applied: bool = False) -> None:
    source_id = f"{unit}-{day}"
    bias, sd = (0.01 * day + ord(unit), 0.0, 0.01 * (day % 7)), (0.01, 0.01, 0.01)
    record = SensorRecord(
        *(unit, "ardupilot", Sensor.ACCEL, 0, 5, day * DAY_S, ObservationSource.JOB, source_id, "accel"),
        applied=applied,
        proved=True,
        bias=bias,
        sd=sd,
    )
    store.add_sensor_records(source_id, [sensor_row(record)])


async def test_what_is_asked_for_later_is_there(store: SqliteStore) -> None:
    ahead = TrendsAhead(store, lambda: 1, wall=lambda: 40.0 * DAY_S)
    assert await ahead.compute()
    assert view._trend.cache_info().misses == 3
    for unit in view.fleet_units(store.fleet(), {}, 50.0 * DAY_S):
        assert unit.standing.sensors[0].trend.n == 4
    assert view._trend.cache_info().misses == 3


async def test_a_new_measurement_costs_one_trend(store: SqliteStore) -> None:
    ahead = TrendsAhead(store, lambda: 1, wall=lambda: 40.0 * DAY_S)
    await ahead.compute()
    measure(store, "b", 35.0)
    await ahead.compute()
    assert view._trend.cache_info().misses == 4


def test_a_list_by_name_computes_no_trend_until_a_row_is_looked_at(store: SqliteStore) -> None:
    taken = view.chosen(view.fleet_units(store.fleet(), {}, 40.0 * DAY_S), view.Choice())
    (first, *_), _ = view.page_of_units(taken, None, 1)
    assert view._trend.cache_info().misses == 0
    assert [reason.code for reason in first.standing.reasons] == ["drift"]
    assert view._trend.cache_info().misses == 1
