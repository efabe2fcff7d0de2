"""A database that lost a table: the service says so, and offers no write."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from mavcal.service.errors import StoreError
from mavcal.service.store.sqlite import DATABASE, SqliteStore
from tests.service.api_bench import served


async def test_without_its_journal_a_service_is_not_ready(tmp_path: Path) -> None:
    async with served(tmp_path) as a:
        assert (await a.client.get("/readyz")).status_code == 200
        with sqlite3.connect(a.service.settings.data_dir / DATABASE) as database:
            database.execute("DROP TABLE journal")
        database.close()
        answer = await a.client.get("/readyz")
        assert answer.status_code == 503
        assert "no table journal" in answer.json()["reason"]
        with pytest.raises(StoreError, match="no table journal"):
            await a.service.jobs.submit("1/1", "gyro")


@pytest.mark.parametrize("table", ["journal", "jobs", "snapshots", "plans", "audit"])
def test_every_table_that_a_write_needs_is_looked_for(table: str) -> None:
    store = SqliteStore(None)
    assert store.obstacle() is None
    store._database.execute(f"DROP TABLE {table}")
    assert table in (store.obstacle() or "")
    store.close()
