"""SIGKILL while a fit or a diagnosis of an upload runs: the next start begins it again, and it is listed as it is."""

from __future__ import annotations

import asyncio
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from bench.running import RunningService
from mavcal.client import Client
from mavcal.client.jobs import JobModel, ResultModel
from mavcal.service.cli import cli
from mavcal.service.jobs.core.states import ENDED
from mavcal.service.store.sqlite import SqliteStore
from tests.patience import scaled
from tests.service.gap_tables import write_table

from .api_bench import api

LINK = "udpin:127.0.0.1:0"


async def uploaded(folder: Path, path: Path) -> str:
    async with api(folder) as a:
        content = await asyncio.to_thread(path.read_bytes)
        made = await a.call("POST", "/api/v1/recordings", 201, params={"name": path.name}, content=content)
        return str(made["id"])


def write_rest(path: Path, rows: int = 1_500_000) -> Path:
    """A gyroscope at rest for so long that its Allan variance takes seconds: somebody late still sees it computed."""
    rng = np.random.default_rng(5)
    columns = [np.arange(rows) / 100.0, *(0.01 * rng.standard_normal((3, rows)))]
    np.savez(path, t=columns[0], gyro=np.column_stack(columns[1:]))
    return path


def begin(client: Client, kind: str, recording: str) -> str:
    if kind == "gap":
        return client.diagnose_gap(real=recording).id
    return client.start_fit(recording=recording, method="allan").id


def until(service: RunningService, job_id: str, *states: str) -> JobModel:
    limit = time.monotonic() + scaled(60)
    while (job := service.client.get_job(job_id)).state not in states:
        assert time.monotonic() < limit, job
        assert job.state not in ENDED, job.outcome
        time.sleep(0.02)
    return job


def shown(data: Path, kind: str) -> dict[str, Any]:
    """The one job of a kind as the command line lists it."""
    (job,) = json.loads(CliRunner().invoke(cli, ["jobs", "--data-dir", str(data), "--kind", kind, "--json"]).output)[
        "jobs"
    ]
    return dict(job)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["fit", "gap"])
def test_a_killed_computation_begins_again(tmp_path: Path, kind: str) -> None:
    data = tmp_path / "data"
    table = write_table(tmp_path / "real.csv", seconds=20.0) if kind == "gap" else write_rest(tmp_path / "rest.npz")
    recording = asyncio.run(uploaded(data, table))
    first = RunningService(LINK, data)
    try:
        job_id = begin(first.client, kind, recording)
        until(first, job_id, "fitting")
    finally:
        first.kill()
    store = SqliteStore(data)  # the directory is free, and the job was not ended by the kill
    row = store.job(job_id)
    store.close()
    assert row is not None
    assert row.state in {"queued", "fitting"}
    second = RunningService(LINK, data)
    try:
        ended = until(second, job_id, "succeeded")
        assert isinstance(ended.outcome, ResultModel)
        listed = shown(data, kind)  # beside the service that owns it, which says what it knows a moment earlier
        while listed["state"] == "fitting":
            time.sleep(0.05)
            listed = shown(data, kind)
        assert (listed["id"], listed["state"]) == (job_id, "succeeded")
        assert [job.id for job in second.client.list_jobs(kind=kind)] == [job_id]
    finally:
        second.kill()
