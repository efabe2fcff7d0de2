from __future__ import annotations

import hashlib
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.earth import earth_field
from mavcal.calib.errors import ProcedureError
from mavcal.calib.procedures.base import TickedProcedure
from mavcal.calib.procedures.protocol import GaveUp, Step
from mavcal.calib.procedures.registry import validate_options
from mavcal.calib.procedures.spec import OperatorAnswer
from mavcal.calib.recording import Channel, Identity, Recording, Sensor, Stage
from mavcal.calib.wire.codec import encode, raw_message
from mavcal.calib.wire.frames import Frame, FrameParser
from mavcal.service.errors import CaptureDisturbed, CaptureEnded
from mavcal.service.jobs.calibrate import digest as digest_module
from mavcal.service.jobs.calibrate.digest import (
    JobFitRequest,
    LiveDigest,
    context_of,
    field_of,
    fit_segments,
    require_unchanged,
)
from mavcal.service.jobs.core.model import LogSpan
from mavcal.service.jobs.core.segments import content_of

CONTENT = bytes(range(256)) * 8


@pytest.fixture
def span(tmp_path: Path) -> LogSpan:
    path = tmp_path / "a.tlog"
    path.write_bytes(b"before" + CONTENT + b"behind")
    return LogSpan(path, 6, 6 + len(CONTENT), hashlib.sha256(CONTENT).hexdigest())


def test_a_segment_is_read_as_it_was_closed(span: LogSpan) -> None:
    assert content_of(span) == CONTENT


def test_a_segment_that_has_changed_by_one_bit_is_not_fitted(span: LogSpan) -> None:
    damaged = bytearray(span.path.read_bytes())
    damaged[100] ^= 1
    span.path.write_bytes(damaged)
    with pytest.raises(CaptureEnded, match="not what it was"):
        content_of(span)
    with pytest.raises(CaptureEnded, match="not what it was"):
        fit_segments(JobFitRequest("gyro", {}, (span,), 1, 0.0))


def test_a_segment_that_was_cut_off_or_has_gone_is_not_fitted(span: LogSpan) -> None:
    span.path.write_bytes(span.path.read_bytes()[:-100])
    with pytest.raises(CaptureEnded, match="not what it was"):
        content_of(span)
    span.path.unlink()
    with pytest.raises(CaptureEnded, match="cannot be read"):
        content_of(span)


def position(*rows: tuple[float, float, float]) -> Recording:
    values = np.array(rows, dtype=float).reshape(-1, 3)
    t = np.arange(len(values), dtype=float)
    return Recording((Channel(Sensor.POSITION, 0, t, values, "deg deg m", Stage.RAW, "TEST"),))


NOON = 1.7e9


def test_the_field_is_that_of_the_first_fix() -> None:
    berlin, sydney = (52.5, 13.4, 40.0), (-33.9, 151.2, 20.0)
    there = field_of(position(berlin), NOON)
    assert there is not None
    later, south = field_of(position((0.0, 0.0, 0.0), berlin, sydney), NOON), field_of(position(sydney, berlin), NOON)
    assert later is not None
    assert south is not None
    assert later.declination == there.declination != south.declination
    assert field_of(position((0.0, 13.4, 40.0)), NOON) is not None  # on the equator is no missing fix
    assert field_of(position((52.5, 0.0, 40.0)), NOON) is not None


def test_without_a_usable_position_there_is_no_field() -> None:
    assert field_of(Recording(()), NOON) is None
    assert field_of(position(), NOON) is None
    assert field_of(position((0.0, 0.0, 0.0)), NOON) is None
    assert field_of(position((95.0, 13.4, 40.0)), NOON) is None


def test_the_field_is_that_of_the_day() -> None:
    year = 365.25 * 86400.0
    first, later = (field_of(position((52.5, 13.4, 40.0)), NOON + k * year) for k in (0.0, 0.9))
    assert first is not None
    assert later is not None
    assert 0.0 < abs(first.declination - later.declination) < 0.01


