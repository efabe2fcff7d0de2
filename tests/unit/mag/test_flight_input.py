"""What a fit from a flight takes of its channels: each reason to refuse from both sides, axes, clocks, the crash."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.mag.flight_input import between, end_of_flight, prepared, unusable
from mavcal.calib.mag.flight_path import Turning
from mavcal.calib.mag.motor_drives import Drive, DriveKind
from mavcal.calib.mag.result import MagContext
from mavcal.calib.recording import Channel, Sensor, Stage
from mavcal.calib.triad import TriadModel

TURN = Rotation.from_euler("ZYX", [90.0, 0.0, 180.0], degrees=True).as_matrix()  # body from sensor


def channel(sensor, t, values, unit):
    return Channel(sensor, 0, np.asarray(t, dtype=float), np.asarray(values, dtype=float), unit, Stage.RAW, "made")


def compass(seconds=30.0, rate=10.0, start=0.0):
    t = start + np.arange(int(seconds * rate)) / rate
    field = 40.0 * np.column_stack([np.sin(t), np.cos(t), 0.5 + 0.1 * np.sin(3.0 * t)])
    return channel(Sensor.MAG, t, field, "uT")


def gyroscope(seconds=30.0, speed=1.0, axis=2):
    t = np.arange(int(seconds * 50.0)) / 50.0
    rates = np.outer(speed * np.sin(t), np.eye(3)[axis])
    return channel(Sensor.GYRO, t, rates, "rad/s")


def attitude(yaw_deg=90.0, tilt_deg=0.0, seconds=30.0):
    t = np.arange(int(seconds * 10.0)) / 10.0
    way = np.linspace(0.0, 1.0, len(t))
    turned = Rotation.from_euler("ZYX", np.column_stack([yaw_deg * way, tilt_deg * way, 0.0 * way]), degrees=True)
    return channel(Sensor.ATTITUDE, t, turned.as_quat()[:, [3, 0, 1, 2]], "1")


def ready(mag=None, turning=None, *, in_force=None, drive=None, **facts):
    turning = Turning(gyroscope(), None) if turning is None else turning
    return prepared(compass() if mag is None else mag, turning, in_force, drive, 0.0, MagContext(**facts))


def test_samples_outside_of_the_motion_are_left_out():
    data = ready(compass(50.0, start=-10.0), Turning(gyroscope(20.0), None))
    assert (data.mag.t[0], data.mag.t[-1]) == (0.0, pytest.approx(19.9))
    assert len(data.samples.t) == len(data.mag)


def test_rows_that_are_no_measurement_are_left_out():
    mag = compass()
    values = mag.values.copy()
    values[3, 1], values[7, 2], values[11, 0] = np.nan, 1e9, -0.999e9
    data = ready(dataclasses.replace(mag, values=values))
    assert set(mag.t) - set(data.mag.t) == {mag.t[3], mag.t[7]}


def test_repeated_times_of_the_motion_count_once():
    gyro = gyroscope()
    twice = gyro.take(np.sort(np.r_[0 : len(gyro), 5, 9]))
    assert ready(turning=Turning(twice, None)).turning.gyro.t.tolist() == gyro.t.tolist()


def test_attitudes_that_are_no_rotation_are_left_out():
    said = attitude()
    values = said.values.copy()
    values[4] *= 1.02
    values[5] *= 1.005
    values[6] = 0.0
    data = ready(turning=Turning(None, dataclasses.replace(said, values=values)))
    assert len(data.turning.attitude) == len(said) - 2


def test_one_sample_of_motion_is_none():
    data = ready(turning=Turning(gyroscope().take(slice(0, 1)), attitude().take(slice(0, 1))))
    assert data.turning.gyro is None
    assert data.turning.attitude is None
    assert unusable(data).startswith("nothing says how the vehicle turned")


def test_many_samples_are_thinned_evenly():
    t = np.arange(36_500) / 1000.0
    mag = channel(Sensor.MAG, t, np.column_stack([np.sin(t), np.cos(t), t]), "uT")
    data = ready(mag, Turning(gyroscope(40.0), None))
    assert len(data.mag) == 12_167  # every third
    assert np.diff(data.mag.t) == pytest.approx(np.full(12_166, 0.003))


def test_samples_and_offset_are_in_the_axes_of_the_body():
    mag = compass()
    offset = np.array([3.0, -5.0, 8.0])
    data = ready(mag, in_force=TriadModel(offset, np.eye(3)), body_from_sensor=TURN)
    assert data.samples.y == pytest.approx(mag.values @ TURN.T)
    assert data.offset_in_force == pytest.approx(TURN @ offset)
    np.testing.assert_allclose(data.sensor_from_body @ TURN, np.eye(3), atol=1e-12)


def test_the_sensitivity_in_force_is_the_inverse_of_its_correction():
    soft = np.array([[1.1, 0.02, 0.0], [0.02, 0.9, 0.01], [0.0, 0.01, 1.05]])
    assert ready(in_force=TriadModel(np.zeros(3), soft)).samples.matrix == pytest.approx(np.linalg.inv(soft))
    assert ready().samples.matrix == pytest.approx(np.eye(3))


def test_samples_at_which_the_drive_is_not_known_are_left_out():
    t = np.concatenate([np.arange(0.0, 10.0, 0.1), np.arange(20.0, 30.0, 0.1)])
    amperes = channel(Sensor.CURRENT, t, (10.0 + np.sin(t))[:, None], "A")
    data = ready(drive=Drive.of(DriveKind.CURRENT, amperes))
    assert not ((data.mag.t > 10.0) & (data.mag.t < 19.9)).any()
    assert data.samples.drives.shape == (len(data.mag), 2)
    assert np.isfinite(data.samples.drives).all()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"mag": dataclasses.replace(compass(), values=np.zeros((300, 2)))}, "the mag needs 3 columns, not 2"),
        (
            {"turning": Turning(None, dataclasses.replace(attitude(), values=np.zeros((300, 3))))},
            "the attitude needs 4 columns, not 3",
        ),
        (
            {"turning": Turning(dataclasses.replace(gyroscope(), unit="counts"), None)},
            "the gyroscope must be in rad/s, not in counts: state --unit-gyro",
        ),
        (
            {"turning": Turning(None, dataclasses.replace(attitude(), t=np.full(300, np.inf)))},
            "the time of the attitude goes back or is not finite: sort the samples",
        ),
    ],
)
def test_channels_of_other_shapes_are_errors(wrong, said):
    with pytest.raises(InvalidInputError, match=said):
        ready(**wrong)


@pytest.mark.parametrize(("n", "rate", "enough"), [(49, 4.0, False), (50, 4.0, True), (90, 10.0, False)])
def test_fifty_samples_over_ten_seconds_are_the_least(n, rate, enough):
    said = unusable(ready(compass(60.0, rate).take(slice(0, n)), Turning(gyroscope(60.0), None)))
    assert (said == "") is enough
    if not enough:
        assert said.startswith(f"{n} samples of the compass over {(n - 1) / rate:.1f} s beside the motion")


def test_an_axis_that_stands_is_told():
    mag = compass()
    said = unusable(ready(dataclasses.replace(mag, values=mag.values * [1.0, 1.0, 0.0])))
    assert "compass" in said
    assert "constant value" in said


@pytest.mark.parametrize(("speed", "told"), [(34.0, False), (36.0, True)])
def test_half_of_the_time_faster_than_a_vehicle_is_another_unit(speed, told):
    gyro = gyroscope()
    steady = dataclasses.replace(gyro, values=np.tile([0.0, 0.0, speed], (len(gyro), 1)) + gyro.values)
    said = unusable(ready(turning=Turning(steady, None)))
    assert ("gyroscope" in said and " 36.1 rad/s" in said) is told
    assert told or said == ""


@pytest.mark.parametrize(
    ("yaw", "tilt", "enough"), [(4.9, 0.0, False), (5.1, 0.0, True), (0.0, 4.9, False), (0.0, 5.1, True)]
)
def test_five_degrees_about_any_axis_are_the_least(yaw, tilt, enough):
    data = ready(turning=Turning(None, attitude(yaw, tilt)))
    assert (data.yaw_range_deg, data.tilt_range_deg) == pytest.approx((yaw, tilt), abs=1e-6)
    assert (unusable(data) == "") is enough


def test_whole_circles_count_in_full():
    assert ready(turning=Turning(None, attitude(1000.0))).yaw_range_deg == pytest.approx(1000.0)


@pytest.mark.parametrize(("axis", "yaw", "tilt"), [(0, 0.0, 1.0), (1, 0.0, 1.0), (2, 1.0, 0.0)])
def test_without_an_attitude_the_gyroscope_says_how_far_it_turned(axis, yaw, tilt):
    """The rate ``0.5 sin t`` swings by one radian."""
    data = ready(turning=Turning(gyroscope(10.0 * np.pi, speed=0.5, axis=axis), None))
    assert data.yaw_range_deg == pytest.approx(np.degrees(yaw), abs=1.0)
    assert data.tilt_range_deg == pytest.approx(np.degrees(tilt), abs=1.0)


def crash(shock=90.0, tipped_at=49.5, tip_deg=170.0):
    t = np.arange(0.0, 60.0, 0.1)
    force = np.tile([0.0, 0.0, -9.8], (len(t), 1))
    force[500] = [0.0, 0.0, -shock]
    half = np.radians(tip_deg / 2.0)
    pose = np.where((t > tipped_at)[:, None], [np.cos(half), np.sin(half), 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
    return channel(Sensor.ACCEL, t, force, "m/s2"), channel(Sensor.ATTITUDE, t, pose, "1")


@pytest.mark.parametrize(
    ("changes", "end"),
    [
        ({}, 47.6),  # two seconds before it tipped
        ({"tipped_at": 51.0}, 48.0),  # two seconds before the shock, which came first
        ({"tipped_at": 52.5}, 60.0),  # tipped long after: it was carried
        ({"shock": 59.0}, 60.0),
        ({"shock": 61.0}, 47.6),
        ({"tip_deg": 74.0}, 60.0),
        ({"tip_deg": 76.0}, 47.6),
    ],
)
def test_a_flight_ends_two_seconds_before_a_shock_that_tips_it_over(changes, end):
    assert end_of_flight(60.0, *crash(**changes)) == pytest.approx(end, abs=1e-6)


def test_without_an_accelerometer_or_an_attitude_a_flight_ends_with_its_recording():
    accel, pose = crash()
    assert end_of_flight(60.0, None, pose) == 60.0
    assert end_of_flight(60.0, accel, None) == 60.0
    assert end_of_flight(60.0, accel.take(slice(0, 0)), pose) == 60.0


def test_what_lies_before_an_end_is_kept():
    assert between(None, 5.0) is None
    assert between(compass(), 5.0).t[-1] == pytest.approx(4.9)


def test_a_drive_keeps_the_outputs_that_move():
    t = np.arange(100.0)
    values = 0.5 + np.outer(np.sin(t), [0.4, 0.0, 0.004, 0.3])
    motors = Drive.of(DriveKind.MOTORS, channel(Sensor.MOTOR, t, values, "1"))
    assert motors.numbers == (1, 4)  # the third moves by less than a fiftieth of the largest
    assert motors.values.shape == (100, 2)
    throttle = Drive.of(DriveKind.THROTTLE, channel(Sensor.THROTTLE, t, values, "1"))
    assert throttle.numbers == (0,)
    assert throttle.values == pytest.approx(values[:, :1])


def test_a_drive_needs_three_finite_samples_in_order():
    t = np.array([0.0, 1.0, 1.0, 2.0, 3.0])
    values = np.array([[1.0], [2.0], [9.0], [np.nan], [4.0]])
    drive = Drive.of(DriveKind.CURRENT, channel(Sensor.CURRENT, t, values, "A"))
    assert drive.t.tolist() == [0.0, 1.0, 3.0]
    assert drive.values[:, 0].tolist() == [1.0, 2.0, 4.0]
    assert Drive.of(DriveKind.CURRENT, channel(Sensor.CURRENT, t[:4], values[:4], "A")) is None


def test_a_drive_is_known_for_three_seconds_beyond_its_ends():
    t = np.arange(10.0, 30.0, 0.5)
    drive = Drive.of(DriveKind.CURRENT, channel(Sensor.CURRENT, t, t[:, None], "A"))
    known = np.isfinite(drive.columns(np.array([6.9, 7.1, 20.0, 32.4, 32.6]))).all(axis=1)
    assert known.tolist() == [False, True, True, True, False]


def test_the_range_of_a_drive_is_that_of_its_slow_part():
    t = np.arange(0.0, 200.0, 0.1)
    fast = 20.0 * np.sin(2.0 * np.pi * t)  # a period of half the smoothing
    drive = Drive.of(
        DriveKind.CURRENT, channel(Sensor.CURRENT, t, (np.where(t < 100.0, 5.0, 8.0) + fast)[:, None], "A")
    )
    assert drive.range == pytest.approx([3.0], abs=0.1)
