from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from mavcal.service.errors import DataDirLocked, DiskFull, StoreError
from mavcal.service.store import SqliteStore
from mavcal.service.store.migrate import Migration, migrate, migrations
from mavcal.service.store.rows import JobRow
from mavcal.service.store.sqlite import DATABASE


def row(job_id: str = "j1", *, state: str = "queued", vehicle: str = "v1", at: float = 1.0) -> JobRow:
    return JobRow(job_id, vehicle, "gyro", state, at, at, {"options": {"uncertainty": 0.1}})


def test_journal_is_append_only(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path)
    store.save_job(row())
    store.add_journal("j1", 1.0, "send", {"name": "A"})
    store.add_journal("j1", 2.0, "echo", {"name": "A"})
    assert [(j.step, j.data) for j in store.journal("j1")] == [("send", {"name": "A"}), ("echo", {"name": "A"})]
    store.close()
    with (
        sqlite3.connect(tmp_path / "mavcal.sqlite3") as db,
        pytest.raises(sqlite3.IntegrityError, match="append-only"),
    ):
        db.execute("UPDATE journal SET step = 'echo'")
    db.close()


def test_one_process_owns_a_data_directory(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path)
    with pytest.raises(DataDirLocked, match="--data-dir"):
        SqliteStore(tmp_path)
    store.close()
    SqliteStore(tmp_path).close()


def test_a_full_disk_is_said_and_leaves_nothing_behind(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path)
    store.save_job(row())
    pages = store._db.execute("PRAGMA page_count").fetchone()[0]
    store._db.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(DiskFull, match="Free some space"):
        store.save_job(JobRow("big", "v", "gyro", "queued", 0.0, 0.0, {"x": "y" * 1_000_000}))
    assert store.job("big") is None
    assert store.job("j1") == row()
    store._db.execute("PRAGMA max_page_count = 1000000")
    store.save_job(row("j2"))  # goes on once there is space
    store.close()


def test_jobs_of_an_older_schema_keep_all_that_belongs_to_them(tmp_path: Path) -> None:
    path = tmp_path / DATABASE
    db = sqlite3.connect(path, isolation_level=None)
    migrate(db, migrations()[:2])
    db.execute("INSERT INTO jobs VALUES ('j1', 'v1', 'gyro', 'verifying', 1.0, 2.0, '{}')")
    db.execute("INSERT INTO job_events VALUES (7, 'j1', 3, 2.0, 'state', '{}')")
    db.execute("INSERT INTO journal VALUES (5, 'j1', 2.0, 'sent', '{}')")
    db.close()
    store = SqliteStore(tmp_path)
    try:
        assert store.version == len(migrations())
        assert store.job("j1") == JobRow("j1", "v1", "gyro", "verifying", 1.0, 2.0, {})
        assert [(e.id, e.sequence) for e in store.events("j1")] == [(7, 3)]
        assert [j.step for j in store.journal("j1")] == ["sent"]
        assert store._db.execute("PRAGMA foreign_key_check").fetchall() == []
        assert store._db.execute("PRAGMA foreign_keys").fetchone() == (1,)
        with pytest.raises(StoreError, match="FOREIGN KEY"):
            store.add_event("j9", 0.0, "state", {})
    finally:
        store.close()


def test_migrations_are_numbered_without_gaps_and_a_failed_one_leaves_nothing() -> None:
    steps = migrations()
    assert [m.number for m in steps] == list(range(1, len(steps) + 1))
    db = sqlite3.connect(":memory:", isolation_level=None)
    bad = Migration(1, "bad", "CREATE TABLE a (x); CREATE TABLE a (x);")
    with pytest.raises(sqlite3.OperationalError):
        migrate(db, (bad,))
    assert db.execute("SELECT count(*) FROM sqlite_master").fetchone() == (0,)
    assert migrate(db, (Migration(1, "good", "CREATE TABLE a (x);"),)) == 1
    assert migrate(db, (Migration(1, "good", "CREATE TABLE a (x);"),)) == 1
    with pytest.raises(StoreError, match="newer version"):
        migrate(db, ())
    db.close()
