"""Damaged rows: no row stops the start, and an interrupted write is still brought to its end."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from mavcal.calib.report import to_json
from mavcal.service.errors import PhysicalJobRunning
from mavcal.service.jobs.core.codec import row_from_job
from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import SnapshotPurpose
from tests.unit.jobs.conftest import NEW, OLD, QUICK, float32, make_plan, until
from tests.unit.jobs.fakes import FakeRegistry, FakeVehicle

BROKEN = {"not json": b"{", "not an object": b"[]", "empty": b"{}", "not text": b"\xff\xfe\x00{"}


def half_written(folder: Path, vehicle: FakeVehicle, *, keep_plan: bool = True) -> None:
    """A data directory as a crash after the first echo leaves it, with a capture of another vehicle beside it."""
    plan = make_plan(vehicle)
    store = SqliteStore(folder)
    job = Job("w1", vehicle.id, "gyro", {}, JobState.APPLYING, 1.0, 1.0, fingerprint=plan.fingerprint, plan=plan)
    store.save_job(row_from_job(job))
    store.save_job(row_from_job(Job("old", "vehicle-2", "gyro", {}, JobState.SUCCEEDED, 0.0, 0.0)))
    store.save_job(row_from_job(Job("c1", "vehicle-2", "gyro", {}, JobState.RUNNING, 2.0, 2.0)))
    store.save_job(row_from_job(Job("ok", "vehicle-3", "gyro", {}, JobState.REVIEW, 3.0, 3.0)))
    store.add_snapshot("w1", 1.0, SnapshotPurpose.COMPOSED_ON, plan.snapshot_sha256, vehicle.values())
    old = {n: {"value": v, "kind": "real32"} for n, v in vehicle.values().items()}
    for change in plan.changes:
        old[change.name] = {"value": change.old, "kind": change.kind.value}
    store.add_snapshot("w1", 1.0, SnapshotPurpose.BEFORE_WRITE, "0" * 64, old)
    if keep_plan:
        store.add_plan("w1", plan.sha256, 1.0, to_json(plan))
    store.add_journal("w1", 1.0, JournalStep.ACCEPTED, {"plan_sha256": plan.sha256, "actor": "a", "reboot": False})
    first = plan.changes[0]
    announced = {"name": first.name, "old": first.old, "new": first.new, "kind": first.kind.value, "session": False}
    store.add_journal("w1", 1.0, JournalStep.SEND, announced)
    store.close()
    vehicle.store(first.name, first.new)


def damage(folder: Path, job_id: str, body: bytes) -> None:
    """As a failing card would: past every check of the schema."""
    with sqlite3.connect(folder / "mavcal.sqlite3") as db:
        db.execute("PRAGMA ignore_check_constraints = ON")
        db.execute("UPDATE jobs SET body = CAST(? AS TEXT) WHERE id = ?", (body, job_id))
    db.close()


@asynccontextmanager
async def started(folder: Path, vehicle: FakeVehicle) -> AsyncIterator[JobEngine]:
    store = SqliteStore(folder)
    engine = JobEngine(store, FakeRegistry({vehicle.id: vehicle}), settings=QUICK)
    try:
        await engine.start()
        yield engine
    finally:
        await engine.stop()
        store.close()


@pytest.mark.sampled
@pytest.mark.parametrize("body", BROKEN.values(), ids=BROKEN.keys())
@pytest.mark.parametrize("damaged", ["old", "c1", "ok"])
async def test_a_damaged_row_stops_neither_the_start_nor_the_recovery_of_a_write(
    tmp_path: Path, damaged: str, body: bytes
) -> None:
    vehicle = FakeVehicle.with_floats(OLD)
    half_written(tmp_path, vehicle)
    damage(tmp_path, damaged, body)
    async with started(tmp_path, vehicle) as engine:
        await until(lambda: engine.get("w1").state == JobState.REVERTED)
        assert vehicle.values() == {n: float32(v) for n, v in OLD.items()}
        state = engine.get(damaged).state
        assert state == (JobState.SUCCEEDED if damaged == "old" else JobState.FAILED)
        assert "damaged" in str(engine.get(damaged).outcome)


@pytest.mark.parametrize("body", BROKEN.values(), ids=BROKEN.keys())
async def test_a_write_whose_own_row_is_damaged_is_taken_back_by_its_journal(tmp_path: Path, body: bytes) -> None:
    vehicle = FakeVehicle.with_floats(OLD)
    half_written(tmp_path, vehicle)
    damage(tmp_path, "w1", body)
    assert vehicle.values()["INS_GYROFFS_X"] == float32(NEW["INS_GYROFFS_X"])
    async with started(tmp_path, vehicle) as engine:
        await until(lambda: engine.get("w1").state == JobState.REVERTED)
        assert vehicle.values() == {n: float32(v) for n, v in OLD.items()}


async def test_a_damaged_write_without_a_plan_keeps_its_vehicle_closed_and_says_so(tmp_path: Path) -> None:
    vehicle = FakeVehicle.with_floats(OLD)
    half_written(tmp_path, vehicle, keep_plan=False)
    damage(tmp_path, "w1", b"{")
    async with started(tmp_path, vehicle) as engine:
        assert engine.get("w1").state == JobState.IN_DOUBT
        assert "Compare the vehicle's calibration parameters" in str(engine.get("w1").outcome)
        with pytest.raises(PhysicalJobRunning):
            await engine.submit(vehicle.id, "gyro")


async def test_an_interrupted_write_is_finished_before_any_other_job_goes_on(tmp_path: Path) -> None:
    vehicle = FakeVehicle.with_floats(OLD)
    half_written(tmp_path, vehicle)
    store = SqliteStore(tmp_path)
    store.save_job(row_from_job(Job("f1", "vehicle-2", "gyro", {}, JobState.FITTING, 2.0, 2.0, context={})))
    engine = JobEngine(store, FakeRegistry({vehicle.id: vehicle}), settings=QUICK)
    seen: list[JobState] = []
    engine._runner.fit = lambda handle: _noted(seen, engine)  # type: ignore[method-assign]
    await engine.start()
    await until(lambda: bool(seen))
    assert seen == [JobState.REVERTED]
    await engine.stop()
    store.close()


async def _noted(seen: list[JobState], engine: JobEngine) -> None:
    await asyncio.sleep(0)
    seen.append(engine.get("w1").state)


async def test_a_damaged_journal_of_an_ended_job_stops_nothing(tmp_path: Path) -> None:
    vehicle = FakeVehicle.with_floats(OLD)
    half_written(tmp_path, vehicle)
    store = SqliteStore(tmp_path)
    store.add_journal("old", 1.0, "a step of another version", {})
    store.close()
    async with started(tmp_path, vehicle) as engine:
        await until(lambda: engine.get("w1").state == JobState.REVERTED)
        assert engine.get("old").state == JobState.SUCCEEDED