@pytest.mark.parametrize(
    ("day", "year"),
    [
        (datetime(2026, 1, 1, tzinfo=UTC), 2026.0),
        (datetime(2025, 12, 31, 23, tzinfo=UTC), 2025.0 + 364 / 365.25),
        (datetime(2024, 12, 31, tzinfo=UTC), 2024.0 + 365 / 365.25),  # of a leap year
        (datetime(2026, 7, 2, tzinfo=UTC), 2026.0 + 182 / 365.25),
    ],
)
def test_a_day_is_its_share_of_the_year(day: datetime, year: float) -> None:
    there = (52.5, 13.4, 40.0)
    found = field_of(position(there), day.timestamp())
    assert found is not None
    np.testing.assert_array_equal(found.north_east_down, earth_field(*there, year).north_east_down)


def changed(name: str, before: float, after: float) -> CaptureEnded:
    """What ends the capture of a job that measures gyros."""
    with pytest.raises(CaptureEnded) as raised:
        require_unchanged("gyro", name, before, after)
    return raised.value


def test_a_parameter_that_changed_is_named_with_both_values_and_who_may_have_done_it() -> None:
    text = str(changed("INS_GYROFFS_X", 0.5, 0.25))
    assert (
        text == "INS_GYROFFS_X changed from 0.5 to 0.25 during the capture, set by another ground station, or the "
        "vehicle itself"
    )
    assert "IMU_GYRO_CAL_EN" in str(changed("CAL_GYRO0_XOFF", 0.0, 1.0))
    assert "IMU_GYRO_CAL_EN" not in str(changed("CAL_ACC0_XOFF", 0.0, 1.0))


def param_value(name: str, value: float) -> Any:
    return dialect.MAVLink_param_value_message(name.encode(), value, 9, 10, 1)


def heard(*messages: Any) -> list[Frame]:
    parser = FrameParser()
    return [f for m in messages for f in parser.feed(encode(raw_message(m), 1, 1, 0))]


ARDUPILOT = Identity("ardupilot", 2, (4, 7, 0), "00112233", 1, 1)


def test_a_capture_in_which_a_calibration_changes_is_refused_at_once() -> None:
    digest = LiveDigest("gyro", validate_options("gyro", {}), ARDUPILOT, {"INS_GYROFFS_X": 0.5}, 0.0)
    assert digest.feed(heard(param_value("INS_GYROFFS_X", 0.5), param_value("SR0_RAW_SENS", 7.0))) is not None
    digest.feed(heard(param_value("SR0_RAW_SENS", 8.0)))
    digest.feed(heard(param_value("INS_GYROFFS_Y", 0.125)))  # not known before: it held all along
    with pytest.raises(CaptureEnded, match=r"INS_GYROFFS_Y changed from 0\.125 to 0\.25"):
        digest.feed(heard(param_value("INS_GYROFFS_Y", 0.25)))


def test_a_segment_in_which_a_calibration_changed_is_not_fitted(tmp_path: Path) -> None:
    beat = dialect.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3)
    messages = [beat, param_value("INS_GYROFFS_X", 0.5), param_value("INS_GYROFFS_X", 0.25)]
    data = b"".join((10**15 + k).to_bytes(8, "big") + encode(raw_message(m), 1, 1, k) for k, m in enumerate(messages))
    path = tmp_path / "b.tlog"
    path.write_bytes(data)
    span = LogSpan(path, 0, len(data), hashlib.sha256(data).hexdigest())
    with pytest.raises(CaptureEnded, match=r"INS_GYROFFS_X changed from 0\.5 to 0\.25"):
        fit_segments(JobFitRequest("gyro", {}, (span,), 1, 0.0))


def test_a_procedure_expects_the_sensors_that_stream_and_no_others() -> None:
    ids = {f"INS_GYR{'' if k == 0 else k + 1}_ID": 100 + k for k in range(3)}
    ids |= {f"INS_ACC{'' if k == 0 else k + 1}_ID": 200 + k for k in range(3)}
    found = context_of("gyro", ARDUPILOT, ids, None)
    assert found.instances == {Sensor.ACCEL: (0, 1, 2), Sensor.GYRO: (0, 1, 2)}
    ids |= {f"COMPASS_DEV_ID{k}": 300 + int(k or 1) for k in ("", "2", "3")}
    ids |= {f"COMPASS_PRIO{k}_ID": 300 + k for k in (1, 2, 3)}
    assert context_of("gyro", ARDUPILOT, ids, None).instances == found.instances


