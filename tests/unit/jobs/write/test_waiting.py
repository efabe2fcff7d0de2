"""What a job tells while it waits, and how long it waits until a vehicle has saved."""

from __future__ import annotations

import asyncio
import dataclasses
import itertools

import pytest

from mavcal.calib.procedures.protocol import Progress
from mavcal.service.jobs.core.handle import JobHandle, waiting
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.write.context import Settling, WriteContext
from mavcal.service.vehicle.job_vehicle import Condition
from tests.unit.jobs.conftest import QUICK, Bench, MakeBench, until


def telling(bench: Bench) -> JobHandle:
    """The job's handle, which announces every progress."""
    return JobHandle(bench.handle.job, bench.store, lambda _: None, progress_s=0.001)


def progress(handle: JobHandle) -> Progress:
    assert handle.job.progress is not None
    return handle.job.progress


async def test_a_wait_tells_again_and_again_what_for_and_how_long_still(make_bench: MakeBench) -> None:
    handle = telling(make_bench())
    async with waiting(handle, "waiting for the kettle", 60.0):
        await until(lambda: handle.job.progress is not None)
        first = progress(handle)
        await until(lambda: progress(handle).current > first.current)
        later = progress(handle)
    assert (first.text, first.target, first.unit) == ("waiting for the kettle", 60.0, "s")
    assert first.eta == pytest.approx(60.0 - first.current)
    assert later.eta is not None
    assert first.eta is not None
    assert later.eta < first.eta
    tasks = [task for task in asyncio.all_tasks() if task.get_name() == f"progress of {handle.id}"]
    assert tasks == []


async def test_a_wait_that_takes_longer_than_expected_claims_no_time_left(make_bench: MakeBench) -> None:
    handle = telling(make_bench())
    async with waiting(handle, "waiting for the kettle", 0.002):
        await until(lambda: handle.job.progress is not None and progress(handle).current > 0.002)
    assert progress(handle).eta is None
    assert progress(handle).target == progress(handle).current


async def test_a_wait_of_unknown_length_shows_its_limit(make_bench: MakeBench) -> None:
    handle = telling(make_bench())
    async with waiting(handle, "waiting for the kettle", limit_s=90.0):
        await until(lambda: handle.job.progress is not None)
    assert (progress(handle).eta, progress(handle).target) == (None, 90.0)


@pytest.mark.parametrize(
    ("until_then", "begins", "too_soon", "enough"),
    [
        (Settling.SAVED, 100.0, 102.9, 103.0),
        (Settling.KEPT, 100.0, 105.9, 106.0),
        (Settling.RESTARTED, 3.0, 5.9, 6.0),
    ],
)
async def test_saving_takes_its_time_from_the_last_write_and_after_a_restart_from_the_start(
    make_bench: MakeBench, until_then: Settling, begins: float, too_soon: float, enough: float
) -> None:
    bench = make_bench()
    settings = dataclasses.replace(QUICK, settle_s={"ardupilot": 6.0}, save_s={"ardupilot": 3.0})
    w = WriteContext(bench.handle, bench.vehicle, bench.plan, bench.accept, bench.check, settings)
    bench.vehicle.change_state(boot_time=begins)
    looks = 0

    stated = bench.vehicle.condition

    def condition() -> Condition:
        nonlocal looks
        looks += 1
        return stated()

    bench.vehicle.condition = condition  # type: ignore[method-assign]
    settling = asyncio.create_task(w.settle(until_then))
    await until(lambda: looks > 5)
    bench.vehicle.change_state(boot_time=too_soon)
    seen = looks
    await until(lambda: looks > seen + 20)
    assert not settling.done()
    bench.vehicle.change_state(boot_time=enough)
    await until(settling.done)


async def test_what_is_rewritten_after_a_restart_is_found_by_its_read_back(make_bench: MakeBench) -> None:
    """PX4 may rewrite a gyro's offset 5 s after its start: the values of the first seconds are no proof."""
    bench = make_bench(reboot=True)
    vehicle = bench.vehicle
    vehicle.change_state(boot_time=100.0)
    settings = dataclasses.replace(QUICK, settle_s={"ardupilot": 6.0}, reboot_timeout_s=5.0)
    bench.attempt = lambda: WriteContext(  # type: ignore[method-assign]
        bench.handle, vehicle, bench.plan, bench.accept, bench.check, settings
    )
    writing = asyncio.create_task(bench.apply())
    await until(lambda: 246 in vehicle.commands)
    vehicle.change_state(reboots=1, boot_time=1.0)
    await until(lambda: bench.store.journal(bench.handle.id)[-1].step == "rebooted")
    vehicle.store("INS_GYROFFS_X", 0.5)
    vehicle.change_state(boot_time=6.1)
    await until(lambda: bench.state == JobState.ROLLING_BACK)
    clock = itertools.count(7.0)

    def taken_back() -> bool:
        vehicle.change_state(boot_time=next(clock))
        return writing.done()

    await until(taken_back)
    assert bench.state == JobState.REVERTED
    assert vehicle.values()["INS_GYROFFS_X"] == 0.5  # the third party's is left
