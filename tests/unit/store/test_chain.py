"""The audit trail: whoever changes it behind the service's back is noticed."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from mavcal.service.store import SqliteStore
from mavcal.service.store.migrate import migrate, migrations

ROWS = 6


def filled(folder: Path) -> None:
    store = SqliteStore(folder)
    for i in range(ROWS):
        store.add_audit(float(i), "key 7", "apply", f"j{i}", {"plan_sha256": "a" * 64, "n": i / 3})
    assert store.check_audit().intact
    store.close()


TAMPERING = {
    "a changed detail": ("UPDATE audit SET detail = '{}' WHERE id = 3", 3),
    "a changed actor": ("UPDATE audit SET actor = 'key 8' WHERE id = 1", 1),
    "a changed time": ("UPDATE audit SET at = at + 1e-6 WHERE id = 2", 2),
    "a removed row": ("DELETE FROM audit WHERE id = 3", 4),
    "a removed first row": ("DELETE FROM audit WHERE id = 1", 2),
    "a removed last row": (f"DELETE FROM audit WHERE id = {ROWS}", ROWS),
    "everything removed": ("DELETE FROM audit", 1),
    "a row that was put in": ("INSERT INTO audit VALUES (7, 9.0, 'x', 'y', 'z', '{}', NULL)", 7),
    "digests removed": ("UPDATE audit SET sha256 = NULL WHERE id > 3", 4),
    "two rows exchanged": (
        "UPDATE audit SET id = -1 WHERE id = 2; UPDATE audit SET id = 2 WHERE id = 3; "
        "UPDATE audit SET id = 3 WHERE id = -1",
        2,
    ),
}


@pytest.mark.parametrize(("sql", "broken_at"), TAMPERING.values(), ids=TAMPERING.keys())
def test_what_was_tampered_with_is_found(tmp_path: Path, sql: str, broken_at: int) -> None:
    filled(tmp_path)
    with sqlite3.connect(tmp_path / "mavcal.sqlite3") as db:
        db.executescript("DROP TRIGGER audit_is_append_only; DROP TRIGGER audit_is_kept;")
        db.executescript(sql)
    db.close()
    store = SqliteStore(tmp_path)
    assert store.check_audit().broken_at == broken_at
    store.close()


def test_the_head_moves_with_every_row_and_survives_a_restart(tmp_path: Path) -> None:
    filled(tmp_path)
    store = SqliteStore(tmp_path)
    before = store.check_audit()
    row = store.add_audit(9.0, "operator", "revert", "j1", {})
    after = store.check_audit()
    assert (before.rows, after.rows) == (ROWS, ROWS + 1)
    assert after.head == row.sha256 != before.head
    store.close()


def test_a_trail_from_before_the_chain_is_covered_by_its_first_row(tmp_path: Path) -> None:
    db = sqlite3.connect(tmp_path / "mavcal.sqlite3", isolation_level=None)
    migrate(db, migrations()[:1])
    db.execute("INSERT INTO audit VALUES (NULL, 1.0, 'a', 'apply', 'j1', '{}')")
    db.execute("INSERT INTO audit VALUES (NULL, 2.0, 'a', 'revert', 'j1', '{}')")
    db.close()
    store = SqliteStore(tmp_path)
    assert store.check_audit().intact
    store.add_audit(3.0, "b", "apply", "j2", {})
    assert store.check_audit().intact
    store._db.executescript("DROP TRIGGER audit_is_append_only; UPDATE audit SET actor = 'c' WHERE id = 1")
    assert store.check_audit().broken_at == 3
    store.close()


@pytest.mark.parametrize(("gone", "broken_at"), [(1, 2), (2, 3)])
def test_a_row_that_is_missing_from_before_the_chain_is_noticed(tmp_path: Path, gone: int, broken_at: int) -> None:
    """No digest tells: these rows have none, and no row after them is chained yet."""
    db = sqlite3.connect(tmp_path / "mavcal.sqlite3", isolation_level=None)
    migrate(db, migrations()[:1])
    for action in ("apply", "revert", "apply"):
        db.execute("INSERT INTO audit VALUES (NULL, 1.0, 'a', ?, 'j1', '{}')", (action,))
    db.close()
    store = SqliteStore(tmp_path)
    assert store.check_audit().intact
    store._db.executescript(f"DROP TRIGGER audit_is_kept; DELETE FROM audit WHERE id = {gone}")
    assert store.check_audit().broken_at == broken_at
    store.close()
