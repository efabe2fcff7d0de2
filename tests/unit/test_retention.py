"""What is forgotten in time, and the evidence of jobs, which is not."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from mavcal.service.jobs.core import states
from mavcal.service.retention import DAY_S, Retention
from mavcal.service.settings import RetentionSettings
from mavcal.service.store import SqliteStore, sql
from mavcal.service.store.rows import JobRow, RecordingRow, SegmentPurpose, SnapshotPurpose
from tests.patience import scaled

NOW = 1000 * DAY_S
DIGEST = "a" * 64


@pytest.fixture
def store(tmp_path: Path) -> Iterator[SqliteStore]:
    store = SqliteStore(tmp_path / "data")
    yield store
    store.close()


def tlog(folder: Path, name: str, days: float, size: int = 10) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.tlog"
    path.write_bytes(b"x" * size)
    os.utime(path, (NOW - days * DAY_S, NOW - days * DAY_S))
    return path


def upload(store: SqliteStore, folder: Path, name: str, days: float, size: int = 10) -> Path:
    path = folder / name
    path.write_bytes(b"x" * size)
    store.add_recording(RecordingRow(name, NOW - days * DAY_S, name, path, size, DIGEST, {}))
    return path


def retention(store: SqliteStore, tmp_path: Path, needed: set[str], held: set[Path], **settings: float) -> Retention:
    chosen = RetentionSettings.model_validate(settings)
    return Retention(store, chosen, tmp_path / "tlogs", lambda: needed, lambda: held, wall=lambda: NOW)


async def test_old_recordings_go_and_the_evidence_of_jobs_stays(store: SqliteStore, tmp_path: Path) -> None:
    tlogs = tmp_path / "tlogs"
    store.save_job(JobRow("j1", "v", "gyro", "succeeded", 0.0, 0.0, {}))
    evidence = tlog(tlogs, "evidence", 400)
    store.open_segment("j1", SegmentPurpose.CAPTURE, evidence, 0)
    still_written, old, young = tlog(tlogs, "open", 400), tlog(tlogs, "old", 400), tlog(tlogs, "young", 5)
    rested_on, unused = upload(store, tmp_path, "rested_on", 400), upload(store, tmp_path, "unused", 400)
    fresh = upload(store, tmp_path, "fresh", 5)
    store.add_journal("j1", 0.0, "send", {})
    store.add_snapshot("j1", 0.0, SnapshotPurpose.BEFORE_WRITE, DIGEST, {})
    await retention(store, tmp_path, {"rested_on"}, {still_written}, recordings_days=30).sweep()
    assert [p.exists() for p in (evidence, still_written, young, rested_on, fresh)] == [True] * 5
    assert not old.exists()
    assert not unused.exists()
    assert [r.id for r in store.recordings()] == ["rested_on", "fresh"]
    assert len(store.journal("j1")) == len(store.segments("j1")) == 1
    assert store.snapshot("j1", SnapshotPurpose.BEFORE_WRITE) is not None


async def test_the_oldest_go_first_when_there_is_too_much(store: SqliteStore, tmp_path: Path) -> None:
    oldest, older = upload(store, tmp_path, "oldest", 9, 60), tlog(tmp_path / "tlogs", "older", 8, 60)
    newest = upload(store, tmp_path, "newest", 1, 60)
    upload(store, tmp_path, "needed", 99, 10_000)
    await retention(store, tmp_path, {"needed"}, set(), recordings_bytes=130).sweep()
    assert [p.exists() for p in (oldest, older, newest)] == [False, True, True]
    await retention(store, tmp_path, {"needed"}, set(), recordings_bytes=0).sweep()
    assert [r.id for r in store.recordings()] == ["needed"]


async def test_telemetry_logs_have_a_budget_of_their_own(store: SqliteStore, tmp_path: Path) -> None:
    tlogs = tmp_path / "tlogs"
    logs = [tlog(tlogs, f"l{days}", days, 60) for days in (40, 20, 10, 1)]
    store.save_job(JobRow("j1", "v", "gyro", "succeeded", 0.0, 0.0, {}))
    store.open_segment("j1", SegmentPurpose.CAPTURE, logs[1], 0)
    uploaded = upload(store, tmp_path, "a", 400, 10_000)
    await retention(store, tmp_path, set(), set(), tlogs_bytes=130).sweep()
    assert [path.exists() for path in logs] == [False, True, True, True]
    await retention(store, tmp_path, set(), {logs[3]}, tlogs_days=5).sweep()
    assert [path.exists() for path in logs] == [False, True, False, True]
    await retention(store, tmp_path, set(), {logs[3]}, tlogs_bytes=0).sweep()
    assert [path.exists() for path in logs] == [False, True, False, True]
    assert uploaded.exists()


async def test_a_sweep_that_is_asked_for_comes_at_once(store: SqliteStore, tmp_path: Path) -> None:
    old = tlog(tmp_path / "tlogs", "old", 40)
    swept = retention(store, tmp_path, set(), {old}, tlogs_days=5)
    running = asyncio.create_task(swept.run())
    await asyncio.sleep(0.05)
    swept.open_files = lambda: ()
    swept.sweep_now.set()
    async with asyncio.timeout(scaled(5)):
        while old.exists():  # noqa: ASYNC110 - another thread removes it
            await asyncio.sleep(0.01)
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)


async def test_without_limits_every_recording_stays(store: SqliteStore, tmp_path: Path) -> None:
    kept = upload(store, tmp_path, "a", 999), tlog(tmp_path / "tlogs", "b", 999)
    await retention(store, tmp_path, set(), set()).sweep()
    assert all(path.exists() for path in kept)


async def test_old_events_of_ended_jobs_go_and_numbers_go_on(store: SqliteStore, tmp_path: Path) -> None:
    for job, state in (("ended", "succeeded"), ("running", "running")):
        store.save_job(JobRow(job, "v", "gyro", state, 0.0, 0.0, {}))
        for i in range(5):
            store.add_event(job, NOW - (100 - i) * DAY_S, "progress", {})
    await retention(store, tmp_path, set(), set(), events_days=90).sweep()
    assert [e.sequence for e in store.events("ended")] == [5]
    assert len(store.events("running")) == 5
    assert store.add_event("ended", NOW, "state", {}).sequence == 6


async def test_events_and_keys_are_bounded_in_number(store: SqliteStore, tmp_path: Path) -> None:
    store.save_job(JobRow("ended", "v", "gyro", "failed", 0.0, 0.0, {}))
    for i in range(20):
        store.add_event("ended", NOW, "progress", {"i": i})
        store.claim_idempotency_key(f"k{i}", DIGEST, "ended", NOW - (40 if i < 5 else 0) * DAY_S)
    await retention(store, tmp_path, set(), set(), events=4, keys=10).sweep()
    assert [e.data["i"] for e in store.events("ended")] == [16, 17, 18, 19]
    kept = [i for i in range(20) if store.idempotency_key(f"k{i}") is not None]
    assert kept == list(range(10, 20))


def test_the_store_knows_the_ended_states() -> None:
    assert set(sql.ENDED) == {state.value for state in states.ENDED}


@pytest.mark.parametrize("steps", range(6))
async def test_a_file_that_grew_at_the_moment_of_the_stop_does_not_keep_it_going(
    store: SqliteStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, steps: int
) -> None:
    """`asyncio.wait_for` of Python 3.11 takes such a cancellation for itself, and the service never ended."""
    kept = Retention(store, RetentionSettings(), tmp_path, frozenset, frozenset)
    swept = asyncio.Event()

    async def sweep() -> None:
        swept.set()

    monkeypatch.setattr(kept, "sweep", sweep)
    task = asyncio.create_task(kept.run())
    await swept.wait()
    for _ in range(10):  # it waits for the next time
        await asyncio.sleep(0)
    kept.sweep_now.set()
    for _ in range(steps):
        await asyncio.sleep(0)
    task.cancel()
    await asyncio.wait({task}, timeout=scaled(2))
    assert task.cancelled()
