"""SIGKILL in the middle of a campaign: the next start goes on with what had not ended, and does nothing twice."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.running import RunningService
from mavcal.client.jobs import JobModel
from mavcal.client.models import ItemModel
from mavcal.service.lifetime import ending_with_us
from mavcal.service.simvehicle import SimulatedVehicle
from mavcal.service.store.sqlite import check_audit_of, items_of
from tests.patience import patience, scaled

from .api_bench import api
from .jobs_bench import stored, zero_gyro_offsets

LINK = "udpin:127.0.0.1:0"
LONG = 1_500_000
"""Rows of the last log: its fit takes so long that the campaign is not over when it is seen that some are made."""


def write_rest(path: Path, seed: int, rows: int = 60_000) -> Path:
    """A gyroscope at rest, for so long that its Allan variance takes a moment."""
    rng = np.random.default_rng(seed)
    np.savez(path, t=np.arange(rows) / 100.0, gyro=0.01 * rng.standard_normal((rows, 3)))
    return path


async def uploaded(folder: Path, paths: list[Path]) -> None:
    async with api(folder) as a:
        for path in paths:
            content = path.read_bytes()
            await a.call("POST", "/api/v1/recordings", 201, params={"name": path.name}, content=content)


def until(service: RunningService, job_id: str, reached: Callable[[list[ItemModel]], bool]) -> list[ItemModel]:
    limit = patience(60.0)
    while not reached(found := service.client.list_items(job_id)):
        assert not limit.over, found
        time.sleep(0.01)
    return found


def ended(service: RunningService, job_id: str) -> JobModel:
    limit = patience(90.0)
    while (job := service.client.get_job(job_id)).state == "running":
        assert not limit.over, service.client.list_items(job_id)
        time.sleep(0.05)
    return job


@pytest.mark.long
def test_fits_that_were_made_are_not_made_again(tmp_path: Path) -> None:
    data = tmp_path / "data"
    paths = [write_rest(tmp_path / f"rest{n}.npz", n) for n in range(7)]
    asyncio.run(uploaded(data, [*paths, write_rest(tmp_path / "rest7.npz", 7, LONG)]))
    first = RunningService(LINK, data)
    try:
        job_id = first.client.start_fit_campaign(recordings="all", method="allan", at_once=2).id
        before = until(first, job_id, lambda found: sum(i.outcome == "done" for i in found) >= 2)
    finally:
        first.kill()
    kept = {row.number: row for row in items_of(data, job_id)}
    done = {n: row.body for n, row in kept.items() if row.outcome == "done"}
    assert {i.number for i in before if i.outcome == "done"} <= set(done)
    assert len(done) < 8, "the campaign was over before it was killed"
    second = RunningService(LINK, data)
    try:
        job = ended(second, job_id)
        assert job.state == "succeeded", job.outcome
    finally:
        second.kill()
    after = {row.number: row for row in items_of(data, job_id)}
    assert [row.outcome for row in after.values()] == ["done"] * 8
    assert {n: after[n].body for n in done} == done  # to the time at which it was begun
    assert {row.body["starts"] for row in after.values()} <= {1, 2}


@pytest.mark.long
@pytest.mark.parametrize("state", ["running", "applying", "verifying"])
def test_calibrations_are_written_once(tmp_path: Path, state: str) -> None:
    data = tmp_path / "data"
    sims = [SimulatedVehicle("ardupilot", speed=4.0, seed=50 + n, config={"thermal": False}) for n in range(2)]
    with sims[0] as one, sims[1] as two:
        first = RunningService(LINK, data)
        try:
            ids = vehicles(first, one, two)
            begun = first.client.start_calibration_campaign(
                vehicles=ids, kind="gyro", options={"uncertainty": 0.02}, apply=True
            )
            reached = jobs_in(first, state)
        finally:
            first.kill()
        assert reached
        second = RunningService(LINK, data)  # it remembers the links
        try:
            job = ended(second, begun.id)
            assert job.state == "succeeded", job.outcome
            items = second.client.list_items(begun.id)
            assert [i.outcome for i in items] == ["done", "done"], items
            jobs = second.client.list_jobs(kind="gyro")
            assert sorted(j.vehicle_id or "" for j in jobs) == sorted(ids)  # one job a vehicle: none is begun twice
            for sim, vehicle_id in zip((one, two), ids, strict=True):
                (own,) = (j for j in jobs if j.vehicle_id == vehicle_id)
                plan = second.client.get_plan(own.id)
                held = stored(sim)
                assert {c.name: held[c.name] for c in plan.changes} == {c.name: c.new for c in plan.changes}
        finally:
            second.kill()
    assert check_audit_of(data).intact


def vehicles(service: RunningService, *sims: SimulatedVehicle) -> list[str]:
    """Ids of these vehicles, once they may be written to and there is something to calibrate."""
    links = [service.client.open_link(url=sim.url).id for sim in sims]
    limit = patience(30.0)
    while not limit.over:
        found = {v.link: v for v in service.client.list_vehicles() if v.writable and v.uid}
        if set(links) <= set(found):
            for sim in sims:
                zero_gyro_offsets(sim)
            return [found[link].id for link in links]
        time.sleep(0.05)
    raise AssertionError(service.client.list_vehicles())


def jobs_in(service: RunningService, state: str) -> bool:
    limit = patience(60.0)
    while not limit.over:
        if any(job.state == state for job in service.client.list_jobs(kind="gyro")):
            return True
        time.sleep(0.01)
    return False


def command(*words: str | Path) -> list[str]:
    return [sys.executable, "-m", "mavcal", "campaign", *map(str, words)]


def run(*words: str | Path) -> tuple[int, dict[str, Any]]:
    done = subprocess.run(command(*words, "--json"), capture_output=True, check=False, timeout=scaled(120))
    assert done.stdout, done.stderr.decode()
    return done.returncode, json.loads(done.stdout)


@pytest.mark.long
@pytest.mark.parametrize("executor", ["threads:2", "processes:2"])
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_command_that_was_stopped_is_resumed(tmp_path: Path, executor: str, how: signal.Signals) -> None:
    folder, data = tmp_path / "logs", tmp_path / "data"
    folder.mkdir()
    for n in range(9):
        write_rest(folder / f"rest{n}.npz", n)
    write_rest(folder / "rest9.npz", 9, LONG)
    words = command("fit", "allan", folder, "--data-dir", data, "--executor", executor)
    with subprocess.Popen(words, stderr=subprocess.PIPE, env=ending_with_us(), text=True) as process:
        assert process.stderr is not None
        job_id = process.stderr.readline().split()[1]
        limit = patience(60.0)
        while sum(row.outcome == "done" for row in items_of(data, job_id)) < 2:
            assert not limit.over
            time.sleep(0.02)
        os.kill(process.pid, how)
        _, said = process.communicate(timeout=scaled(60))
    kept = items_of(data, job_id)
    done = {row.number: row.body for row in kept if row.outcome == "done"}
    assert len(done) < 10, "the campaign was over before it was stopped"
    if how is signal.SIGINT:
        assert process.returncode == 130
        assert f"mavcal campaign resume {job_id}" in said
    code, told = run("resume", job_id, "--data-dir", data, "--executor", "threads:2")
    assert (code, told["state"], told["counts"]) == (0, "succeeded", {"done": 10})
    after = {row.number: row for row in items_of(data, job_id)}
    assert {n: after[n].body for n in done} == done
    code, told = run("resume", job_id, "--data-dir", data)
    assert (code, told["error"]["code"]) == (1, "illegal-transition")
