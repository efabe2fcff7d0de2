from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from mavcal.calib.procedures.protocol import Done, Pose, Prompt
from mavcal.calib.procedures.registry import validate_options
from mavcal.calib.recording import Identity
from mavcal.service.errors import CaptureEnded
from mavcal.service.jobs.capture import Capture, _asks
from mavcal.service.jobs.digest import LiveDigest
from mavcal.service.jobs.handle import JobHandle
from mavcal.service.jobs.model import Job
from mavcal.service.jobs.states import JobState
from mavcal.service.jobs.watch import CaptureWatch
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import SegmentPurpose
from mavcal.service.testing import FakeVehicle

from .conftest import QUICK


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
        (Prompt("rest", "Leave it alone."), False),
        (Prompt("turn", "Turn it.", rotate=True), True),
        (Prompt("turn", "Turn it.", rotate=True, stable=True), True),
        (Prompt("pose", "Put it.", remaining=(Pose.LEFT,)), True),
        (Prompt("pose", "Put it.", pose=Pose.LEFT), True),
        (Prompt("pose", "Hold it.", pose=Pose.LEFT, stable=True), False),
        (Prompt("pose", "Hold it.", remaining=(Pose.LEFT,), stable=True), False),
    ],
)
def test_an_operator_is_waited_for_only_where_there_is_something_to_do(prompt: Prompt, asks: bool) -> None:
    assert _asks(prompt) == asks
