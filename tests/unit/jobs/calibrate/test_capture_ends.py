"""How a capture ends, and what it tells meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest

from mavcal.calib.procedures.protocol import Done, GaveUp, Progress, Prompt, PromptStep
from mavcal.calib.procedures.registry import validate_options
from mavcal.service.errors import CaptureEnded, DiskFull
from mavcal.service.jobs.calibrate.capture import Capture
from mavcal.service.jobs.calibrate.digest import LiveDigest
from mavcal.service.jobs.calibrate.watch import CaptureWatch
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store import SqliteStore
from tests.unit.jobs.conftest import QUICK
from tests.unit.jobs.fakes import FakeVehicle


class Judged(LiveDigest):
    """A digest whose procedure has come to an end already, or to none."""

    verdict: Done | GaveUp | None = None

    @property
    def outcome(self) -> Done | GaveUp | None:
        return self.verdict


@pytest.fixture
def capture() -> Iterator[Capture]:
    store = SqliteStore(None)
    vehicle = FakeVehicle.with_floats({})
    handle = JobHandle(Job("one", vehicle.id, "gyro", {}, JobState.RUNNING, 0.0, 0.0), store, lambda _: None)
    handle.change("state", {})
    yield Capture(handle, vehicle, QUICK)
    store.close()


async def ended(capture: Capture, verdict: Done | GaveUp | None) -> Done:
    digest = Judged("gyro", validate_options("gyro", {}), capture.vehicle.identity, {}, 0.0)
    digest.verdict = verdict
    watch = CaptureWatch(capture.vehicle, QUICK, capture.clock, capture.handle.warn)
    return await capture._until_done(digest, watch)


async def test_a_procedure_that_is_done_ends_the_capture(capture: Capture) -> None:
    capture._take((), None)
    done = Done((), "enough")
    assert await ended(capture, done) is done


async def test_a_procedure_that_is_done_at_once_does_not_hide_that_its_recording_has_a_hole(capture: Capture) -> None:
    """The fit reads the parameters in force from the recording: a plan without them would be about another vehicle."""
    capture._take((), DiskFull())
    with pytest.raises(DiskFull):
        await ended(capture, Done((), "enough"))


async def test_a_procedure_that_gives_up_says_why_and_what_helps(capture: Capture) -> None:
    with pytest.raises(CaptureEnded, match="it was moved") as caught:
        await ended(capture, GaveUp("it was moved", "Hold it still."))
    assert caught.value.remedy == "Hold it still."


async def test_a_full_disk_ends_a_capture_and_is_not_forgotten(capture: Capture) -> None:
    full = DiskFull()
    capture._take((), full)
    capture._take((), None)
    with pytest.raises(DiskFull) as caught:
        await ended(capture, None)
    assert caught.value is full


async def test_a_vehicle_that_was_armed_comes_before_what_the_procedure_makes_of_it(capture: Capture) -> None:
    vehicle = capture.vehicle
    assert isinstance(vehicle, FakeVehicle)
    vehicle.change_state(armed=True)
    with pytest.raises(CaptureEnded, match="the vehicle was armed"):
        await ended(capture, GaveUp("it was moved", "Hold it still."))


async def test_nothing_of_a_capture_goes_on_after_its_end(capture: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    """The watch of the link would prompt the operator of a job that is over."""
    steps: list[str] = []

    class Watch:
        def __init__(self, *_: object) -> None: ...

        async def run(self) -> None:
            try:
                await asyncio.Event().wait()
            finally:
                await asyncio.sleep(0)
                steps.append("ended")

    async def recorded(_: Capture) -> Done:
        await asyncio.sleep(0.001)
        return Done((), "enough")

    monkeypatch.setattr("mavcal.service.jobs.calibrate.capture.LinkWatch", Watch)
    monkeypatch.setattr(Capture, "_recorded", recorded)
    await capture.run()
    assert steps == ["ended"]


async def test_prompts_and_progress_are_shown_and_the_job_waits_where_something_is_asked(capture: Capture) -> None:
    handle = capture.handle
    turn, rest = Prompt(PromptStep.TURN, "Turn it.", rotate=True), Prompt(PromptStep.HOLD_STILL, "Leave it alone.")
    progress = Progress(1.0, 2.0, "s", "recording")
    capture._announce([turn, progress])
    assert (handle.job.prompt, handle.job.progress) == (turn, progress)
    assert handle.job.state == JobState.WAITING_FOR_OPERATOR
    capture._announce([turn])  # the same again moves nothing
    capture._announce([Done((), "enough")])
    assert (handle.job.prompt, handle.job.progress) == (turn, progress)
    capture._announce([rest])
    assert (handle.job.prompt, handle.job.state) == (rest, JobState.RUNNING)
    await handle.kept()
    states = [
        event.data["state"] for event in capture.handle.store.events("one") if event.kind == "state" and event.data
    ]
    assert states == [JobState.WAITING_FOR_OPERATOR, JobState.RUNNING]
