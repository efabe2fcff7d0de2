"""What lies in the data directory never keeps the service from starting."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import JobRow, LinkRow, RecordingRow

from .api_bench import api


def filled(folder: Path) -> None:
    store = SqliteStore(folder)
    store.save_job(JobRow("j1", "v1", "gyro", "failed", 1.0, 1.0, {}), event=("state", {"state": "failed"}))
    store.add_recording(RecordingRow("r1", 1.0, "a.csv", folder / "recordings" / "r1.csv", 1, "0" * 64, {}))
    store.save_link(LinkRow("l1", "tcp:127.0.0.1:1", 1.0))
    store.close()


DAMAGE = {
    "a recording": "UPDATE recordings SET body = CAST(x'7bff' AS TEXT)",
    "an event": "UPDATE job_events SET data = '['",
    "a link": "UPDATE links SET url = CAST(x'00ff3a' AS TEXT)",
    "a job": "UPDATE jobs SET body = '7'",
}


@pytest.mark.parametrize("sql", DAMAGE.values(), ids=DAMAGE.keys())
async def test_a_damaged_row_does_not_stop_the_start_and_everything_is_listed(tmp_path: Path, sql: str) -> None:
    filled(tmp_path)
    with sqlite3.connect(tmp_path / "mavcal.sqlite3") as db:
        db.execute("PRAGMA ignore_check_constraints = ON")
        db.execute(sql)
    db.close()
    async with api(tmp_path) as a:
        await a.call("GET", "/readyz", 200)
        assert [r["id"] for r in await a.get("/recordings")] == ["r1"]
        assert [j["id"] for j in await a.get("/jobs")] == ["j1"]
        assert len(await a.get("/links")) == (0 if "links" in sql else 1)
        assert (await a.get("/jobs/j1"))["state"] == "failed"
        (row,) = a.service.store.events("j1")
        assert row.kind == "state"
