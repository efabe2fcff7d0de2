from __future__ import annotations

import sqlite3

import pytest

from mavcal.service.errors import StoreError
from mavcal.service.store.migrate import Migration, migrate, migrations, outstanding

STEPS = (
    Migration(1, "a", "CREATE TABLE a (x); INSERT INTO a VALUES (1);"),
    Migration(2, "b", "CREATE TABLE b (x);"),
    Migration(3, "c", "INSERT INTO a SELECT x + 1 FROM a;"),
)
BROKEN = (STEPS[0], Migration(2, "b", "CREATE TABLE b (x); INSERT INTO nowhere VALUES (1);"))


@pytest.fixture
def database():
    made = sqlite3.connect(":memory:", isolation_level=None)
    yield made
    made.close()


def tables(database):
    return {row[0] for row in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}


def version(database):
    return database.execute("PRAGMA user_version").fetchone()[0]


def test_an_empty_database_goes_through_every_step_and_a_current_one_through_none(database):
    assert migrate(database, STEPS) == version(database) == 3
    rows = database.execute("SELECT x FROM a").fetchall()
    assert rows == [(1,), (2,)]
    assert migrate(database, STEPS) == 3
    assert database.execute("SELECT x FROM a").fetchall() == rows


def test_an_older_database_lacks_the_later_steps_alone(database):
    migrate(database, STEPS[:2])
    assert version(database) == 2
    assert [step.name for step in outstanding(2, STEPS)] == ["c"]
    assert migrate(database, STEPS) == 3


def test_a_step_that_fails_leaves_nothing_of_itself(database):
    with pytest.raises(sqlite3.Error):
        migrate(database, BROKEN)
    assert (version(database), tables(database)) == (1, {"a"})
    assert not database.in_transaction
    assert migrate(database, STEPS) == 3  # and can be done later


def test_a_newer_database_is_not_touched(database):
    migrate(database, STEPS)
    with pytest.raises(StoreError, match="schema 3, this program knows 2"):
        migrate(database, STEPS[:2])
    assert outstanding(0, ()) == ()


@pytest.mark.parametrize("instead", ["", "postgres"])
def test_the_steps_of_the_store_are_numbered_without_a_gap(instead):
    steps = migrations(instead)
    assert [step.number for step in steps] == list(range(1, len(steps) + 1))
    assert all(step.sql.strip() for step in steps)
    assert [step.name for step in steps] == [step.name for step in migrations()]  # the same ones in both words


def test_some_steps_are_said_in_the_words_of_the_other_database():
    ours, theirs = migrations(), migrations("postgres")
    assert any(a.sql != b.sql for a, b in zip(ours, theirs, strict=True))
