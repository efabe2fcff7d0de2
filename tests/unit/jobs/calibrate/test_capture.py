from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import pytest

from mavcal.calib.errors import ProcedureError
from mavcal.calib.procedures.protocol import Done, Pose, Progress, Prompt, PromptStep, Step
from mavcal.calib.procedures.registry import validate_options
from mavcal.calib.recording import Identity
from mavcal.calib.wire.frames import Frame
from mavcal.service.errors import CaptureEnded
from mavcal.service.jobs.calibrate import capture as capture_module
from mavcal.service.jobs.calibrate.capture import Capture, _needs_operator
from mavcal.service.jobs.calibrate.digest import LiveDigest
from mavcal.service.jobs.calibrate.watch import CaptureWatch
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import SegmentPurpose
from tests.unit.jobs.conftest import QUICK, until
from tests.unit.jobs.fakes import FakeVehicle


class SlowToStart(FakeVehicle):
    """Its streams come one after the other while they are asked for; then it does not answer any more."""

    async def request_streams(
        self, rates: Mapping[int, float], *, measure_s: float, before: Mapping[int, int]
    ) -> tuple[str, ...]:
        self.tlog.write_bytes(bytes(1000))
        return await super().request_streams(rates, measure_s=measure_s, before=before)

    async def identify(self) -> Identity:
        raise CaptureEnded("that is enough", remedy="")


async def test_an_answer_that_comes_too_late_is_told_and_not_replayed() -> None:
    """The prompt may change between the answer's check and its turn: that must not end the job."""
    store = SqliteStore(None)
    vehicle = FakeVehicle.with_floats({})
    handle = JobHandle(Job("one", vehicle.id, "gyro", {}, JobState.RUNNING, 0.0, 0.0), store, lambda _: None)
    handle.change("state", {})
    capture = Capture(handle, vehicle, QUICK)
    digest = LiveDigest("gyro-turntable", validate_options("gyro-turntable", {}), vehicle.identity, {}, 0.0)
    handle.answers.put_nowait("45")
    assert capture._answered(digest) == []
    assert "the answer came too late" in handle.job.warnings[0]
    assert "answers" not in handle.job.context
    store.close()


class Choosy:
    """A digest that is at 3 s of its vehicle's time and takes one answer only."""

    time = 3.0
    taken: str

    def __init__(self, taken: str) -> None:
        self.taken = taken

    def answer(self, value: str) -> tuple[Step, ...]:
        if value != self.taken:
            raise ProcedureError(f"{value} is not asked for")
        return (Prompt(PromptStep.POSE, "Go on."),)


async def test_an_answer_behind_one_that_came_too_late_is_taken() -> None:
    store = SqliteStore(None)
    vehicle = FakeVehicle.with_floats({})
    handle = JobHandle(Job("one", vehicle.id, "gyro", {}, JobState.RUNNING, 0.0, 0.0), store, lambda _: None)
    handle.change("state", {})
    for value in ("late", "now"):
        handle.answers.put_nowait(value)
    steps = Capture(handle, vehicle, QUICK)._answered(cast(LiveDigest, Choosy("now")))
    assert [step.step for step in steps if isinstance(step, Prompt)] == ["pose"]
    assert handle.job.context["answers"] == [[3.0, "now"]]
    assert len(handle.job.warnings) == 1
    assert handle.answers.empty()
    store.close()


async def test_the_segment_begins_when_every_stream_was_asked_for(tmp_path: Path) -> None:
    """Else a replay would see a long beginning with some of the sensors, and leave the others out."""
    vehicle = SlowToStart.with_floats({}, tlog=tmp_path / "a.tlog")
    vehicle.tlog.touch()
    store = SqliteStore(None)
    job = Job("one", vehicle.id, "gyro", {}, JobState.RUNNING, 0.0, 0.0)
    handle = JobHandle(job, store, lambda _: None)
    handle.change("state", {})
    with pytest.raises(CaptureEnded, match="enough"):
        await Capture(handle, vehicle, QUICK).run()
    (segment,) = store.segments(job.id, SegmentPurpose.CAPTURE)
    assert segment.start_byte == 1000
    store.close()


class DoneAtOnce(Capture):
    """A capture whose procedure is done as soon as it begins; what happens meanwhile is up to the test."""

    meanwhile: Callable[[], None]

    async def _until_done(self, digest: LiveDigest, watch: CaptureWatch) -> Done:
        self.meanwhile()
        return Done((), "enough")


