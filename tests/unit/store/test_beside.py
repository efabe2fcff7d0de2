"""A data directory is read beside its owner, changes nothing of it, and says when there is none."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from mavcal.service.errors import DataDirLocked, DiskFull, StoreError
from mavcal.service.store import SqliteStore
from mavcal.service.store.datadir import DataDirLock, require_database
from mavcal.service.store.rows import ItemRow, JobRow
from mavcal.service.store.sqlite import DATABASE, check_audit_of, fleet_of, items_of, jobs_of

READERS: tuple[Callable[[Path], object], ...] = (check_audit_of, jobs_of, fleet_of, lambda path: items_of(path, "c1"))


def campaign(at: float, job_id: str = "c1") -> JobRow:
    return JobRow(job_id, None, "campaign", "running", at, at, {})


def test_jobs_and_items_are_read_as_their_owner_wrote_them(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path)
    late, early = campaign(2.0), campaign(1.0, "c0")
    store.save_job(late)
    store.save_job(early)
    items = [ItemRow("c1", n, f"v{n}", outcome, {}) for n, outcome in enumerate(("done", "failed", "waiting"), 1)]
    store.add_items(items)
    assert jobs_of(tmp_path) == store.jobs() == (early, late)
    assert items_of(tmp_path, "c1") == tuple(items)
    assert items_of(tmp_path, "c1", {"failed", "waiting"}) == tuple(items[1:])
    assert items_of(tmp_path, "c0") == ()
    store.save_job(campaign(3.0, "c2"))
    assert len(jobs_of(tmp_path)) == 3  # what was committed a moment ago
    store.close()
    assert len(jobs_of(tmp_path)) == 3


def test_the_audit_trail_is_checked_beside_its_owner(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path)
    for n in range(3):
        store.add_audit(float(n), "owner", "apply", "j1", {})
    beside = check_audit_of(tmp_path)
    assert beside == store.check_audit()
    assert (beside.rows, beside.intact) == (3, True)
    store.close()


@pytest.mark.parametrize("read", READERS)
def test_where_there_is_no_database_none_is_made(tmp_path: Path, read: Callable[[Path], object]) -> None:
    with pytest.raises(StoreError, match=r"there is no database in .*: give the --data-dir of the service"):
        read(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("read", READERS)
def test_a_file_that_is_no_database_is_said_to_be_none(tmp_path: Path, read: Callable[[Path], object]) -> None:
    (tmp_path / DATABASE).write_bytes(b"not a database at all" * 100)
    with pytest.raises(StoreError, match="the database refused: file is not a database"):
        read(tmp_path)


def test_a_folder_whose_name_looks_like_an_address_is_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "a?mode=rwc#b"
    SqliteStore(folder).close()
    assert jobs_of(folder) == ()
    assert [path.name for path in tmp_path.iterdir()] == [folder.name]


def test_a_full_disk_is_told_from_other_trouble(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path)
    pages = store._db.execute("PRAGMA page_count").fetchone()[0]
    store._db.execute(f"PRAGMA max_page_count = {pages}")  # the database cannot grow, as on a full disk
    with pytest.raises(DiskFull, match="Free some space"):
        store.save_job(JobRow("j1", None, "fit", "queued", 1.0, 1.0, {"text": "x" * 100_000}))
    assert store.job("j1") is None
    store._db.execute(f"PRAGMA max_page_count = {pages + 1000}")
    store.save_job(JobRow("j1", None, "fit", "queued", 1.0, 1.0, {"text": "x" * 100_000}))
    assert store.job("j1") is not None
    store.close()


def test_a_database_of_a_newer_version_is_left_as_it_is(tmp_path: Path) -> None:
    SqliteStore(tmp_path).close()
    db = sqlite3.connect(tmp_path / DATABASE)
    version = db.execute("PRAGMA user_version").fetchone()[0]
    db.execute(f"PRAGMA user_version = {version + 1}")
    db.close()
    with pytest.raises(StoreError, match="newer version"):
        SqliteStore(tmp_path)
    DataDirLock(tmp_path).release()  # whoever refuses it does not keep it


def test_a_data_directory_has_one_owner_who_is_named(tmp_path: Path) -> None:
    first = DataDirLock(tmp_path / "deep" / "er")
    with pytest.raises(DataDirLocked, match=f"in use by process {os.getpid()}: stop that process, or give this one"):
        DataDirLock(tmp_path / "deep" / "er")
    DataDirLock(tmp_path / "other").release()
    first.release()
    first.release()
    DataDirLock(tmp_path / "deep" / "er").release()
    assert (tmp_path / "deep" / "er").stat().st_mode & 0o077 == 0  # keys lie in it


def test_a_place_that_can_be_no_directory_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(StoreError, match=r"cannot be used .*: choose another one") as refused:
        DataDirLock(tmp_path / "file")
    assert not isinstance(refused.value, DataDirLocked)
    (tmp_path / "dir" / "lock").mkdir(parents=True)  # the folder can be opened, its lock cannot
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(5):
        with pytest.raises(StoreError, match="Is a directory"):
            DataDirLock(tmp_path / "dir")
    assert len(os.listdir("/proc/self/fd")) < before + 5  # nothing stays open


def test_recordings_without_their_database_are_counted_in_the_refusal(tmp_path: Path) -> None:
    for folder, name in (("tlogs", "a.tlog"), ("tlogs", "note.txt"), ("recordings", "r1"), ("recordings", "r2")):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / name).write_bytes(b"x")
    with pytest.raises(StoreError, match="has 3 recordings, but its database is missing or empty: put the database"):
        require_database(tmp_path, empty=True)
    require_database(tmp_path, empty=False)
    require_database(tmp_path / "elsewhere", empty=True)