def test_a_gyro_that_recalibrates_itself_does_not_end_the_capture_of_an_accelerometer(tmp_path: Path) -> None:
    """It tells rest from motion there and nothing else; the offset of the accelerometer still counts."""
    known = {"INS_GYROFFS_X": 0.5, "INS_ACCOFFS_X": 0.125}
    digest = LiveDigest("accel", validate_options("accel", {}), ARDUPILOT, known, 0.0)
    digest.feed(heard(param_value("INS_GYROFFS_X", 0.5), param_value("INS_GYROFFS_X", 0.25)))
    with pytest.raises(CaptureEnded, match="INS_ACCOFFS_X changed"):
        digest.feed(heard(param_value("INS_ACCOFFS_X", 0.25)))


@pytest.mark.parametrize(("kind", "refused"), [("accel", False), ("level", False), ("gyro", True), ("mag", True)])
def test_a_segment_is_refused_for_a_changed_gyro_offset_only_where_the_gyro_is_measured(
    tmp_path: Path, kind: str, refused: bool
) -> None:
    path = tmp_path / "a.tlog"
    beat = dialect.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3)
    frames = heard(beat, param_value("INS_GYROFFS_X", 0.5), param_value("INS_GYROFFS_X", 0.25))
    data = b"".join(int(1e6 * k).to_bytes(8, "big") + frame.raw for k, frame in enumerate(frames))
    path.write_bytes(data)
    request = JobFitRequest(kind, {}, (LogSpan(path, 0, len(data), hashlib.sha256(data).hexdigest()),), 1, 0.0)
    if refused:
        with pytest.raises(CaptureEnded, match="INS_GYROFFS_X changed"):
            fit_segments(request)
    else:
        assert isinstance(fit_segments(request).outcome, GaveUp)


def test_a_change_that_the_vehicle_may_have_made_itself_is_a_disturbance() -> None:
    """A job that costs nobody a pose then begins again by itself."""
    assert isinstance(changed("CAL_GYRO0_XOFF", 0.0, 1.0), CaptureDisturbed)
    assert isinstance(changed("INS_GYR1_CALTEMP", 30.0, 31.0), CaptureDisturbed)
    assert not isinstance(changed("CAL_ACC0_XOFF", 0.0, 1.0), CaptureDisturbed)
    assert "set IMU_GYRO_CAL_EN to 0" in changed("CAL_GYRO0_XOFF", 0.0, 1.0).remedy


@pytest.mark.parametrize(
    ("kind", "name", "before", "after", "spoiled"),
    [
        ("gyro", "CAL_GYRO0_PRIO", -1, 50, False),  # the same priority by another number
        ("gyro", "CAL_GYRO0_PRIO", 50, 0, True),
        ("gyro", "CAL_GYRO0_XOFF", 0.0, 0.1, True),
        ("gyro", "CAL_GYRO0_ID", 0, 1310988, True),
        ("accel", "CAL_GYRO0_ID", 0, 1310988, False),
        ("accel", "CAL_GYRO0_XOFF", 0.0, 0.1, False),
        ("accel", "CAL_ACC0_XOFF", 0.0, 0.1, True),
        ("mag", "CAL_GYRO0_XOFF", 0.0, 0.1, True),
        ("mag", "CAL_GYRO0_PRIO", -1, 50, False),
        ("thermal", "CAL_GYRO0_XOFF", 0.0, 0.1, False),  # undone from its time on
        ("thermal", "CAL_GYRO0_ID", 0, 1310988, True),
        ("thermal", "INS_GYROFFS_X", 0.0, 0.1, True),
    ],
)
def test_which_changes_spoil_a_capture(kind: str, name: str, before: float, after: float, spoiled: bool) -> None:
    if not spoiled:
        require_unchanged(kind, name, before, after)
        return
    with pytest.raises(CaptureEnded) as raised:
        require_unchanged(kind, name, before, after)
    assert isinstance(raised.value, CaptureDisturbed) == ("GYR" in name)


