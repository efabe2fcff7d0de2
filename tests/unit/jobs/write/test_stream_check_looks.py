"""How long a written calibration is looked at, what the job says meanwhile, and which streams it takes."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.plan import (
    Change,
    Movement,
    ParameterKind,
    ParameterVerdict,
    ProofVerdict,
    SensorCheck,
    SensorCheckId,
    SensorVerdict,
    Value,
    Verification,
)
from mavcal.calib.procedures.protocol import Pose, Progress, Prompt
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.wire.codec import encode, raw_message
from mavcal.service.errors import CaptureEnded, WriteFailed
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.write import stream_check as verify_module
from mavcal.service.jobs.write.guard import WriteGuard
from mavcal.service.jobs.write.stream_check import (
    ATTITUDE_HZ,
    FINISH,
    HOLD_STILL,
    STEP_S,
    StreamCheck,
    Window,
    pose_at_rest,
    proving,
)
from mavcal.service.store.rows import SegmentPurpose
from tests.unit.jobs.conftest import QUICK, Bench, MakeBench

ATTITUDE = 30
PROVED = Verification((ParameterVerdict("X", ProofVerdict.PROVED, 1.0, 0.1, "", ""),))
UNSEEN = replace(PROVED, unseen=("X", "Y"))
REFUTED = replace(
    PROVED,
    sensors=(
        SensorCheck(
            SensorCheckId.GYRO_ZERO, Sensor.GYRO, 0, 1.0, 0.1, "", 0.1, SensorVerdict.WRONG, "gyro 1 reads wrong"
        ),
    ),
)
GONE = Verification((ParameterVerdict("X", ProofVerdict.CONTRADICTED, 1.0, 0.1, "", ""),), unseen=("Y",))
OPEN = Verification(
    (
        ParameterVerdict("X", ProofVerdict.PROVED, 1.0, 0.1, "", ""),
        ParameterVerdict("Y", ProofVerdict.CONSISTENT, 1, 1, "", ""),
    ),
    Movement("Turn it.", turn=True),
)


def with_sensors(*sensors: Sensor, end: float = 103.0) -> Recording:
    """Three samples of each, the last one at `end`."""
    t, values = end + np.array([-1.0, -0.5, 0.0]), np.zeros((3, 3))
    return Recording(tuple(Channel(sensor, 0, t, values, "", Stage.RAW, "") for sensor in sensors))


def recording(end: float) -> Recording:
    return with_sensors(Sensor.GYRO, end=end)


def record(boot_s: float) -> bytes:
    """One record of a telemetry log: RAW_IMU."""
    message = dialect.MAVLink_raw_imu_message(round(1e6 * boot_s), 0, 0, -1000, 0, 0, 0, 1, 2, 3, 0, 2500)
    return bytes(8) + bytes(encode(raw_message(message), 1, 1, 0))


@dataclass
class Looks:
    """A check whose stream goes on as it is asked, and whose verdicts come from a list, the last one for ever."""

    bench: Bench
    verdicts: Sequence[Verification]
    settings: JobSettings
    prove_s: float
    monkeypatch: pytest.MonkeyPatch
    ends: list[float] = field(default_factory=list)
    told: list[Any] = field(default_factory=list)
    asked: list[Prompt | None] = field(default_factory=list)
    answer_at: float | None = None

    async def judged(self) -> Verification:
        handle = self.bench.handle
        check = StreamCheck(handle, self.bench.vehicle, self.bench.plan, self.prove_s, self.settings)
        left = list(self.verdicts)
        looks = self

        async def extend(_window: Window, seconds: float) -> Recording:
            looks.ends.append((looks.ends[-1] if looks.ends else 100.0) + seconds)
            if looks.answer_at is not None and looks.ends[-1] >= looks.answer_at:
                handle.answers.put_nowait(FINISH)
            return recording(looks.ends[-1])

        async def verdict(*_: object) -> Verification:
            return left.pop(0) if len(left) > 1 else left[0]

        self.monkeypatch.setattr(Window, "extend", extend)
        self.monkeypatch.setattr(check, "_verify", verdict)
        self.monkeypatch.setattr(handle, "progress", self.told.append)
        prompt = handle.prompt
        self.monkeypatch.setattr(handle, "prompt", lambda p: (self.asked.append(p), prompt(p)))
        return await check.after(WriteGuard(self.bench.vehicle, 0.01), {})

    @property
    def seen(self) -> list[Progress]:
        """What was told of the looks, without that of single waits."""
        return [one for one in self.told if "looking again" in one.text or "proved by" in one.text]


MakeLooks = Any


@pytest.fixture
def looks(make_bench: MakeBench, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> MakeLooks:
    def make(*verdicts: Verification, prove_s: float = 0.0, **settings: float) -> Looks:
        bench = make_bench()
        bench.vehicle.tlog = tmp_path / "a.tlog"
        bench.vehicle.tlog.touch()
        rules = replace(QUICK, check_s=3.0, observe_s=6.0)
        return Looks(bench, verdicts, replace(rules, **settings), prove_s, monkeypatch)  # type: ignore[arg-type]

    return make


async def test_what_is_seen_at_once_is_looked_at_once(looks: MakeLooks) -> None:
    one = looks(PROVED)
    assert await one.judged() is PROVED
    assert one.ends == [103.0]
    assert one.asked == [None]


@pytest.mark.parametrize(
    ("first", "cause"), [(UNSEEN, "no sensor at rest shows X, Y"), (REFUTED, "gyro 1 reads wrong")]
)
async def test_a_second_look_says_why_and_how_long_still(looks: MakeLooks, first: Verification, cause: str) -> None:
    one = looks(first, first, PROVED)
    assert await one.judged() is PROVED
    assert one.ends == [103.0, 103.0 + STEP_S, 103.0 + 2 * STEP_S]
    assert one.asked == [HOLD_STILL, HOLD_STILL, None]
    assert one.seen == [
        Progress(0.0, 6.0, "s", f"{cause}; looking again for up to 6 s", eta=6.0),
        Progress(2.0, 6.0, "s", f"{cause}; looking again for up to 4 s", eta=4.0),
    ]


async def test_looking_again_ends_after_its_time_or_when_the_operator_says_so(looks: MakeLooks) -> None:
    one = looks(UNSEEN)
    assert await one.judged() is UNSEEN
    assert one.ends == [103.0, 105.0, 107.0, 109.0]
    early = looks(UNSEEN)
    early.answer_at = 105.0
    assert await early.judged() is UNSEEN
    assert early.ends == [103.0, 105.0]


async def test_what_has_no_effect_is_not_looked_at_again(looks: MakeLooks) -> None:
    one = looks(GONE)
    assert await one.judged() is GONE
    assert one.ends == [103.0]


async def test_movements_are_asked_for_until_all_is_proved(looks: MakeLooks) -> None:
    one = looks(OPEN, OPEN, PROVED, prove_s=10.0)
    assert await one.judged() is PROVED
    assert OPEN.movement is not None
    assert one.asked == [proving(OPEN.movement, 1), proving(OPEN.movement, 1), None]
    text = "1 of 2 parameters proved by the stream; waits {} s at most"
    assert one.seen == [Progress(1, 2, "parameters", text.format(left)) for left in (10, 8)]


@pytest.mark.parametrize(("prove_s", "ends"), [(0.0, [103.0]), (2.0, [103.0, 105.0]), (3.0, [103.0, 105.0, 107.0])])
async def test_movements_are_waited_for_only_so_long(looks: MakeLooks, prove_s: float, ends: list[float]) -> None:
    one = looks(OPEN, prove_s=prove_s)
    assert await one.judged() is OPEN
    assert one.ends == ends


async def test_an_operator_who_has_finished_is_asked_for_no_more_movements(looks: MakeLooks) -> None:
    one = looks(OPEN, prove_s=100.0)
    one.answer_at = 105.0
    assert await one.judged() is OPEN
    assert one.ends == [103.0, 105.0]


async def test_nobody_is_asked_to_prove_what_must_go(looks: MakeLooks) -> None:
    one = looks(replace(REFUTED, movement=OPEN.movement), prove_s=100.0, observe_s=0.0)
    await one.judged()
    assert one.ends == [103.0]
    assert one.asked == [None]


async def test_without_a_stream_the_write_cannot_be_checked_and_its_segment_is_closed(
    looks: MakeLooks, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = looks(PROVED)

    async def none(_window: Window, _seconds: float) -> Recording:
        raise CaptureEnded("the vehicle sends no inertial data", remedy="")

    check = StreamCheck(one.bench.handle, one.bench.vehicle, one.bench.plan, 0.0, one.settings)
    monkeypatch.setattr(Window, "extend", none)
    with pytest.raises(WriteFailed, match="cannot be checked: the vehicle sends no inertial data"):
        await check.after(WriteGuard(one.bench.vehicle, 0.01), {})
    (row,) = one.bench.store.segments("j1", SegmentPurpose.AFTER)
    assert row.end_byte is not None


@pytest.mark.parametrize("stage", ["before", "after"])
@pytest.mark.parametrize("trim", [False, True])
async def test_each_window_has_its_streams_asked_for_and_the_attitude_where_a_trim_is_written(
    looks: MakeLooks, monkeypatch: pytest.MonkeyPatch, stage: str, trim: bool
) -> None:
    one = looks(PROVED)
    plan = one.bench.plan
    if trim:
        change = Change("AHRS_TRIM_X", 0.0, 0.1, ParameterKind.REAL32, "")
        plan = replace(plan, changes=(*plan.changes, change))
    asked: list[dict[int, float]] = []

    async def streams(_handle: object, _vehicle: object, rates: Mapping[int, float]) -> None:
        asked.append(dict(rates))

    async def extend(_window: Window, seconds: float) -> Recording:
        return recording(100.0 + seconds)

    async def verdict(*_: object) -> Verification:
        return PROVED

    monkeypatch.setattr(verify_module, "ask_for_streams", streams)
    monkeypatch.setattr(Window, "extend", extend)
    check = StreamCheck(one.bench.handle, one.bench.vehicle, plan, 0.0, one.settings)
    monkeypatch.setattr(check, "_verify", verdict)
    guard = WriteGuard(one.bench.vehicle, 0.01)
    await (check.before(guard) if stage == "before" else check.after(guard, {}))
    (rates,) = asked
    assert rates.get(ATTITUDE) == (ATTITUDE_HZ if trim else None)
    assert 27 in rates
    purpose = SegmentPurpose.BEFORE if stage == "before" else SegmentPurpose.AFTER
    (row,) = one.bench.store.segments("j1", purpose)
    assert row.end_byte is not None


async def test_after_a_crash_the_window_before_the_write_is_read_from_the_log(looks: MakeLooks) -> None:
    one = looks(PROVED)
    vehicle = one.bench.vehicle
    check = StreamCheck(one.bench.handle, vehicle, one.bench.plan, 0.0, one.settings)
    assert check._recorded() is None
    data = b"".join(record(100.0 + k) for k in range(4))
    vehicle.tlog.write_bytes(b"before" + data)
    store = one.bench.store
    opened = store.open_segment("j1", SegmentPurpose.BEFORE, vehicle.tlog, 6)
    assert check._recorded() is None  # the crash left it open
    store.close_segment(opened.id, 6 + len(data), hashlib.sha256(data).hexdigest())
    found = check._recorded()
    assert found is not None
    assert found.span == (100.0, 103.0)
    store.open_segment("j1", SegmentPurpose.BEFORE, vehicle.tlog, 9999)
    assert check._recorded() is not None


async def test_the_parameters_a_check_knows_are_those_of_the_plan_and_then_those_written(
    looks: MakeLooks, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = looks(PROVED)
    known: list[Mapping[str, Value]] = []
    windows: list[Any] = []

    def judge(*arguments: Any, parameters: Mapping[str, Value]) -> Verification:
        known.append(parameters)
        windows.append(arguments[2:4])
        return PROVED

    monkeypatch.setattr(verify_module, "verify", judge)
    check = StreamCheck(one.bench.handle, one.bench.vehicle, one.bench.plan, 0.0, one.settings)
    after = with_sensors(Sensor.GYRO, Sensor.ACCEL, Sensor.MAG)
    await check._verify(None, after, {"INS_GYROFFS_X": 0.25})
    await check._verify(after, after, {})
    assert known[0] == {**one.bench.vehicle.values(), "INS_GYROFFS_X": 0.25}
    assert windows[0][0] is None
    kept = [[c.sensor for c in window.channels] for window in (windows[0][1], *windows[1])]
    assert kept == [[Sensor.GYRO, Sensor.ACCEL]] * 3  # the plan rests on no compass


def test_poses_that_prove_are_asked_for_one_at_a_time_with_what_stays_open() -> None:
    movement = Movement("Hold it still nose down, then on its right side", faces=("nose_down", "right"), turn=True)
    first = proving(movement, 11)
    assert first.text == "Hold it still nose down. Then 1 more pose."
    assert (first.pose, first.remaining) == (Pose.NOSE_DOWN, (Pose.NOSE_DOWN, Pose.RIGHT))
    assert (first.stable, first.rotate, first.hold_s is not None) == (False, False, True)
    assert first.unfinished == "11 parameters stay unproved."
    assert proving(movement, 11, Pose.NOSE_DOWN).stable
    assert not proving(movement, 11, Pose.RIGHT).stable
    turn = proving(replace(movement, faces=()), 1)
    assert (turn.text, turn.rotate, turn.pose) == ("Turn the vehicle slowly through all directions.", True, None)


def test_the_pose_in_which_it_rests_is_seen_in_the_last_second() -> None:
    t, still = np.linspace(0.0, 3.0, 31), np.tile([9.8, 0.0, 0.0], (31, 1))
    rest = Recording((Channel(Sensor.ACCEL, 0, t, still, "m/s2", Stage.RAW, ""),))
    assert pose_at_rest(rest) == Pose.NOSE_UP
    shaken = still + 3.0 * (np.arange(31) % 2)[:, None]
    assert pose_at_rest(Recording((replace(rest.channels[0], values=shaken),))) is None
    assert pose_at_rest(Recording(())) is None
