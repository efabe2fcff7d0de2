"""A job that writes is never left without a task, whatever becomes of the one that it has."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from dataclasses import replace

import pytest
from structlog.testing import capture_logs

from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import WRITING, JobState
from mavcal.service.jobs.core.tasks import LOST, JobTasks
from mavcal.service.store import SqliteStore
from tests.unit.jobs.conftest import until


@pytest.fixture
def handle() -> Iterator[JobHandle]:
    store = SqliteStore(None)
    made = JobHandle(Job("j1", "v", "gyro", {}, JobState.APPLYING, 0.0, 0.0), store, lambda _: None)
    made.change("state", {})
    yield made
    store.close()


class Recovery:
    """Takes a write up that lost its task, and breaks as often as it is told to."""

    def __init__(self, breaks: int) -> None:
        self.breaks, self.reasons = breaks, list[str]()

    async def __call__(self, handle: JobHandle, reason: str) -> None:
        self.reasons.append(reason)
        await asyncio.sleep(0)
        if len(self.reasons) <= self.breaks:
            raise KeyError("x")
        handle.job = replace(handle.job, state=JobState.REVERTED)


async def broken() -> None:
    raise AssertionError("a defect")


async def cancelled_within() -> None:
    raise asyncio.CancelledError  # of a task inside; nobody cancelled the job


async def left() -> None:
    """Ends in good order, with the job not at its end."""


@pytest.mark.parametrize("state", sorted(WRITING))
@pytest.mark.parametrize("work", [broken, cancelled_within, left])
@pytest.mark.parametrize("breaks", [0, 3])
async def test_a_write_whose_task_ends_is_taken_up_until_it_is_at_an_end(
    handle: JobHandle, state: JobState, work: object, breaks: int
) -> None:
    handle.job = replace(handle.job, state=state)
    recovery, over = Recovery(breaks), list[JobHandle]()
    tasks = JobTasks(0.001, recovery, over.append)
    with capture_logs():
        tasks.spawn(handle, work)  # type: ignore[arg-type]
        await until(lambda: bool(over))
    assert recovery.reasons == [LOST] * (breaks + 1)
    assert handle.job.state == JobState.REVERTED
    assert tasks.running == {}


async def test_a_job_that_writes_nothing_ends_with_its_work(handle: JobHandle) -> None:
    handle.job = replace(handle.job, state=JobState.RUNNING)
    recovery, over = Recovery(0), list[JobHandle]()
    with capture_logs():
        JobTasks(0.001, recovery, over.append).spawn(handle, broken)
        await until(lambda: bool(over))
    assert (handle.job.state, recovery.reasons) == (JobState.FAILED, [])


async def test_a_stop_of_the_service_is_no_reason_to_take_a_write_up(handle: JobHandle) -> None:
    recovery, over = Recovery(0), list[JobHandle]()
    tasks = JobTasks(0.001, recovery, over.append)
    tasks.spawn(handle, asyncio.Event().wait)  # type: ignore[arg-type]
    await asyncio.sleep(0)
    tasks.stopping = True
    tasks.cancel("j1")
    await until(lambda: bool(over))
    assert (handle.job.state, recovery.reasons) == (JobState.APPLYING, [])


async def test_a_task_that_ends_late_leaves_the_job_to_the_next_one(handle: JobHandle) -> None:
    recovery, over = Recovery(0), list[JobHandle]()
    tasks = JobTasks(0.001, recovery, over.append)
    late, taken_back = asyncio.Event(), asyncio.Event()

    async def looks_on() -> None:
        handle.job = replace(handle.job, state=JobState.SUCCEEDED)
        await late.wait()

    async def takes_back() -> None:
        await taken_back.wait()
        handle.job = replace(handle.job, state=JobState.REVERTED)

    tasks.spawn(handle, looks_on)
    first = tasks.running[handle.id]
    await asyncio.sleep(0)
    handle.job = replace(handle.job, state=JobState.ROLLING_BACK)
    tasks.spawn(handle, takes_back)
    late.set()
    await asyncio.wait({first})
    assert (recovery.reasons, over) == ([], [])
    taken_back.set()
    await until(lambda: bool(over))
    assert (recovery.reasons, handle.job.state) == ([], JobState.REVERTED)
