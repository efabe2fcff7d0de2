from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import calibration_in_force
from mavcal.calib.firmware.in_force.undo import GUARD_AFTER_S, KnownCalibration, Piece, Undo, calibration_changes, undo
from mavcal.calib.firmware.names import ardupilot_imu_names
from mavcal.calib.recording import (
    Channel,
    Identity,
    ParameterEntry,
    ParameterTimeline,
    Recording,
    Rounding,
    Sensor,
    Stage,
    join,
)

ARDUPILOT, PX4 = Identity(autopilot="ardupilot"), Identity(autopilot="px4")
AXES = "XYZ"
T = np.arange(0.0, 10.0, 0.02)
RAW = np.array([0.3, -0.2, -9.6]) + 0.1 * np.sin(T)[:, None] * [1.0, 2.0, 3.0]
AP_BASE: dict[str, float] = {
    "AHRS_ORIENTATION": 0,
    "COMPASS_EXTERNAL": 1,
    "COMPASS_ORIENT": 4,
    "COMPASS_SCALE": 1.1,
    "COMPASS_MOTCT": 0,
    "INS_TCAL1_ENABLE": 0,
    **{f"INS_ACCOFFS_{a}": v for a, v in zip(AXES, (0.1, -0.2, 0.3), strict=True)},
    **{f"INS_ACCSCAL_{a}": v for a, v in zip(AXES, (1.02, 0.98, 1.01), strict=True)},
    **{f"INS_GYROFFS_{a}": v for a, v in zip(AXES, (0.01, -0.02, 0.03), strict=True)},
    **{f"COMPASS_OFS_{a}": v for a, v in zip(AXES, (50.0, -60.0, 70.0), strict=True)},
    **{f"COMPASS_DIA_{a}": v for a, v in zip(AXES, (1.1, 0.9, 1.0), strict=True)},
    **{f"COMPASS_ODI_{a}": v for a, v in zip(AXES, (0.02, -0.03, 0.04), strict=True)},
    **{f"COMPASS_MOT_{a}": v for a, v in zip(AXES, (3.0, -2.0, 1.0), strict=True)},
}
TCAL: dict[str, float] = {
    "INS_TCAL1_ENABLE": 1,
    "INS_TCAL1_TMIN": 0,
    "INS_TCAL1_TMAX": 70,
    "INS_ACC1_CALTEMP": 30,
    **{f"INS_TCAL1_ACC{k}_{a}": v for a in AXES for k, v in ((1, 5000.0), (2, 60.0), (3, 1.0))},
}
PX4_BASE: dict[str, float] = {
    "SENS_BOARD_ROT": 0,
    "SENS_BOARD_X_OFF": 0.0,
    "SENS_BOARD_Y_OFF": 0.0,
    "SENS_BOARD_Z_OFF": 0.0,
    "CAL_ACC0_ID": 7,
    "CAL_ACC0_ROT": -1,
    **{f"CAL_ACC0_{a}OFF": 0.0 for a in AXES},
    **{f"CAL_ACC0_{a}SCALE": 1.0 for a in AXES},
}
KEY = (Sensor.GYRO, 0)
X, Y = "CAL_GYRO0_XOFF", "CAL_GYRO0_YOFF"


def channel(
    values: np.ndarray, sensor: Sensor = Sensor.ACCEL, stage: Stage = Stage.FILTERED, **more: object
) -> Channel:
    return dataclasses.replace(Channel(sensor, 0, T, values, "m/s2", stage, "RAW_IMU"), **more)


def temperature(values: np.ndarray, t: np.ndarray = T) -> Channel:
    return Channel(Sensor.TEMPERATURE, 0, t, values, "degC", Stage.RAW, "RAW_IMU")


def recording(
    *channels: Channel,
    parameters: dict[str, float],
    identity: Identity = ARDUPILOT,
    later: tuple[ParameterEntry, ...] = (),
) -> Recording:
    entries = ParameterTimeline.constant(parameters).entries + later
    return Recording(channels, ParameterTimeline(entries), identity=identity)


def corrected(
    parameters: dict[str, float], raw: np.ndarray, sensor: Sensor = Sensor.ACCEL, degrees: np.ndarray | None = None
) -> np.ndarray:
    return calibration_in_force("ardupilot", parameters, sensor, 0).apply(raw, degrees)


