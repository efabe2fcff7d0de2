from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest

from mavcal.calib.procedures.protocol import Prompt, PromptStep
from mavcal.calib.recording import Identity
from mavcal.service.errors import VehicleBusy
from mavcal.service.jobs.core.admission import until_idle
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store import SqliteStore
from tests.unit.jobs.conftest import IMPATIENT, QUICK, MakeBench, until
from tests.unit.jobs.fakes import FakeVehicle


@pytest.fixture
def handle() -> Iterator[JobHandle]:
    store = SqliteStore(None)
    handle = JobHandle(Job("one", "v", "gyro", {}, JobState.QUEUED, 0.0, 0.0), store, lambda _: None)
    handle.change("state", {})
    yield handle
    store.close()


async def test_a_calibration_of_its_own_is_waited_for_and_shown(handle: JobHandle) -> None:
    vehicle = FakeVehicle({})
    vehicle.change_state(calibrating=True)
    waiting = asyncio.create_task(until_idle(handle, vehicle, JobSettings(watch_s=0.001)))
    await until(lambda: handle.job.prompt is not None)
    assert handle.job.prompt is not None
    assert handle.job.prompt.step == "busy"
    assert "calibration of its own" in handle.job.prompt.text
    assert "at most 60 s" in handle.job.prompt.text
    assert handle.job.progress is not None
    assert handle.job.progress.target == 60.0
    vehicle.change_state(calibrating=False)
    await waiting
    assert handle.job.prompt is None


async def test_the_wait_is_bounded(handle: JobHandle) -> None:
    vehicle = FakeVehicle({})
    vehicle.change_state(calibrating=True)
    with pytest.raises(VehicleBusy, match="has not ended within 0 s"):
        await until_idle(handle, vehicle, IMPATIENT)


async def test_a_px4_that_has_just_started_is_left_alone(handle: JobHandle) -> None:
    vehicle = FakeVehicle({}, identity=Identity("px4", 2, (1, 17, 0), "00", 1, 1))
    vehicle.change_state(boot_time=3.0)
    waiting = asyncio.create_task(until_idle(handle, vehicle, JobSettings(watch_s=0.001)))
    await until(lambda: handle.job.prompt is not None)
    assert "started less than 10 s ago" in handle.job.prompt.text  # type: ignore[union-attr]
    assert handle.job.progress is not None
    assert handle.job.progress.eta == 7.0  # the clock of this vehicle stands
    assert handle.job.progress.target == handle.job.progress.current + 7.0
    vehicle.change_state(boot_time=10.5)
    await waiting


async def test_who_waits_for_nothing_leaves_the_prompt_as_it_is(handle: JobHandle) -> None:
    asked = Prompt(PromptStep.TURN, "Turn it.", rotate=True)
    handle.prompt(asked)
    await until_idle(handle, FakeVehicle({}), QUICK)
    assert handle.job.prompt == asked
    assert handle.job.progress is None


async def test_a_write_waits_for_it_and_then_goes_on(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.vehicle.change_state(calibrating=True)
    running = asyncio.create_task(bench.apply())
    await until(lambda: bench.handle.job.prompt is not None)
    assert bench.vehicle.sets == []
    bench.vehicle.change_state(calibrating=False)
    await running
    assert bench.state == JobState.SUCCEEDED
