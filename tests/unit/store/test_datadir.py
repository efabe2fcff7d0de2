"""One owner, no new start beside old recordings, and commits that survive a loss of power."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mavcal.service.errors import DataDirLocked, StoreError
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import JobRow, LinkRow, SegmentPurpose, SnapshotPurpose

DIGEST = "a" * 64


@pytest.mark.parametrize("removed", [["lock"], ["lock", "mavcal.sqlite3"], []])
def test_the_lock_survives_the_deletion_of_its_file(tmp_path: Path, removed: list[str]) -> None:
    store = SqliteStore(tmp_path)
    for name in removed:
        (tmp_path / name).unlink()
    with pytest.raises(DataDirLocked):
        SqliteStore(tmp_path)
    code = (
        f"from pathlib import Path; from mavcal.service.store import SqliteStore; SqliteStore(Path({str(tmp_path)!r}))"
    )
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "DataDirLocked" in other.stderr
    store.close()


@pytest.mark.parametrize("recorded", ["tlogs/udpin.tlog", "recordings/0a.bin"])
@pytest.mark.parametrize("database", [None, b""])
def test_an_empty_database_beside_recordings_is_an_error_with_a_remedy(
    tmp_path: Path, recorded: str, database: bytes | None
) -> None:
    (tmp_path / recorded).parent.mkdir()
    (tmp_path / recorded).write_bytes(b"x")
    if database is not None:
        (tmp_path / "mavcal.sqlite3").write_bytes(database)
    for _ in range(2):  # the refusal itself must not make one
        with pytest.raises(StoreError, match="from a backup, or choose another --data-dir"):
            SqliteStore(tmp_path)


def test_a_database_beside_recordings_is_opened_again(tmp_path: Path) -> None:
    SqliteStore(tmp_path).close()
    (tmp_path / "tlogs").mkdir()
    (tmp_path / "tlogs" / "a.tlog").write_bytes(b"x")
    SqliteStore(tmp_path).close()


class Watched(SqliteStore):
    """Notes how much SQLite synchronises at each commit: 0 off, 1 normal, 2 full, 3 extra."""

    def __init__(self, folder: Path) -> None:
        self.levels: list[int] = []
        super().__init__(folder)

    def _commit(self, durable: bool) -> None:
        (level,) = self._db.execute("PRAGMA synchronous").fetchone()
        self.levels.append(level)
        super()._commit(durable)


def test_a_store_commits_to_the_disk_from_its_opening_on(tmp_path: Path) -> None:
    """A migration is the first thing that is committed, before any row is."""
    store = Watched(tmp_path)
    assert store._db.execute("PRAGMA synchronous").fetchone() == (2,)
    store.close()


def test_every_commit_but_those_of_events_is_on_the_disk_when_it_returns(tmp_path: Path) -> None:
    store = Watched(tmp_path)
    for use in (
        lambda: store.save_job(JobRow("j", "v", "gyro", "queued", 0.0, 0.0, {}), event=("state", {})),
        lambda: store.add_journal("j", 0.0, "send", {}),
        lambda: store.add_snapshot("j", 0.0, SnapshotPurpose.BEFORE_WRITE, DIGEST, {}),
        lambda: store.add_plan("j", DIGEST, 0.0, {}),
        lambda: store.close_segment(store.open_segment("j", SegmentPurpose.CAPTURE, Path("x"), 0).id, 1, DIGEST),
        lambda: store.save_link(LinkRow("l", "u", 0.0)),
        lambda: store.claim_idempotency_key("k", DIGEST, "j", 0.0),
        lambda: store.save_signing_timestamp("s", 1),
        lambda: store.add_audit(0.0, "a", "b", "c", {}),
    ):
        store.add_event("j", 0.0, "progress", {}) if store.levels else None
        store.levels.clear()
        use()
        assert store.levels
        assert min(store.levels) >= 2
    store.levels.clear()
    store.add_event("j", 0.0, "progress", {})
    assert store.levels == [1]
    assert store._db.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    store.close()
