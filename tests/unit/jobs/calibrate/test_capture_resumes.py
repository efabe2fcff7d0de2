"""A capture from its first question to its last, and one that goes on after a restart of the service."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.plan import Value
from mavcal.calib.procedures.protocol import Done
from mavcal.calib.procedures.registry import validate_options
from mavcal.calib.recording import Identity
from mavcal.calib.wire.codec import encode, raw_message
from mavcal.calib.wire.frames import FrameParser
from mavcal.service.errors import CaptureEnded, CaptureLost, VehicleSilent
from mavcal.service.jobs.calibrate.capture import Capture
from mavcal.service.jobs.calibrate.digest import LiveDigest
from mavcal.service.jobs.calibrate.watch import CaptureWatch
from mavcal.service.jobs.core.crashpoints import At
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.segments import SET_ASIDE
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import SegmentPurpose, SegmentRow
from tests.unit.jobs.conftest import QUICK
from tests.unit.jobs.fakes import FakeVehicle

BEGAN = 1_700_000_000.0


def record(wall_s: float, boot_s: float) -> bytes:
    """One record of a telemetry log: RAW_IMU, received at `wall_s`."""
    message = dialect.MAVLink_raw_imu_message(round(1e6 * boot_s), 0, 0, -1000, 0, 0, 0, 1, 2, 3, 0, 2500)
    data = encode(raw_message(message), 1, 1, 0)
    return round(1e6 * wall_s).to_bytes(8, "big") + bytes(data)


class AtOnce(Capture):
    """A capture whose procedure is done as soon as it begins."""

    begun: LiveDigest
    watch: CaptureWatch

    async def _until_done(self, digest: LiveDigest, watch: CaptureWatch) -> Done:
        self.begun, self.watch = digest, watch
        return Done((), "enough")


@pytest.fixture
def capture(tmp_path: Path) -> Iterator[AtOnce]:
    store = SqliteStore(None)
    vehicle = FakeVehicle.with_floats({"INS_GYROFFS_X": 0.5, "INS_GYR_ID": 7.0}, tlog=tmp_path / "a.tlog")
    vehicle.tlog.touch()
    options = validate_options("gyro", {})
    handle = JobHandle(Job("one", vehicle.id, "gyro", options, JobState.RUNNING, 0.0, 0.0), store, lambda _: None)
    handle.change("state", {})
    yield AtOnce(handle, vehicle, QUICK, wall=lambda: BEGAN + 20.0)
    store.close()


def segments(capture: Capture) -> tuple[SegmentRow, ...]:
    return capture.handle.store.segments("one", SegmentPurpose.CAPTURE)  # type: ignore[no-any-return, attr-defined]


def interrupted(capture: Capture) -> bytes:
    """The service ended ten seconds into the capture: its segment is open, and its log is there."""
    tlog = capture.vehicle.tlog_position().path
    data = b"".join(record(BEGAN + k, 100.0 + k) for k in range(11))
    tlog.write_bytes(b"before" + data)
    capture.handle.store.open_segment("one", SegmentPurpose.CAPTURE, tlog, 6)
    return data


async def test_what_was_recorded_before_a_restart_is_closed_and_taken_first(capture: AtOnce) -> None:
    data = interrupted(capture)
    await capture.run()
    first, second = segments(capture)
    assert (first.start_byte, first.end_byte) == (6, 6 + len(data))
    assert first.sha256 == hashlib.sha256(data).hexdigest()
    assert second.start_byte == 6 + len(data)
    assert second.end_byte is not None
    assert capture.begun.last_time == pytest.approx(110.0)


async def test_a_segment_that_was_closed_before_the_restart_stays_as_it_was(capture: AtOnce) -> None:
    interrupted(capture)
    (row,) = segments(capture)
    capture.handle.store.close_segment(row.id, row.start_byte + len(record(BEGAN, 100.0)), "0" * 64)
    await capture.run()
    assert segments(capture)[0].sha256 == "0" * 64
    assert capture.begun.last_time == pytest.approx(100.0)


async def test_what_was_set_aside_is_not_taken(capture: AtOnce) -> None:
    interrupted(capture)
    (row,) = segments(capture)
    capture.handle.change("set_aside", {}, context={SET_ASIDE: row.id})
    await capture.run()
    assert capture.begun.last_time == float("-inf")
    assert segments(capture)[0].end_byte is None


@pytest.mark.parametrize(("boot_s", "lost"), [(130.0, False), (116.0, False), (114.0, True)])
async def test_the_vehicles_clock_must_have_gone_on_as_long_as_ours(capture: AtOnce, boot_s: float, lost: bool) -> None:
    """Ten seconds passed between the last record and now; five are for what waits in buffers."""
    interrupted(capture)
    await capture.run()
    parser = FrameParser()
    capture.begun.feed(list(parser.feed(record(0.0, boot_s)[8:])))
    if lost:
        with pytest.raises(CaptureLost, match="restarted while the service was away"):
            capture.watch.look(capture.begun)
    else:
        capture.watch.look(capture.begun)


async def test_a_capture_that_begins_has_no_clock_to_go_on_from(capture: AtOnce) -> None:
    await capture.run()
    assert capture.watch._before is None


async def test_a_segment_without_a_record_is_no_reason_to_fail(capture: AtOnce) -> None:
    capture.handle.store.open_segment("one", SegmentPurpose.CAPTURE, capture.vehicle.tlog_position().path, 0)
    await capture.run()
    assert capture.watch._before is not None
    assert capture.watch._before[:2] == (float("-inf"), 0.0)


async def test_answers_that_were_given_before_the_restart_are_given_again(
    capture: AtOnce, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[Any] = []
    monkeypatch.setattr(LiveDigest, "schedule", lambda _self, answers: given.extend(answers))
    capture.handle.change("answer", {}, context={"answers": [[1.5, "finish"], [2.5, "skip"]]})
    await capture.run()
    assert given == [(1.5, "finish"), (2.5, "skip")]


async def test_what_the_parameters_foretell_is_said_before_anything_is_asked(capture: AtOnce) -> None:
    asked: list[tuple[Identity, Mapping[str, Value]]] = []

    def foresee(identity: Identity, parameters: Mapping[str, Value]) -> Sequence[str]:
        asked.append((identity, dict(parameters)))
        return ("it will take long", "and be warm")

    capture.foresee = foresee
    await capture.run()
    assert capture.handle.job.warnings == ("it will take long", "and be warm")
    ((identity, parameters),) = asked
    assert identity == capture.vehicle.identity
    assert parameters["INS_GYROFFS_X"] == 0.5
    assert capture.parameters == parameters


async def test_a_capture_that_is_foreseen_to_be_useless_ends_with_its_segment_closed(capture: AtOnce) -> None:
    def foresee(_identity: Identity, _parameters: Mapping[str, Value]) -> Sequence[str]:
        raise CaptureEnded("there is no such sensor", remedy="")

    capture.foresee = foresee
    with pytest.raises(CaptureEnded, match="no such sensor"):
        await capture.run()
    (row,) = segments(capture)
    assert row.end_byte is not None
    assert isinstance(capture.vehicle, FakeVehicle)
    assert capture.vehicle._frames == []


async def test_streams_are_asked_for_at_their_rates_and_measured(capture: AtOnce) -> None:
    capture.settings = replace(QUICK, measure_s=0.25)
    assert isinstance(capture.vehicle, FakeVehicle)
    vehicle, asked = capture.vehicle, []
    request = vehicle.request_streams

    async def streams(rates: Mapping[int, float], *, measure_s: float, before: Mapping[int, int]) -> tuple[str, ...]:
        asked.append((dict(rates), measure_s))
        await request(rates, measure_s=measure_s, before=before)
        return ("slower than asked",)

    vehicle.request_streams = streams  # type: ignore[method-assign]
    await capture.run()
    ((rates, measured),) = asked
    assert measured == 0.25
    assert 27 in rates
    assert all(rate > 0 for rate in rates.values())
    assert "slower than asked" in capture.handle.job.warnings


async def test_the_places_at_which_a_crash_leaves_something_behind_are_passed_in_turn(capture: AtOnce) -> None:
    passed: list[tuple[At, int]] = []
    capture.reach = lambda at: passed.append((at, sum(row.end_byte is None for row in segments(capture))))
    await capture.run()
    assert passed == [(At.CAPTURE_STARTED, 1), (At.CAPTURE_CLOSED, 0)]


async def test_the_reading_at_the_end_is_tried_again_while_the_vehicle_is_away_for_a_moment(capture: AtOnce) -> None:
    assert isinstance(capture.vehicle, FakeVehicle)
    vehicle, tries = capture.vehicle, 0
    read = vehicle.read_parameter

    async def away(name: str) -> Any:
        nonlocal tries
        if hasattr(capture, "begun"):
            tries += 1
            if tries == 1:
                raise VehicleSilent("it is away")
        return await read(name)

    vehicle.read_parameter = away  # type: ignore[method-assign]
    await capture.run()
    assert tries > 1


async def test_a_vehicle_that_is_armed_while_it_is_read_again_ends_the_capture(capture: AtOnce) -> None:
    assert isinstance(capture.vehicle, FakeVehicle)
    vehicle = capture.vehicle
    read = vehicle.read_parameter

    async def armed(name: str) -> Any:
        if hasattr(capture, "begun"):
            vehicle.change_state(armed=True)
            raise VehicleSilent("it is away")
        return await read(name)

    vehicle.read_parameter = armed  # type: ignore[method-assign]
    with pytest.raises(CaptureEnded, match="was armed"):
        await capture.run()


async def test_an_answer_that_is_taken_is_kept_with_its_time(capture: AtOnce) -> None:
    class Taking(LiveDigest):
        @property
        def time(self) -> float:
            return 12.5

        def answer(self, value: str) -> tuple[Any, ...]:
            return (value,)

    digest = Taking("gyro", capture.handle.job.options, capture.vehicle.identity, {}, 0.0)
    capture.handle.change("x", {}, context={"answers": [[1.0, "skip"]], "plan_options": {}})
    capture.handle.answers.put_nowait("finish")
    assert capture._answered(digest) == ["finish"]
    assert capture.handle.job.context == {"answers": [[1.0, "skip"], [12.5, "finish"]], "plan_options": {}}
    await capture.handle.kept()
    (told,) = [e.data for e in capture.handle.store.events("one") if e.kind == "answer"]  # type: ignore[attr-defined]
    assert told == {"value": "finish"}
