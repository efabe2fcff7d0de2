from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest

from mavcal.service.errors import StoreError
from mavcal.service.store import SqliteStore, Store
from mavcal.service.store.rows import FleetRows, PreflightRow, SensorRow, UnitRow
from mavcal.service.store.sqlite import DATABASE, fleet_of


def row(source: str = "job1", sensor: str = "gyro", *, unit: str = "uid-a", at: float = 1.0) -> SensorRow:
    kind = "preflight" if source.startswith("preflight") else "job"
    return SensorRow(source, sensor, 0, kind, unit, at, {"bias": [0.1, 0.2, 1 / 3]})


@pytest.fixture
def store() -> Iterator[Store]:
    store = SqliteStore(None)
    yield store
    store.close()


def test_a_unit_keeps_its_name_and_tags_when_it_is_seen_again(store: Store) -> None:
    store.see_unit("uid-a", "px4", "1.15.0", 1.0)
    assert store.unit("uid-a") == UnitRow("uid-a", "", (), "px4", "1.15.0", 1.0)
    store.save_unit(UnitRow("uid-a", "Heron", ("boats", "lake"), "px4", "1.15.0", 1.0))
    store.see_unit("uid-a", "px4", "1.16.0", 2.0)
    assert store.unit("uid-a") == UnitRow("uid-a", "Heron", ("boats", "lake"), "px4", "1.16.0", 2.0)
    assert store.unit("uid-b") is None


def test_records_are_kept_once_and_forgotten_with_their_job(store: Store) -> None:
    store.add_sensor_records("job1", [row(), row(sensor="accel")])
    store.add_sensor_records("job1", [row(at=9.0)])
    store.add_sensor_records("job2", [])
    assert store.fleet().sensors == (row(sensor="accel"), row())
    assert store.fleet_sources() == {"job1", "job2"}
    store.drop_sensor_records("job1")
    store.drop_sensor_records("job1")
    assert store.fleet().sensors == ()
    assert store.fleet_sources() == {"job2"}


def test_only_the_newest_preflights_of_a_unit_are_kept_and_every_job(store: Store) -> None:
    store.add_sensor_records("job1", [row(at=0.0)])
    for i in range(5):
        source = f"preflight-{i}"
        store.add_sensor_records(source, [row(source, at=1.0 + i), row(source, "accel", at=1.0 + i)], keep=2)
    store.add_sensor_records("preflight-b", [row("preflight-b", unit="uid-b")], keep=2)
    assert [r.source_id for r in store.fleet("uid-a").sensors] == ["job1", *["preflight-3"] * 2, *["preflight-4"] * 2]
    assert store.fleet_sources() == {"job1", "preflight-3", "preflight-4", "preflight-b"}


def test_the_last_preflight_replaces_the_one_before(store: Store) -> None:
    store.save_preflight(PreflightRow("uid-a", 1.0, "fail", {"summary": "no"}))
    store.save_preflight(PreflightRow("uid-a", 2.0, "pass", {"summary": "yes"}))
    store.save_preflight(PreflightRow("uid-b", 1.0, "warn", {}))
    assert store.fleet("uid-a").preflights == (PreflightRow("uid-a", 2.0, "pass", {"summary": "yes"}),)
    assert len(store.fleet().preflights) == 2
    assert store.fleet("uid-c") == FleetRows((), (), ())


def test_a_number_that_is_not_finite_leaves_nothing_behind(store: Store) -> None:
    bad = SensorRow("job1", "mag", 0, "job", "uid-a", 1.0, {"x": float("inf")})
    with pytest.raises(ValueError, match="JSON"):
        store.add_sensor_records("job1", [row(), bad])
    assert store.fleet().sensors == ()
    assert store.fleet_sources() == frozenset()


def test_a_source_of_another_kind_is_refused(store: Store) -> None:
    with pytest.raises(StoreError, match="CHECK"):
        store.add_sensor_records("x", [SensorRow("x", "gyro", 0, "guess", "uid-a", 1.0, {})])


def test_a_data_directory_is_read_beside_its_owner(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path)
    store.see_unit("uid-a", "px4", "", 1.0)
    store.add_sensor_records("job1", [row()])
    found = fleet_of(tmp_path)
    store.close()
    assert [unit.id for unit in found.units] == ["uid-a"]
    assert found.sensors == (row(),)


def test_damaged_rows_hide_no_other_and_show_no_tag(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path)
    store.save_unit(UnitRow("uid-a", "", ("boats",), "px4", "", 1.0))
    store.save_unit(UnitRow("uid-b", "", ("boats",), "px4", "", 1.0))
    store.add_sensor_records("job1", [row()])
    store.close()
    with sqlite3.connect(tmp_path / DATABASE) as db:
        db.execute("UPDATE fleet_units SET tags = 'boats' WHERE unit_id = 'uid-a'")
        db.execute("UPDATE sensor_records SET body = '{'")
    db.close()
    found = fleet_of(tmp_path)
    assert [unit.tags for unit in found.units] == [(), ("boats",)]
    assert found.sensors[0].body == {}
