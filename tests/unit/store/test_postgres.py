"""What only PostgreSQL has: many writers, a server that can go, a schema of its own words."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from mavcal.service.errors import StoreError
from mavcal.service.store.migrate import migrations
from mavcal.service.store.postgres import PostgresStore, to_postgres
from mavcal.service.store.rows import JobRow
from tests.postgres import Server

ROW = JobRow("j1", "v1", "gyro", "queued", 1.0, 1.0, {})


@pytest.fixture
def two(database_url: str) -> Iterator[tuple[PostgresStore, PostgresStore]]:
    """Two instances on one database."""
    stores = PostgresStore(database_url, None), PostgresStore(database_url, None)
    yield stores
    for store in stores:
        store.close()


def test_every_migration_has_its_number_in_both() -> None:
    assert [m.number for m in migrations("postgres")] == [m.number for m in migrations()]


def test_words_of_sqlite_are_translated_and_tables_keep_their_order() -> None:
    sql = "CREATE TABLE a (\n    x REAL,\n    body TEXT CHECK (json_valid(body))\n) STRICT;"
    assert to_postgres(sql) == (
        "CREATE TABLE a (\n    x DOUBLE PRECISION,\n    body TEXT CHECK (json_valid(body)),\n"
        "    rowid BIGINT GENERATED ALWAYS AS IDENTITY\n);"
    )
    assert "rowid" not in to_postgres("CREATE TABLE b (\n    id INTEGER PRIMARY KEY AUTOINCREMENT\n) STRICT;")


def test_instances_that_start_together_migrate_once(database_url: str) -> None:
    found: list[int] = []

    def start() -> None:
        store = PostgresStore(database_url, None)
        found.append(store.version)
        store.close()

    threads = [threading.Thread(target=start) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [len(migrations())] * 6


def test_a_schema_of_a_newer_version_is_refused(database_url: str) -> None:
    store = PostgresStore(database_url, None)
    store._run("UPDATE schema_version SET version = 999")
    store.close()
    with pytest.raises(StoreError, match="newer version"):
        PostgresStore(database_url, None)


def test_the_audit_chain_holds_under_many_writers(two: tuple[PostgresStore, PostgresStore]) -> None:
    def write(store: PostgresStore, name: str) -> None:
        for i in range(40):
            store.add_audit(float(i), name, "apply", f"j{i}", {"n": i})

    threads = [threading.Thread(target=write, args=(store, name)) for store, name in zip(two, "ab", strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    checked = two[0].check_audit()
    assert checked.intact
    assert checked.rows == 80


def test_who_reads_on_after_an_event_misses_none(two: tuple[PostgresStore, PostgresStore]) -> None:
    """Ids become visible in their order, although two instances write."""
    for number, store in enumerate(two):
        store.save_job(JobRow(f"j{number}", None, "fit", "queued", 1.0, 1.0, {}))
    done = threading.Event()

    def write(store: PostgresStore, job_id: str) -> None:
        for i in range(150):
            if i % 10:
                store.add_event(job_id, 0.0, "progress", {"i": i})
            else:
                store.save_job(JobRow(job_id, None, "fit", "queued", 1.0, 1.0, {}), event=("state", {"i": i}))

    threads = [threading.Thread(target=write, args=(store, f"j{n}")) for n, store in enumerate(two)]
    reader = PostgresStore(two[0]._database._url, None)  # type: ignore[attr-defined]
    seen: list[int] = []

    def read() -> None:
        while True:
            last_round = done.is_set()
            seen.extend(event.id for event in reader.events(after=seen[-1] if seen else 0))
            if last_round:
                return

    reading = threading.Thread(target=read)
    reading.start()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    done.set()
    reading.join()
    everything = [event.id for event in two[0].events()]
    reader.close()
    assert len(everything) == 300
    assert seen == everything
    assert [e.sequence for e in two[0].events("j0")] == list(range(1, 151))


def test_durable_commits_wait_for_the_disk_and_events_do_not(database_url: str) -> None:
    levels: list[str] = []

    class Watched(PostgresStore):
        def _commit(self, durable: bool) -> None:
            levels.append(self._database.execute("SHOW synchronous_commit")[0][0])
            super()._commit(durable)

    store = Watched(f"{database_url}?options=-c%20synchronous_commit%3Doff", None)  # whatever the server is set to
    store.save_job(ROW, event=("state", {}))
    store.add_event("j1", 0.0, "progress", {})
    store.add_journal("j1", 0.0, "send", {})
    store.close()
    assert levels == ["on", "off", "on"]


@pytest.mark.long
def test_a_database_that_comes_back_is_used_again(postgres: Server, database_url: str) -> None:
    store = PostgresStore(database_url, None)
    store.save_job(ROW)
    assert store.job("j1") == ROW
    postgres.kill()
    try:
        with pytest.raises(StoreError, match="cannot be reached"):
            store.add_journal("j1", 0.0, "send", {})
        with pytest.raises(StoreError, match="cannot be reached"):
            store.job("j1")
    finally:
        postgres.start()
    assert store.job("j1") == ROW
    store.add_journal("j1", 1.0, "send", {})
    assert [step.at for step in store.journal("j1")] == [1.0]
    store.close()


def test_no_password_is_said_when_the_database_cannot_be_reached(tmp_path: Path) -> None:
    for url in ("postgresql://me:hush-hush@127.0.0.1:1/x", "postgresql://me:hush-hush@[bad/x", "hush-hush"):
        with pytest.raises(StoreError) as refused:
            PostgresStore(url, tmp_path)
        assert "hush" not in str(refused.value)
    began = time.monotonic()
    with pytest.raises(StoreError):
        PostgresStore("postgresql://me@127.0.0.1:1/x", tmp_path)  # the directory was given back
    assert time.monotonic() - began < 60.0
