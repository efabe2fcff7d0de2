"""Several instances on one database: who owns a vehicle, and what happens when its owner dies in mid-write."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from mavcal.service.core import Service, running_service
from mavcal.service.errors import JobElsewhere, LinkElsewhere, VehicleConflict
from mavcal.service.instances.instance import vehicle_subject
from mavcal.service.instances.leases import Leases, Owner
from mavcal.service.jobs.core.crashpoints import At
from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.jobs.core.states import ENDED, JobState
from mavcal.service.simvehicle import SimulatedVehicle
from tests.patience import scaled

from .instance_process import LEASE_S, owned, settings, until
from .jobs_bench import SPEED, eventually, stored, zero_gyro_offsets

ROOT = Path(__file__).resolve().parents[2]


CONFIG = {"thermal": False, "parameters": {"INS_GYR_CAL": 0.0, "INS_GYROFFS_X": 0.05}}
"""Off by far, and not mended by a calibration at boot: there is something to write whenever a job begins."""


@pytest.fixture
def sim() -> Iterator[SimulatedVehicle]:
    with SimulatedVehicle("ardupilot", speed=SPEED, seed=12, config=CONFIG) as vehicle:
        vehicle.call("still")
        yield vehicle


@pytest.fixture
def two_links() -> Iterator[SimulatedVehicle]:
    """A vehicle that two instances hear at the same time."""
    links = ["udpin", "udpin"]
    with SimulatedVehicle("ardupilot", link=links, speed=SPEED, seed=12, config=CONFIG) as vehicle:
        vehicle.call("still")
        yield vehicle


@asynccontextmanager
async def process(
    folder: Path, url: str, link: str, action: str, point: At, occurrence: int, how: str
) -> AsyncIterator[subprocess.Popen[bytes]]:
    """Another instance, until the end of the block."""
    command = [sys.executable, "-W", "error", "-m", "tests.service.instance_process", str(folder), url, link, action]
    command += [point.value, str(occurrence), how]
    with (folder / "a.log").open("wb") as log:
        running = subprocess.Popen(command, cwd=ROOT, stderr=log, stdout=log)  # noqa: ASYNC220 - it returns at once
        try:
            yield running
        finally:
            running.kill()
            running.wait()


async def jobs_of(service: Service, count: int = 1) -> str:
    await eventually(lambda: len(service.jobs.list()) >= count, 60.0)
    return service.jobs.list()[-1].id


@pytest.mark.long
@pytest.mark.timeout(240)
async def test_an_instance_killed_in_mid_write_is_followed_by_another_that_takes_it_back(
    tmp_path: Path, database_url: str, sim: SimulatedVehicle
) -> None:
    zero_gyro_offsets(sim)
    before = stored(sim)
    async with (
        process(tmp_path, database_url, sim.url, "apply", At.AFTER_ECHO, 4, "SIGKILL") as first,
        running_service(settings(tmp_path, database_url, name="b")) as second,
    ):
        job_id = await jobs_of(second)  # told by the other one
        await until(second, job_id, JobState.REVIEW)
        with pytest.raises(JobElsewhere):
            await second.jobs.cancel(job_id)
        with pytest.raises(LinkElsewhere, match="a"):
            await second.links.open(sim.url, trusted=True)
        await asyncio.to_thread(first.wait, scaled(120))
        assert first.returncode == -signal.SIGKILL
        assert stored(sim) != before
        assert second.jobs.get(job_id).state == JobState.APPLYING
        assert second.vehicles.all() == ()
        async with asyncio.timeout(scaled(60)):
            while not second.links.all():
                try:
                    await second.links.open(sim.url, trusted=True)
                except LinkElsewhere:
                    await asyncio.sleep(0.1)
        await until(second, job_id, *ENDED)
        assert second.jobs.get(job_id).state == JobState.REVERTED
        assert stored(sim) == before
        assert [row.step for row in second.store.journal(job_id)][-1] == JournalStep.CLOSED


@pytest.mark.long
@pytest.mark.timeout(240)
async def test_an_owner_that_stood_still_writes_nothing_more_once_it_is_not_the_owner(
    tmp_path: Path, database_url: str, two_links: SimulatedVehicle
) -> None:
    """It stands still right after it announced a PARAM_SET in the journal, and goes on when another has taken over."""
    sim = two_links
    zero_gyro_offsets(sim)
    before = stored(sim)
    async with (
        process(tmp_path, database_url, sim.urls[0], "apply", At.BEFORE_SEND, 4, "SIGSTOP") as first,
        running_service(settings(tmp_path, database_url, name="b")) as second,
    ):
        job_id = await jobs_of(second)
        await second.links.open(sim.urls[1], trusted=True)
        await until(second, job_id, JobState.REVERTED)
        assert stored(sim) == before
        journal = [row.id for row in second.store.journal(job_id)]
        os.kill(first.pid, signal.SIGCONT)
        log = tmp_path / "a.log"
        await eventually(lambda: b"a lease was lost" in log.read_bytes(), 30.0)
        await asyncio.sleep(LEASE_S)
        assert first.poll() is None
        assert stored(sim) == before
        assert [row.id for row in second.store.journal(job_id)] == journal
        assert second.jobs.get(job_id).state == JobState.REVERTED
        assert await owned(second) == second.jobs.get(job_id).vehicle_id


@pytest.mark.long
async def test_an_instance_that_stops_in_order_is_followed_at_once_and_jobs_go_on_under_the_next(
    tmp_path: Path, database_url: str, sim: SimulatedVehicle
) -> None:
    async with running_service(settings(tmp_path, database_url, name="b")) as second:
        async with running_service(settings(tmp_path, database_url, name="a")) as first:
            await first.links.open(sim.url, trusted=True)
            vehicle_id = await owned(first)
            job = await first.jobs.submit(vehicle_id, "gyro", {"uncertainty": 0.02})
            await eventually(lambda: any(known.id == job.id for known in second.jobs.list()))
            await until(first, job.id, JobState.REVIEW)
            await until(second, job.id, JobState.REVIEW)
            assert second.links.all() == ()
        await eventually(lambda: len(second.links.all()) == 1, 30.0)  # remembered in the database
        assert await owned(second) == vehicle_id
        assert second.jobs.get(job.id).state == JobState.REVIEW
        assert (await second.jobs.cancel(job.id)).state == JobState.CANCELLED


@pytest.mark.long
async def test_a_vehicle_that_another_instance_owns_is_left_alone_although_it_is_heard(
    tmp_path: Path, database_url: str, sim: SimulatedVehicle
) -> None:
    other = Leases(database_url, Owner("other", "b", "http://b:8765/"), 600.0)
    async with running_service(settings(tmp_path, database_url, name="a")) as service:
        link = await service.links.open(sim.url, trusted=True)
        vehicle_id = await owned(service)
        subject = vehicle_subject(vehicle_id)
        assert not other.acquire(subject)
        await service.links.close(link.id)
        await eventually(lambda: other.acquire(subject), 30.0)  # left, since it is not heard any more
        await service.links.open(sim.url, trusted=True)
        await eventually(lambda: any(v.id == vehicle_id and v.writable().ok for v in service.vehicles.all()))
        with pytest.raises(VehicleConflict, match="another instance"):
            await service.jobs.submit(vehicle_id, "gyro")
        other.release(subject)
        await owned(service)
        assert (await service.jobs.submit(vehicle_id, "gyro")).vehicle_id == vehicle_id
    other.close()