class TestArdupilot:
    def test_the_accelerometer_with_literal_numbers(self) -> None:
        parameters = AP_BASE | {"AHRS_ORIENTATION": 2}  # yaw 90: body is (-y, x, z)
        row = channel(np.tile([-0.98, 1.02, -10.1], (len(T), 1)))
        out = undo(recording(row, parameters=parameters)).channel(Sensor.ACCEL)
        assert out.stage == Stage.RAW
        assert out.values[0] == pytest.approx([1.1, 0.8, -9.7])

    @pytest.mark.parametrize("sensor", [Sensor.ACCEL, Sensor.GYRO, Sensor.MAG])
    @pytest.mark.parametrize("board", [0, 2, 28, 39])
    def test_there_and_back(self, sensor: Sensor, board: int) -> None:
        parameters = AP_BASE | {"AHRS_ORIENTATION": board}
        row = channel(corrected(parameters, RAW, sensor), sensor)
        out = undo(recording(row, parameters=parameters)).channel(sensor)
        assert out.values == pytest.approx(RAW, abs=1e-12)

    def test_the_temperature_of_each_sample(self) -> None:
        parameters, warm = AP_BASE | TCAL, 20 + 4 * T
        row = channel(corrected(parameters, RAW, degrees=warm))
        out = undo(recording(row, temperature(warm), parameters=parameters)).channel(Sensor.ACCEL)
        assert out.values == pytest.approx(RAW, abs=1e-12)
        unaware = undo(recording(row, temperature(warm), parameters=AP_BASE)).channel(Sensor.ACCEL)
        assert np.abs(unaware.values - RAW).max() > 0.1

    def test_a_slow_temperature_is_held(self) -> None:
        parameters = AP_BASE | TCAL
        steps = np.arange(0.0, 10.0, 1.0)
        row = channel(corrected(parameters, RAW, degrees=25 + np.floor(T + 1e-9)))
        out = undo(recording(row, temperature(25 + steps, steps), parameters=parameters)).channel(Sensor.ACCEL)
        assert out.values == pytest.approx(RAW, abs=1e-12)

    def test_samples_before_the_first_temperature_are_left_out(self) -> None:
        parameters = AP_BASE | TCAL
        late = temperature(np.full(10, 25.0), T[100:110])
        out = undo(recording(channel(RAW), late, parameters=parameters)).channel(Sensor.ACCEL)
        assert out.t[0] == T[100]

    def test_the_motors_share_of_a_compass(self) -> None:
        parameters = AP_BASE | {"COMPASS_MOTCT": 2}
        amps = 5 + 3 * np.sin(T)
        row = channel(corrected(AP_BASE, RAW, Sensor.MAG) + 0.1 * amps[:, None] * [3.0, -2.0, 1.0], Sensor.MAG)
        current = Channel(Sensor.CURRENT, 0, T, amps, "A", Stage.RAW, "BATTERY_STATUS")
        out = undo(recording(row, current, parameters=parameters)).channel(Sensor.MAG)
        assert out.values == pytest.approx(RAW, abs=1e-12)

    def test_the_throttle_drives_it_where_that_is_chosen(self) -> None:
        parameters = AP_BASE | {"COMPASS_MOTCT": 1}
        share = 0.5 + 0.4 * np.sin(T)
        row = channel(corrected(AP_BASE, RAW, Sensor.MAG) + 0.1 * share[:, None] * [3.0, -2.0, 1.0], Sensor.MAG)
        throttle = Channel(Sensor.THROTTLE, 0, T, share, "1", Stage.RAW, "VFR_HUD")
        other = Channel(Sensor.THROTTLE, 1, T, np.zeros(len(T)), "1", Stage.RAW, "VFR_HUD")
        out = undo(recording(row, throttle, other, parameters=parameters)).channel(Sensor.MAG)
        assert out.values == pytest.approx(RAW, abs=1e-12)

    def test_motors_leave_the_other_sensors_alone(self) -> None:
        current = Channel(Sensor.CURRENT, 0, T, np.full(len(T), 9.0), "A", Stage.RAW, "BATTERY_STATUS")
        row = channel(corrected(AP_BASE, RAW))
        out = undo(recording(row, current, parameters=AP_BASE | {"COMPASS_MOTCT": 2})).channel(Sensor.ACCEL)
        assert out.values == pytest.approx(RAW, abs=1e-12)


