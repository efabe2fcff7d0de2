from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

from mavcal.calib.procedures.protocol import Pose, Prompt, PromptStep, Silence
from mavcal.service.errors import CaptureEnded, CaptureLost, CaptureMoved
from mavcal.service.jobs.calibrate.watch import CaptureWatch, LinkWatch
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store import SqliteStore
from tests.clock import ManualClock
from tests.unit.jobs.fakes import FakeVehicle


@dataclass
class Digest:
    """As much of a digest as the watch looks at."""

    last_time: float = 100.0
    restarted: bool = False


@dataclass
class Bench:
    vehicle: FakeVehicle
    clock: ManualClock
    digest: Digest
    warnings: list[str]
    watch: CaptureWatch

    def look(self) -> None:
        self.watch.look(self.digest)  # type: ignore[arg-type]


@pytest.fixture
def bench() -> Bench:
    vehicle, clock, warnings = FakeVehicle({}), ManualClock(), []
    watch = CaptureWatch(vehicle, JobSettings(gap_limit_s=60.0, stall_s=30.0), clock, warnings.append)
    return Bench(vehicle, clock, Digest(), warnings, watch)


@pytest.mark.parametrize(
    ("trouble", "text"),
    [
        ({"armed": True}, "armed"),
        ({"reboots": 1}, "restarted"),
        ({"calibrating": True}, "calibration of its own"),
        ({"conflict": "two vehicles"}, "two vehicles"),
    ],
)
def test_what_ends_a_capture_is_one_sentence_with_a_remedy(bench: Bench, trouble: dict[str, Any], text: str) -> None:
    bench.look()
    bench.vehicle.change_state(**trouble)
    with pytest.raises(CaptureEnded, match=text) as caught:
        bench.look()
    assert "start the job again" in caught.value.remedy


def test_a_capture_goes_on_over_another_link_in_a_segment_of_its_own(bench: Bench) -> None:
    bench.vehicle.change_state(way="cable")
    with pytest.raises(CaptureMoved, match="goes on over link cable"):
        bench.look()


def test_a_gap_is_survived_and_told_and_a_long_one_keeps_the_data(bench: Bench) -> None:
    bench.vehicle.change_state(silent=True)
    bench.look()
    bench.clock.advance(59.0)
    bench.look()
    bench.vehicle.change_state(silent=False)
    bench.digest.last_time = 160.0
    bench.look()
    assert len(bench.warnings) == 1
    bench.vehicle.change_state(silent=True)
    bench.look()
    bench.clock.advance(61.0)
    with pytest.raises(CaptureLost, match="silent for 61 s"):
        bench.look()


def test_a_heartbeat_without_samples_is_not_waited_for_for_ever(bench: Bench) -> None:
    bench.look()
    bench.clock.advance(29.0)
    bench.look()
    bench.digest.last_time += 0.1
    bench.look()
    bench.clock.advance(31.0)
    with pytest.raises(CaptureEnded, match="no inertial data"):
        bench.look()


@pytest.mark.parametrize(
    ("boot_elapsed", "restarted", "same"),
    [(60.0, False, True), (600.0, False, True), (5.0, False, False), (60.0, True, False)],
)
def test_after_a_restart_of_the_service_only_the_same_boot_goes_on(
    bench: Bench, boot_elapsed: float, restarted: bool, same: bool
) -> None:
    wall = 1_000_060.0  # a minute after the last record; a simulated vehicle may have lived ten
    bench.watch.resume(100.0, 1_000_000.0, lambda: wall)
    bench.look()  # nothing new yet
    bench.digest.last_time += boot_elapsed
    bench.digest.restarted = restarted
    if same:
        bench.look()
    else:
        with pytest.raises(CaptureLost, match="while the service was away"):
            bench.look()


def test_a_silent_vehicle_is_said_in_the_prompt_and_its_return_too() -> None:
    store, vehicle, clock = SqliteStore(None), FakeVehicle({}), ManualClock()
    handle = JobHandle(Job("one", vehicle.id, "gyro", {}, JobState.RUNNING, 0.0, 0.0), store, lambda _: None)
    handle.change("state", {})
    asked = Prompt(PromptStep.POSE, "Hold it.", remaining=(Pose.LEFT, Pose.BACK), detected=Pose.LEFT, stable=True)
    handle.prompt(asked)
    watch = LinkWatch(handle, vehicle, JobSettings(gap_limit_s=60.0), clock)
    watch.look()
    assert handle.job.prompt == asked
    vehicle.change_state(silent=True)
    watch.look()
    watch.look()
    assert handle.job.prompt is not None
    assert handle.job.prompt.text == (
        "The vehicle is silent: check its power and the link. The job gives up after 63 s of silence."
    )
    assert handle.job.prompt.silence == Silence(3.0, 63.0)
    assert handle.job.prompt.remaining == asked.remaining  # a pose that is open stays open
    clock.advance(20.0)
    watch.look()
    assert handle.job.prompt.silence == Silence(23.0, 63.0)
    vehicle.change_state(silent=False)
    watch.look()
    assert handle.job.prompt == asked
    assert handle.job.warnings == ("the vehicle was silent for about 23 s and is heard again",)
    assert [e.data.get("step") for e in store.events("one") if e.kind == "prompt"] == [
        "pose",
        "silent",
        "silent",
        "pose",
    ]
    store.close()


def test_a_prompt_that_changed_meanwhile_is_not_replaced_when_the_vehicle_is_heard_again() -> None:
    store, vehicle, clock = SqliteStore(None), FakeVehicle({}), ManualClock()
    handle = JobHandle(Job("one", vehicle.id, "gyro", {}, JobState.RUNNING, 0.0, 0.0), store, lambda _: None)
    handle.change("state", {})
    handle.prompt(Prompt(PromptStep.HOLD_STILL, "Do not touch it."))
    watch = LinkWatch(handle, vehicle, JobSettings(gap_limit_s=60.0), clock)
    vehicle.change_state(silent=True)
    watch.look()
    turn = Prompt(PromptStep.TURN, "Turn it on its side.")
    handle.prompt(turn)
    vehicle.change_state(silent=False)
    watch.look()
    assert handle.job.prompt == turn
    assert len(handle.job.warnings) == 1
    store.close()
