"""Hostile and slow files over HTTP: what they cost stays with a child, and live calibrations go on."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Set
from pathlib import Path

import httpx
import pytest

from tests.patience import scaled

from .api_bench import api, served
from .test_api_recordings import kept, sphere_csv, upload

TASKS = "tests.service.child_tasks"
GYRO = {"kind": "gyro", "options": {"uncertainty": 0.02}}


def children_of(pid: int, besides: Set[int] = frozenset()) -> set[int]:
    """Processes below `pid`, without `besides` and what those start: a database starts workers whenever it likes."""
    found, below = set(), {pid}
    while below:
        below = {int(one) for parent in below for one in _children(parent)} - besides
        found |= below
    return found


def _children(pid: int) -> list[str]:
    try:
        return Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return []


@pytest.fixture
def hanging(tmp_path, monkeypatch) -> Path:
    """Every upload is read for ever; the file that the readers' process id is written to."""
    monkeypatch.setattr("mavcal.service.recordings.INSPECT", f"{TASKS}:hang_on_path")
    return tmp_path


async def reading(folder: Path, count: int) -> list[int]:
    """The process ids of that many readers, once they are at it."""

    def at_it() -> list[int]:
        return [int(p.read_text()) for p in folder.rglob("*.pid") if p.read_text()]

    async with asyncio.timeout(scaled(60)):
        while len(found := at_it()) < count:  # noqa: ASYNC110 - another process says it
            await asyncio.sleep(0.02)
    return found


@pytest.mark.long
@pytest.mark.parametrize(
    ("task", "cause"),
    [("crash", "signal 11"), ("swallow_all", "more than 512 MiB of memory"), ("spin", "more than 1 s of processor")],
)
async def test_a_file_that_kills_its_reader_is_422_with_the_cause(tmp_path, monkeypatch, task, cause):
    # Half a GiB is a second of processor time where pages are slow to come: only the spinning task is to run out of it.
    limits = {"file_memory_bytes": 2**29, "file_cpu_s": 1.0 if task == "spin" else 60.0}
    async with api(tmp_path, limits=limits) as a:
        with monkeypatch.context() as patched:
            patched.setattr("mavcal.service.recordings.INSPECT", f"{TASKS}:{task}")
            problem = await upload(a, sphere_csv(20), 422)
        assert problem["type"].endswith("file-not-processed")
        assert cause in problem["detail"]
        assert kept(a) == []
        await upload(a, sphere_csv(20))


async def test_a_fit_that_kills_its_process_is_422_with_the_cause(tmp_path, monkeypatch):
    async with api(tmp_path) as a:
        row = await upload(a, sphere_csv(60))
        with monkeypatch.context() as patched:
            patched.setattr("mavcal.service.computations.FIT", f"{TASKS}:crash")
            problem = await a.post(f"/recordings/{row['id']}/fits", {"method": "mag-sphere"}, 422)
        assert "signal 11" in problem["detail"]
        await a.post(f"/recordings/{row['id']}/fits", {"method": "mag-sphere"}, 200)


async def test_the_reader_ends_when_the_client_goes_away(hanging):
    async with served(hanging) as a:
        asked = asyncio.create_task(upload(a, sphere_csv(20)))
        (pid,) = await reading(hanging, 1)
        asked.cancel()  # which closes the connection
        await asyncio.gather(asked, return_exceptions=True)
        async with asyncio.timeout(scaled(20)):
            while pid in children_of(os.getpid()):  # noqa: ASYNC110 - the kernel tells nobody
                await asyncio.sleep(0.05)
        async with asyncio.timeout(scaled(20)):
            while list((hanging / "recordings").glob("*.csv")):  # noqa: ASYNC110
                await asyncio.sleep(0.05)
        assert a.service.recordings.all() == ()


@pytest.mark.long
async def test_two_slow_uploads_do_not_starve_a_live_calibration(hanging):
    from mavcal.service.simvehicle import SimulatedVehicle

    with SimulatedVehicle("ardupilot", speed=20.0, seed=33, config={"thermal": False}) as sim:
        async with served(hanging, connect=(sim.url,)) as a:
            a.client.timeout = httpx.Timeout(None)
            slow = [asyncio.create_task(upload(a, sphere_csv(20), name=f"{i}.csv")) for i in range(2)]
            await reading(hanging, 2)
            vehicle = await a.vehicle()
            job = await a.post(f"/vehicles/{vehicle['id']}/jobs", GYRO, 202)
            await a.until(job["id"], "review", "succeeded", seconds=90)
            assert not any(task.done() for task in slow)
            for task in slow:
                task.cancel()
            await asyncio.gather(*slow, return_exceptions=True)


async def test_nothing_of_a_service_outlives_it(hanging):
    before = children_of(os.getpid())
    async with api(hanging) as a:
        slow = asyncio.create_task(upload(a, sphere_csv(20)))
        await reading(hanging, 1)
        assert children_of(os.getpid(), before)
    assert not children_of(os.getpid(), before)
    with pytest.raises(AssertionError):
        await slow  # it was answered with a problem