class TestMarks:
    def test_quantum_and_zero_bins_are_kept(self) -> None:
        zero = np.zeros((len(T), 3), dtype=bool)
        zero[:, 0] = True
        row = channel(RAW, quantum=STANDARD_GRAVITY / 1000, rounding=Rounding.TOWARD_ZERO, zero_bin=zero)
        out = undo(recording(row, parameters=AP_BASE)).channel(Sensor.ACCEL)
        assert (out.quantum, out.rounding) == (row.quantum, row.rounding)
        assert out.zero_bin is not None
        assert np.array_equal(out.zero_bin, zero)

    def test_zero_bins_turn_with_the_board(self) -> None:
        zero = np.zeros((len(T), 3), dtype=bool)
        zero[:, 0] = True  # under roll 90, pitch 90 the body is the board's (y, -z, -x)
        out = undo(recording(channel(RAW, zero_bin=zero), parameters=AP_BASE | {"AHRS_ORIENTATION": 28}))
        marks = out.channel(Sensor.ACCEL).zero_bin
        assert marks is not None
        assert marks[0].tolist() == [False, True, False]

    def test_raw_debiased_and_other_channels_stay(self) -> None:
        rows = channel(RAW, Sensor.MAG, Stage.RAW), channel(RAW, stage=Stage.DEBIASED), temperature(T)
        assert undo(recording(*rows, parameters=AP_BASE)).channels == rows

    def test_samples_without_a_number_stay_samples(self) -> None:
        broken = RAW.copy()
        broken[3] = np.nan
        out = undo(recording(channel(broken), parameters=AP_BASE)).channel(Sensor.ACCEL)
        assert len(out) == len(T)
        assert np.isnan(out.values[3]).all()


class TestUnknown:
    @pytest.mark.parametrize(
        ("parameters", "reason"),
        [
            ({}, "INS_ACCOFFS_X"),
            ({k: v for k, v in AP_BASE.items() if k != "AHRS_ORIENTATION"}, "AHRS_ORIENTATION"),
            (AP_BASE | TCAL, "temperature"),
            (AP_BASE | {"INS_ACCSCAL_X": 0.0}, "INS_ACCSCAL_"),
        ],
    )
    def test_a_channel_stays_as_it_is_and_the_reason_is_told(self, parameters: dict[str, float], reason: str) -> None:
        row = channel(RAW)
        out = undo(recording(row, parameters=parameters))
        assert out.channels == (row,)
        (event,) = out.events
        assert event.kind == "undo"
        assert reason in event.text

    def test_a_current_that_was_not_recorded(self) -> None:
        out = undo(recording(channel(RAW, Sensor.MAG), parameters=AP_BASE | {"COMPASS_MOTCT": 2}))
        assert out.channel(Sensor.MAG).stage == Stage.FILTERED
        assert "BATTERY_STATUS" in out.events[0].text

    def test_parameters_seen_late_hold_from_the_beginning(self) -> None:
        late = tuple(ParameterEntry(8.0, n, v) for n, v in AP_BASE.items())
        out = undo(recording(channel(corrected(AP_BASE, RAW)), parameters={}, later=late)).channel(Sensor.ACCEL)
        assert out.values == pytest.approx(RAW, abs=1e-12)

    def test_an_unknown_autopilot_is_refused(self) -> None:
        with pytest.raises(FirmwareError, match="other"):
            undo(Recording((), identity=Identity(autopilot="other")))