@pytest.mark.parametrize(
    ("kind", "name", "counts"),
    [
        ("gyro", "INS_GYROFFS_X", True),
        ("gyro", "INS_GYR_ID", True),
        ("gyro", None, False),
        ("accel", "INS_GYROFFS_X", False),
        ("accel", "INS_GYR_ID", True),
    ],
)
async def test_a_calibration_that_changed_unheard_is_found_by_reading_it_again(
    tmp_path: Path, kind: str, name: str | None, counts: bool
) -> None:
    """Its PARAM_VALUE was lost: only the reading at the end tells that the samples rest on two calibrations."""
    vehicle = FakeVehicle.with_floats({"INS_GYROFFS_X": 0.5, "INS_GYR_ID": 7.0, "SCHED": 1.0}, tlog=tmp_path / "a.tlog")
    vehicle.tlog.touch()
    store = SqliteStore(None)
    job = Job("one", vehicle.id, kind, validate_options(kind, {}), JobState.RUNNING, 0.0, 0.0)
    handle = JobHandle(job, store, lambda _: None)
    handle.change("state", {})
    capture = DoneAtOnce(handle, vehicle, QUICK)

    def change() -> None:
        vehicle.parameters["SCHED"] = replace(vehicle.parameters["SCHED"], value=2.0)  # no calibration
        if name is not None:
            vehicle.parameters[name] = replace(vehicle.parameters[name], value=0.25)

    capture.meanwhile = change
    if not counts:
        await capture.run()
    else:
        with pytest.raises(CaptureEnded, match=f"{name} changed from .* to 0.25 during the capture"):
            await capture.run()
    store.close()


@pytest.mark.parametrize(
    ("prompt", "asks"),
    [
        (Prompt(PromptStep.HOLD_STILL, "Leave it alone."), False),
        (Prompt(PromptStep.TURN, "Turn it.", rotate=True), True),
        (Prompt(PromptStep.TURN, "Turn it.", rotate=True, stable=True), True),
        (Prompt(PromptStep.POSE, "Put it.", remaining=(Pose.LEFT,)), True),
        (Prompt(PromptStep.POSE, "Put it.", pose=Pose.LEFT), True),
        (Prompt(PromptStep.POSE, "Hold it.", pose=Pose.LEFT, stable=True), False),
        (Prompt(PromptStep.POSE, "Hold it.", remaining=(Pose.LEFT,), stable=True), False),
    ],
)
def test_an_operator_is_waited_for_only_where_there_is_something_to_do(prompt: Prompt, asks: bool) -> None:
    assert _needs_operator(prompt) == asks


class Scripted:
    """A digest that asks the operator for something when it is fed, and is done a turn later."""

    time = 3.0
    warnings = ("too warm",)
    outcome: Done | None = None
    fed = 0

    def answer(self, _value: str) -> tuple[Step, ...]:
        return (Progress(1.0, 2.0, "", "half of it"),)

    def feed(self, frames: Sequence[Frame]) -> tuple[Step, ...]:
        self.fed += len(frames)
        self.outcome = Done((), "enough")
        return (Prompt(PromptStep.TURN, "Turn it.", rotate=True),)


class Unworried(CaptureWatch):
    def look(self, digest: LiveDigest | None = None) -> None:
        """Nothing stands in the way."""


async def test_what_a_procedure_says_reaches_whoever_watches_the_job(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture_module, "BATCH_S", 0.0)
    store = SqliteStore(None)
    vehicle = FakeVehicle.with_floats({})
    handle = JobHandle(Job("one", vehicle.id, "gyro", {}, JobState.RUNNING, 0.0, 0.0), store, lambda _: None)
    handle.change("state", {})
    capture, digest = Capture(handle, vehicle, QUICK), Scripted()
    watch = Unworried(vehicle, QUICK, capture.clock, handle.warn)
    handle.answers.put_nowait("half")
    working = asyncio.create_task(capture._until_done(cast(LiveDigest, digest), watch))
    await until(lambda: handle.job.progress is not None)
    assert handle.job.progress == Progress(1.0, 2.0, "", "half of it")
    assert handle.job.warnings == ("too warm",)
    assert (handle.job.state, handle.job.prompt) == (JobState.RUNNING, None)
    capture._take([cast(Frame, object())] * 3, None)
    assert (await working).because == "enough"
    assert digest.fed == 3
    assert (handle.job.state, handle.job.prompt) == (
        JobState.WAITING_FOR_OPERATOR,
        Prompt(PromptStep.TURN, "Turn it.", rotate=True),
    )
    store.close()
