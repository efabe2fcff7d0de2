"""What a job tells while it waits, and how long it waits until a vehicle has saved."""

from __future__ import annotations

import asyncio
import dataclasses

import pytest

from calib.procedures.protocol import Progress
from service.jobs.handle import JobHandle, waiting
from service.jobs.port import Condition
from service.jobs.write import Writing
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
    ("restarted", "begins", "too_soon", "enough"), [(False, 100.0, 105.9, 106.0), (True, 3.0, 5.9, 6.0)]
)
async def test_saving_takes_its_time_from_the_last_write_and_after_a_restart_from_the_start(
    make_bench: MakeBench, *, restarted: bool, begins: float, too_soon: float, enough: float
) -> None:
    bench = make_bench()
    settings = dataclasses.replace(QUICK, settle_s={"ardupilot": 6.0})
    w = Writing(bench.handle, bench.vehicle, bench.plan, bench.accept, bench.check, settings)
    bench.vehicle.change_state(boot_time=begins)
    looks = 0

    stated = bench.vehicle.condition

    def condition() -> Condition:
        nonlocal looks
        looks += 1
        return stated()

    bench.vehicle.condition = condition  # type: ignore[method-assign]
    settling = asyncio.create_task(w.settle(restarted=restarted))
    await until(lambda: looks > 5)
    bench.vehicle.change_state(boot_time=too_soon)
    seen = looks
    await until(lambda: looks > seen + 20)
    assert not settling.done()
    bench.vehicle.change_state(boot_time=enough)
    await asyncio.wait_for(settling, 5.0)