class TestChanges:
    CHANGE = ParameterEntry(5.0, "INS_ACCOFFS_X", 0.5)

    def test_each_side_is_undone_with_its_own_values(self) -> None:
        after = AP_BASE | {"INS_ACCOFFS_X": 0.5}
        values = np.where((T >= 5.0)[:, None], corrected(after, RAW), corrected(AP_BASE, RAW))
        out = undo(recording(channel(values), parameters=AP_BASE, later=(self.CHANGE,))).channel(Sensor.ACCEL)
        assert out.values == pytest.approx(RAW[np.isin(T, out.t)], abs=1e-12)
        gap = out.t[np.argmax(np.diff(out.t))], out.t[np.argmax(np.diff(out.t)) + 1]
        assert gap == pytest.approx((4.48, 5.10), abs=0.03)  # what lies near the change is left out

    @pytest.mark.parametrize(("apart", "kept"), [(-0.51, True), (-0.49, False), (0.09, False), (0.10, True)])
    def test_what_lies_near_a_change_is_left_out(self, apart: float, kept: bool) -> None:
        near = dataclasses.replace(channel(RAW).take(slice(1)), t=np.array([5.0 + apart]))
        out = undo(recording(near, parameters=AP_BASE, later=(self.CHANGE,)))
        assert bool(out.find(Sensor.ACCEL)) == kept
        assert not out.events

    def test_a_change_elsewhere_leaves_a_sensor_alone(self) -> None:
        out = undo(recording(channel(RAW, Sensor.GYRO), parameters=AP_BASE, later=(self.CHANGE,)))
        assert len(out.channel(Sensor.GYRO)) == len(T)

    def test_they_are_listed(self) -> None:
        same = ParameterEntry(3.0, "INS_ACCOFFS_X", 0.1)
        other = ParameterEntry(4.0, "STAT_RUNTIME", 7.0), ParameterEntry(6.0, "STAT_RUNTIME", 9.0)
        row = recording(channel(RAW), parameters=AP_BASE, later=(same, self.CHANGE, *other))
        assert calibration_changes(row) == (self.CHANGE,)

    def test_px4_ignores_a_small_change(self) -> None:
        small = ParameterEntry(3.0, "CAL_ACC0_XOFF", 0.009), ParameterEntry(6.0, "CAL_ACC0_XOFF", 0.05)
        values = RAW - np.where((T >= 6.0)[:, None], [0.05, 0, 0], 0.0)
        row = channel(values, stage=Stage.CORRECTED)
        out = undo(recording(row, parameters=PX4_BASE, identity=PX4, later=small)).channel(Sensor.ACCEL)
        assert out.values == pytest.approx(RAW[np.isin(T, out.t)], abs=1e-12)
        assert np.isin(T[(T > 2) & (T < 4)], out.t).all()  # nothing changed at 3 s

    def test_px4_keeps_what_a_decoy_brought_in(self) -> None:
        writes = ParameterEntry(2.0, "CAL_ACC0_XOFF", 0.05), ParameterEntry(4.0, "CAL_ACC0_XOFF", 0.005)
        row = channel(RAW - [0.005, 0, 0], stage=Stage.CORRECTED)
        out = undo(recording(row, parameters=PX4_BASE, identity=PX4, later=writes)).channel(Sensor.ACCEL).between(5, 9)
        assert out.values == pytest.approx(RAW[np.isin(T, out.t)], abs=1e-12)


class TestChunks:
    def test_give_what_the_whole_gives(self) -> None:
        parameters, warm = AP_BASE | TCAL, 20 + 4 * T
        slow = temperature(warm[::50], T[::50])
        whole = recording(channel(corrected(parameters, RAW, degrees=warm)), slow, parameters=parameters)
        live = Undo(ARDUPILOT, parameters)
        edges = [0.0, 0.03, 2.2, 2.22, 7.0, 10.0]
        parts = [
            live.feed(dataclasses.replace(whole.between(a, b), parameters=ParameterTimeline()))
            for a, b in itertools.pairwise(edges)
        ]
        ours, theirs = join(parts).channel(Sensor.ACCEL), undo(whole).channel(Sensor.ACCEL)
        assert np.array_equal(ours.t, theirs.t)
        assert np.array_equal(ours.values, theirs.values)

    def test_wait_for_the_temperature_they_need(self) -> None:
        live = Undo(ARDUPILOT, AP_BASE | TCAL)
        first = live.feed(Recording((channel(RAW),), identity=ARDUPILOT))
        assert not first.find(Sensor.ACCEL)
        assert not first.events
        second = live.feed(Recording((temperature(np.full(len(T), 25.0)), channel(RAW)), identity=ARDUPILOT))
        assert len(second.channel(Sensor.ACCEL)) == len(T)

    def test_without_a_sample_say_nothing(self) -> None:
        empty = Recording((channel(RAW).take(slice(0)), temperature(np.zeros(0), T[:0])), identity=ARDUPILOT)
        said = Undo(ARDUPILOT).feed(empty)
        assert said.channels == ()
        assert said.events == ()

    def test_tell_a_reason_once(self) -> None:
        live = Undo(ARDUPILOT)
        chunk = Recording((channel(RAW),), identity=ARDUPILOT)
        assert len(live.feed(chunk).events) == 1
        assert not live.feed(chunk).events

    def test_a_timeline_read_before_counts_with_its_changes(self) -> None:
        entries = ParameterTimeline.constant(PX4_BASE).entries
        history = (*entries, ParameterEntry(-9.0, "CAL_ACC0_XOFF", 0.05), ParameterEntry(-8.0, "CAL_ACC0_XOFF", 0.057))
        live = Undo(PX4, ParameterTimeline(history))
        out = live.feed(Recording((channel(RAW - [0.05, 0, 0], stage=Stage.CORRECTED),), identity=PX4))
        assert out.channel(Sensor.ACCEL).values == pytest.approx(RAW, abs=1e-12)