def test_a_compass_waits_for_its_position_and_takes_answers_only_then() -> None:
    digest = LiveDigest("mag", validate_options("mag", {}), ARDUPILOT, {}, 0.0)
    assert digest.time == float("-inf")
    assert digest.outcome is None
    assert digest.warnings == ()
    assert digest.answer("finish") == ()
    at_rest = LiveDigest("gyro", validate_options("gyro", {}), ARDUPILOT, {"INS_GYR_ID": 1, "INS_ACC_ID": 2}, 0.0)
    assert at_rest.outcome is None
    with pytest.raises(ProcedureError):
        at_rest.answer("left")


class Listening:
    """A procedure that keeps what it is told."""

    def __init__(self) -> None:
        self.scheduled: list[OperatorAnswer] = []

    def schedule(self, answers: Sequence[OperatorAnswer]) -> None:
        self.scheduled += answers

    def feed(self, _chunk: Recording) -> tuple[Step, ...]:
        return ()


def test_a_compass_that_begins_later_has_the_answers_of_before_a_restart(monkeypatch: pytest.MonkeyPatch) -> None:
    """The operator who has ended it is not asked again."""
    procedure = Listening()
    monkeypatch.setattr(digest_module, "create", lambda *_: procedure)
    monkeypatch.setattr(digest_module, "POSITION_WAIT_S", -1.0)
    digest = LiveDigest("mag", validate_options("mag", {}), ARDUPILOT, {}, 0.0)
    digest.schedule([(1.5, "finish")])
    assert procedure.scheduled == []
    digest.last_time = 1.0
    digest.feed(())
    assert procedure.scheduled == [OperatorAnswer(1.5, "finish")]


def test_answers_of_before_a_restart_are_handed_on_with_their_times() -> None:
    digest = LiveDigest("gyro", validate_options("gyro", {}), ARDUPILOT, {"INS_GYR_ID": 1}, 0.0)
    procedure = Listening()
    digest._procedure = cast(TickedProcedure, procedure)
    digest.schedule([(1.5, "finish"), (2.5, "skip")])
    assert procedure.scheduled == [OperatorAnswer(1.5, "finish"), OperatorAnswer(2.5, "skip")]


def imu(k: int, gyro_mrad_s: int) -> Any:
    return dialect.MAVLink_raw_imu_message(20_000 * k, 0, 0, -1000, gyro_mrad_s, 0, 0, 0, 0, 0, id=0, temperature=3000)


def test_samples_from_before_the_calibration_was_read_do_not_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The vehicle may have rewritten its offset between them and the reading."""
    beat = dialect.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3)
    before, after = [imu(k, 40) for k in range(1, 500)], [imu(k, 0) for k in range(500, 1000)]
    frames = heard(beat, *before, param_value("INS_GYR_ID", 1.0), param_value("INS_GYROFFS_X", 0.03125), *after)
    counted: list[Recording] = []

    class Listening:
        time = 0.0
        outcome = None

        def feed(self, chunk: Recording) -> tuple[Step, ...]:
            counted.append(chunk)
            return ()

        def schedule(self, answers: object) -> None:
            pass

    monkeypatch.setattr(digest_module, "create", lambda *_: Listening())
    live = LiveDigest("gyro", {}, ARDUPILOT, {"INS_GYR_ID": 1, "INS_GYROFFS_X": 0.03125}, 0.0)
    for start in range(0, len(frames), 7):
        live.feed(frames[start : start + 7])

    path = tmp_path / "a.tlog"
    data = b"".join(int(2e4 * k).to_bytes(8, "big") + frame.raw for k, frame in enumerate(frames))
    path.write_bytes(data)
    monkeypatch.setattr(digest_module, "replay", lambda *args: counted.append(args[3]))
    fit_segments(JobFitRequest("gyro", {}, (LogSpan(path, 0, len(data), hashlib.sha256(data).hexdigest()),), 1, 0.0))

    *chunks, whole = counted
    seen = [
        np.concatenate([c.values[:, 0] for chunk in some for c in chunk.find(Sensor.GYRO, 0)])
        for some in (chunks, [whole])
    ]
    assert len(seen[0]) == len(seen[1]) > 400
    for values in seen:
        assert np.ptp(values) == 0.0
