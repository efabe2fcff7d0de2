"""From a job's start to its plan: each way that it can end says what happened, and keeps what was recorded."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import pytest

from mavcal.calib.errors import FirmwareError
from mavcal.calib.procedures.protocol import GaveUp
from mavcal.calib.recording import Identity
from mavcal.calib.report import to_json
from mavcal.service.errors import CaptureEnded, CaptureLost, CommandTimeout
from mavcal.service.jobs.calibrate import runner as runner_module
from mavcal.service.jobs.calibrate.digest import Fitted
from mavcal.service.jobs.calibrate.runner import KEPT, Runner
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Failure, Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import SegmentPurpose
from tests.unit.jobs.conftest import QUICK, until
from tests.unit.jobs.fakes import FakeRegistry, FakeVehicle

IDENTITY = Identity("ardupilot", 2, (4, 7, 0), "00112233", 1, 1)


class AtOnce(Executor):
    """Runs nothing: what the fit comes to is up to the test."""

    def __init__(self, outcome: Any) -> None:
        self.outcome = outcome

    def submit(self, _fn: Any, /, *_args: Any, **_more: Any) -> Future[Any]:
        future: Future[Any] = Future()
        if isinstance(self.outcome, Exception):
            future.set_exception(self.outcome)
        else:
            future.set_result(self.outcome)
        return future


@pytest.fixture
def store() -> Iterator[SqliteStore]:
    found = SqliteStore(None)
    yield found
    found.close()


def job(store: SqliteStore, state: JobState) -> JobHandle:
    context = {"identity": to_json(IDENTITY)}
    handle = JobHandle(Job("j1", "vehicle-1", "gyro", {}, state, 0.0, 0.0, context=context), store, lambda _: None)
    handle.change("state", {})
    return handle


def runner(fitted: Any = None, registry: FakeRegistry | None = None) -> Runner:
    vehicle = FakeVehicle({})
    return Runner(registry or FakeRegistry({vehicle.id: vehicle}), QUICK, AtOnce(fitted), tuple)


@pytest.mark.parametrize(
    ("fitted", "cause", "remedy"),
    [
        (Fitted(GaveUp("it never rested", "Put it down."), {}), "It never rested.", "Put it down."),
        (CaptureEnded("it was damaged", remedy="Record again."), "It was damaged.", "Record again."),
        (FirmwareError("no such slot"), "No such slot.", "What was recorded is kept; start the job again."),
    ],
)
async def test_a_fit_that_fails_says_why_and_what_to_do(
    store: SqliteStore, fitted: Any, cause: str, remedy: str
) -> None:
    handle = job(store, JobState.FITTING)
    await runner(fitted).fit(handle)
    assert handle.job.state == JobState.FAILED
    assert isinstance(handle.job.outcome, Failure)
    assert handle.job.outcome.cause.lower() == cause.lower()
    assert handle.job.outcome.remedy == remedy


async def test_a_fit_whose_worker_was_killed_is_made_once_more(
    store: SqliteStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner_module, "fit_segments", lambda _request: Fitted(GaveUp("it was made", "Look."), {}))
    handle = job(store, JobState.FITTING)
    await runner(BrokenProcessPool("a worker was killed")).fit(handle)
    assert isinstance(handle.job.outcome, Failure)
    assert handle.job.outcome.cause == "it was made."


@pytest.mark.parametrize(
    ("error", "state", "remedy"),
    [
        (CaptureLost("it was away", remedy="Look for it."), JobState.INTERRUPTED, "Look for it."),
        (CaptureEnded("it was moved", remedy="Hold it."), JobState.FAILED, "Hold it."),
        (CommandTimeout("no answer"), JobState.FAILED, "Remove the cause and start the job again."),
        (FirmwareError("no such slot"), JobState.FAILED, "Remove the cause and start the job again."),
    ],
)
async def test_a_capture_that_fails_ends_the_job_in_its_own_way(
    store: SqliteStore, monkeypatch: pytest.MonkeyPatch, error: Exception, state: JobState, remedy: str
) -> None:
    async def fail(_self: object) -> None:
        raise error

    monkeypatch.setattr(runner_module.Capture, "run", fail)
    handle = job(store, JobState.QUEUED)
    await runner().calibrate(handle)
    assert handle.job.state == state
    assert isinstance(handle.job.outcome, Failure)
    assert handle.job.outcome.remedy == remedy
    assert handle.job.outcome.code == str(getattr(error, "code", "calibration-error"))


async def test_a_vehicle_is_waited_for_until_it_is_heard(store: SqliteStore) -> None:
    registry = FakeRegistry()
    handle = job(store, JobState.RUNNING)
    waiting = asyncio.create_task(runner(registry=registry).vehicle(handle))
    await asyncio.sleep(0.01)
    vehicle = FakeVehicle({})
    vehicle.change_state(silent=True)
    registry.vehicles[vehicle.id] = vehicle
    await asyncio.sleep(0.01)
    assert not waiting.done()
    vehicle.change_state(silent=False)
    assert await waiting is vehicle


async def test_one_that_never_comes_back_is_given_up_and_the_recording_kept(store: SqliteStore) -> None:
    now = [0.0]
    waited = runner(registry=FakeRegistry())
    waited.clock = lambda: now[0]
    task = asyncio.create_task(waited.vehicle(job(store, JobState.RUNNING)))
    await asyncio.sleep(0.01)
    now[0] = QUICK.return_limit_s
    await asyncio.sleep(0.01)
    assert not task.done()
    now[0] += 0.1
    with pytest.raises(CaptureLost, match="did not come back within 60 s") as lost:
        await task
    assert lost.value.remedy == KEPT


async def test_only_closed_segments_belong_to_a_job_that_ended(
    store: SqliteStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    handle = job(store, JobState.QUEUED)
    begun = store.open_segment("j1", SegmentPurpose.CAPTURE, Path("a.tlog"), 0)
    store.close_segment(begun.id, 10, "0" * 64)
    store.open_segment("j1", SegmentPurpose.CAPTURE, Path("a.tlog"), 20)

    async def fail(_self: object) -> None:
        raise CaptureEnded("it was moved", remedy="")

    monkeypatch.setattr(runner_module.Capture, "run", fail)
    await runner().calibrate(handle)
    assert [(span.start_byte, span.end_byte) for span in handle.job.segments] == [(0, 10)]


async def test_what_was_recorded_of_a_cancelled_job_is_named(
    store: SqliteStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = asyncio.Event()

    async def hang(_self: object) -> None:
        begun.set()
        await asyncio.sleep(3600.0)

    monkeypatch.setattr(runner_module.Capture, "run", hang)
    handle = job(store, JobState.QUEUED)
    task = asyncio.create_task(runner().calibrate(handle))
    await until(begun.is_set)
    row = store.open_segment("j1", SegmentPurpose.CAPTURE, Path("a.tlog"), 0)
    store.close_segment(row.id, 10, "0" * 64)
    handle.move(JobState.CANCELLED)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert [span.end_byte for span in handle.job.segments] == [10]