def piece(parameters, autopilot="ardupilot"):
    return Piece(-np.inf, {}, {}).completed(autopilot, dict(parameters))


def thermal(parameters, *, enable=1, **coefficients):
    row = {name: 0.0 for name in ardupilot_imu_names(Sensor.GYRO, 0).values() if "TCAL" in name}
    row |= {"INS_TCAL1_ENABLE": enable, "INS_TCAL1_TMIN": 10.0, "INS_TCAL1_TMAX": 60.0, "INS_GYR1_CALTEMP": 35.0}
    return parameters | row | coefficients


def test_only_what_corrects_the_sensor_makes_a_difference(ardupilot_parameters):
    plain = piece(ardupilot_parameters)
    assert plain.same("ardupilot", piece(ardupilot_parameters), KEY)
    assert plain.same("ardupilot", piece(ardupilot_parameters | {"INS_ACCOFFS_X": 1.0}), KEY)
    assert not plain.same("ardupilot", piece(ardupilot_parameters | {"INS_GYROFFS_X": 1.0}), KEY)
    assert not plain.same("ardupilot", piece(ardupilot_parameters | {"AHRS_ORIENTATION": 2}), KEY)
    accel = (Sensor.ACCEL, 0)
    assert not plain.same("ardupilot", piece(ardupilot_parameters | {"INS_ACCSCAL_Y": 1.01}), accel)


def test_curves_are_compared_by_their_range_and_every_coefficient(ardupilot_parameters):
    slope = {"INS_TCAL1_GYR1_X": 500.0}
    base = thermal(ardupilot_parameters, **slope)
    one = piece(base)
    assert one.model("ardupilot", KEY).polynomial is not None
    assert one.same("ardupilot", piece(base), KEY)
    assert not one.same("ardupilot", piece(ardupilot_parameters), KEY)
    assert not piece(ardupilot_parameters).same("ardupilot", one, KEY)
    for change in (
        {"INS_TCAL1_TMIN": 11.0},
        {"INS_TCAL1_TMAX": 61.0},
        {"INS_TCAL1_GYR1_X": 501.0},
        {"INS_TCAL1_GYR3_Z": 1.0},
    ):
        assert not one.same("ardupilot", piece(base | change), KEY)
    flat = piece(thermal(ardupilot_parameters))
    assert flat.model("ardupilot", KEY).polynomial is None  # coefficients of zero: no temperature is needed
    assert flat.same("ardupilot", piece(ardupilot_parameters), KEY)


def test_a_correction_that_is_not_known_is_like_no_other(ardupilot_parameters):
    nothing = piece({})
    with pytest.raises(FirmwareError):
        nothing.model("ardupilot", KEY)
    assert not nothing.same("ardupilot", nothing, KEY)
    assert not piece(ardupilot_parameters).same("ardupilot", nothing, KEY)


def test_px4_s_memory_ignores_a_small_change_and_what_was_first_seen_later_held_all_along(px4_parameters):
    accel = (Sensor.ACCEL, 0)
    first = piece(px4_parameters | {"CAL_ACC0_XOFF": 0.5}, "px4")
    assert set(first.memory) >= {(s, k) for s in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG) for k in range(4)}
    small = first.changed(3.0, {"CAL_ACC0_XOFF": 0.505})
    assert (small.start, small.throughout().start) == (3.0, -np.inf)
    assert first.same("px4", small, accel)
    large = small.changed(4.0, {"CAL_ACC0_XOFF": 0.52})
    assert large.model("px4", accel).offset.tolist() == [0.52, 0.0, 0.0]
    assert not first.same("px4", large, accel)
    later = large.completed("px4", {"SENS_BOARD_ROT": 2, "CAL_ACC0_XOFF": 0.9})
    assert later.memory[accel] is large.memory[accel]  # loaded once
    assert later.start == 4.0
    assert piece(px4_parameters).memory == {}


def test_a_row_that_was_never_seen_leaves_the_memory(px4_parameters):
    known = {n: v for n, v in px4_parameters.items() if not n.startswith("CAL_ACC1")}
    known["CAL_ACC1_ID"] = 0
    first = piece(known, "px4")
    assert (Sensor.ACCEL, 0) in first.memory
    moved = first.changed(1.0, {"CAL_ACC0_ID": 0, "CAL_ACC1_ID": 1310988})
    assert moved.parameters["CAL_ACC1_ID"] == 1310988
    assert (Sensor.GYRO, 0) in moved.memory


def recorded(start: float, end: float, *entries: tuple[float, str]) -> Recording:
    """A gyro at 10 Hz beside a position at 1 Hz, and parameters as they are heard."""
    t, slow = np.arange(start, end, 0.1), np.arange(start, end)
    channels = (
        Channel(Sensor.GYRO, 0, t, np.zeros((len(t), 3)), "rad/s", Stage.RAW, "HIGHRES_IMU"),
        Channel(Sensor.POSITION, 0, slow, np.ones((len(slow), 3)), "deg deg m", Stage.RAW, "GLOBAL_POSITION_INT"),
    )
    return Recording(channels, ParameterTimeline(tuple(ParameterEntry(t, name, 0.5) for t, name in entries)))


def gyro_times(recording: Recording) -> np.ndarray:
    return np.concatenate([np.zeros(0), *(c.t for c in recording.channels if c.sensor == Sensor.GYRO)])


def test_samples_count_from_the_reading_of_the_last_parameter_on() -> None:
    whole = recorded(0.0, 10.0, (2.0, X), (2.5, "SENS_BOARD_ROT"), (4.0, Y), (7.0, X))
    counted = KnownCalibration([X, Y]).feed(whole)
    assert gyro_times(counted)[0] == pytest.approx(4.0 + GUARD_AFTER_S)
    assert gyro_times(counted)[-1] == pytest.approx(9.9)
    positions = [c for c in counted.channels if c.sensor == Sensor.POSITION]
    assert [len(c) for c in positions] == [10]


@pytest.mark.parametrize("cuts", [(1.0, 3.0), (2.2, 4.05, 4.3), (8.0,)])
def test_chunks_count_the_same_samples_as_the_whole(cuts: tuple[float, ...]) -> None:
    entries = ((2.0, X), (4.0, Y))
    whole = gyro_times(KnownCalibration([X, Y]).feed(recorded(0.0, 10.0, *entries)))
    known, edges = KnownCalibration([X, Y]), (0.0, *cuts, 10.0)
    parts = []
    for start, end in itertools.pairwise(edges):
        heard = [entry for entry in entries if start <= entry[0] < end]
        parts.append(gyro_times(known.feed(recorded(start, end, *heard))))
    found = np.concatenate(parts)
    assert len(found) == pytest.approx(len(whole), abs=len(cuts))  # grids of chunks are not in step
    assert found.min() >= 4.0 + GUARD_AFTER_S


def test_nothing_counts_while_a_parameter_is_not_known() -> None:
    known = KnownCalibration([X, Y])
    assert len(gyro_times(known.feed(recorded(0.0, 5.0, (1.0, X))))) == 0
    assert len(gyro_times(known.feed(recorded(5.0, 9.0, (5.0, Y))))) > 0


def test_a_recording_whose_parameters_are_not_asked_for_counts_as_a_whole() -> None:
    whole = recorded(0.0, 5.0)
    assert gyro_times(KnownCalibration([]).feed(whole)).tolist() == gyro_times(whole).tolist()
