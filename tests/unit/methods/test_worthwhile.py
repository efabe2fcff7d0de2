"""Which fits a log can give, at the number from which each is worthwhile."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.flight.rest import Ground, Known, Phase, Rest, TimeSpan
from mavcal.calib.methods.worthwhile import LoggedTrip, advice
from mavcal.calib.recording import Channel, Identity, ParameterTimeline, Recording, Sensor, Stage

T = np.arange(0.0, 100.0, 0.1)
FLEW = Ground((TimeSpan(0.0, 20.0),), (TimeSpan(20.0, 80.0),), Known.ARMING)
STOOD = Ground((TimeSpan(0.0, 100.0),), (), Known.ARMING)


def channel(sensor, values, unit="1", *, t=T, stage=Stage.CORRECTED):
    return Channel(sensor, 0, t, np.asarray(values, dtype=float), unit, stage, "LOG")


GYRO = channel(Sensor.GYRO, np.zeros((len(T), 3)), "rad/s")
MAG = channel(Sensor.MAG, np.ones((len(T), 3)), "uT")


def rest(start, end):
    return Rest(start, end, Phase.BEFORE, Known.ARMING)


COPTER, ROVER, SUB = 2, 10, 12
"""MAV_TYPE."""


def step(method, *channels, rests=(), ground=FLEW, parameters=None, source="", kind=COPTER):
    timeline = ParameterTimeline.constant({} if parameters is None else parameters)
    identity = Identity("ardupilot", kind)
    recording = Recording(channels, parameters=timeline, identity=identity, source=source)
    made = advice(LoggedTrip(recording, rests, ground))
    return next(s for s in made if s.method == method)


def test_worthwhile_fits_come_first_and_each_has_its_command():
    made = advice(LoggedTrip(Recording((GYRO, MAG), source="a.bin"), [rest(0.0, 20.0)], FLEW))
    assert [s.worthwhile for s in made] == sorted((s.worthwhile for s in made), reverse=True)
    assert made[0].method == "gyro-rest"
    assert {s.command for s in made} == {f"mavcal fit {s.method} a.bin" for s in made}
    assert step("gyro-rest", GYRO).command == "mavcal fit gyro-rest FILE"
    assert made[0].document == {
        "method": "gyro-rest",
        "worthwhile": True,
        "reason": "20 s at rest; most autopilots measure this bias at boot anyway",
        "command": "mavcal fit gyro-rest a.bin",
    }


@pytest.mark.parametrize(("seconds", "worth"), [(4.9, False), (5.0, True)])
def test_a_gyroscope_needs_five_seconds_of_one_rest(seconds, worth):
    rests = [rest(0.0, 3.0), rest(10.0, 10.0 + seconds)]
    assert step("gyro-rest", GYRO, rests=rests).worthwhile == worth
    debiased = channel(Sensor.GYRO, GYRO.values, "rad/s", stage=Stage.DEBIASED)
    assert step("gyro-rest", debiased, rests=rests).reason == "the log has no usable gyroscope"


@pytest.mark.parametrize(("seconds", "worth"), [(599.0, False), (600.0, True)])
def test_bias_instability_needs_ten_minutes(seconds, worth):
    assert step("allan", GYRO, rests=[rest(0.0, seconds)]).worthwhile == worth
    assert not step("allan", MAG, rests=[rest(0.0, seconds)]).worthwhile


@pytest.mark.parametrize(("span", "linear", "poly"), [(1.9, False, False), (2.1, True, False), (10.1, True, True)])
def test_a_drift_needs_degrees_at_rest(span, linear, poly):
    warm = channel(Sensor.TEMPERATURE, np.where(T < 20.0, 20.0 + span * T / 19.9, 90.0), "degC")
    assert step("thermal-linear", warm, rests=[rest(0.0, 19.9)]).worthwhile == linear
    found = step("thermal-poly", warm, rests=[rest(0.0, 19.9)])
    assert found.worthwhile == poly
    assert (f"at rest the temperature moved by {span:.1f} degC: 10 are needed" in found.reason) == (not poly)
    assert step("thermal-poly", warm).reason.startswith("no rest of 2 s with the motors off. Set LOG_DISARMED 1")
    assert step("thermal-poly", GYRO).reason == "the log has no temperature of the inertial units"


def lying(*angles):
    """An accelerometer that lies for ten seconds in each of the rolls."""
    roll = np.radians(np.asarray(angles)[(T // 10.0).astype(int).clip(max=len(angles) - 1)])
    force = -9.8 * np.column_stack([0.0 * roll, np.sin(roll), np.cos(roll)])
    return channel(Sensor.ACCEL, force, "m/s2")


@pytest.mark.parametrize(
    ("angles", "count"), [((0.0, 29.0, 20.0, 10.0), 1), ((0.0, 31.0, 62.0, 20.0), 3), ((0.0, 31.0, 62.0, 93.0), 4)]
)
def test_poses_count_from_thirty_degrees_apart_on(angles, count):
    rests = [rest(10.0 * k, 10.0 * k + 9.0) for k in range(len(angles))]
    found = step("accel-multi", lying(*angles), rests=rests)
    assert found.worthwhile == (count >= 4)
    assert f"the rests show {count} direction{'s' if count > 1 else ''} of gravity" in found.reason


def test_a_sensor_that_reads_nothing_shows_no_direction():
    dead = channel(Sensor.ACCEL, np.zeros((len(T), 3)), "m/s2")
    lost = channel(Sensor.ACCEL, np.full((len(T), 3), np.nan), "m/s2")
    for accel in (dead, lost):
        found = step("accel-multi", accel, rests=[rest(0.0, 20.0)])
        assert not found.worthwhile
        assert "0 directions" in found.reason
    without = step("accel-multi", GYRO)
    assert not without.worthwhile
    assert "no accelerometer" in without.reason


def turned(degrees, tilt=5.0):
    """An attitude that turns through so many degrees of heading at a tilt."""
    heading = np.linspace(0.0, degrees, len(T))
    angles = np.column_stack([heading, 0.0 * heading, 0.0 * heading + tilt])
    q = Rotation.from_euler("ZYX", angles, degrees=True).as_quat(scalar_first=True)
    return channel(Sensor.ATTITUDE, q)


@pytest.mark.parametrize(("degrees", "sectors", "worth"), [(200.0, 7, False), (215.0, 8, True), (700.0, 12, True)])
def test_a_compass_in_flight_needs_eight_of_twelve_headings(degrees, sectors, worth):
    found = step("mag-flight", MAG, turned(degrees))
    assert found.worthwhile == worth
    assert f"the flight saw {sectors} of 12 headings and 5 deg of tilt" in found.reason


@pytest.mark.parametrize(("tilt", "worth"), [(39.0, False), (41.0, True)])
def test_an_ellipsoid_needs_forty_degrees_of_tilt_and_the_headings(tilt, worth):
    assert step("mag-ellipsoid", MAG, turned(700.0, tilt)).worthwhile == worth
    assert not step("mag-ellipsoid", MAG, turned(90.0, tilt)).worthwhile
    assert "try it" in step("mag-ellipsoid", MAG).reason


def test_without_an_attitude_the_gyroscope_carries_the_field():
    assert step("mag-flight", MAG, GYRO).reason == "no attitude is logged: the gyroscope alone carries the field"
    assert step("mag-flight", MAG).reason == "the log has neither attitude nor gyroscope"
    few = turned(700.0).take(slice(0, 19))
    assert step("mag-flight", MAG, GYRO, few).worthwhile
    assert step("mag-flight", MAG, turned(700.0), ground=STOOD).reason == "the vehicle never flew"
    for kind, words in ((ROVER, "the vehicle never drove"), (SUB, "the vehicle never was under way")):
        assert step("mag-flight", MAG, turned(700.0), ground=STOOD, kind=kind).reason == words


@pytest.mark.parametrize("method", ["mag-flight", "mag-motor", "mag-ellipsoid"])
def test_without_a_compass_none_of_its_fits_is_worthwhile(method):
    found = step(method, GYRO, turned(700.0))
    assert not found.worthwhile
    assert "no compass" in found.reason


@pytest.mark.parametrize(
    ("sensor", "unit", "reach", "worth"),
    [
        (Sensor.CURRENT, "A", 2.9, False),
        (Sensor.CURRENT, "A", 3.1, True),
        (Sensor.THROTTLE, "1", 0.19, False),
        (Sensor.THROTTLE, "1", 0.21, True),
        (Sensor.MOTOR, "1", 0.21, True),
    ],
)
def test_motors_need_a_load_that_moves(sensor, unit, reach, worth):
    load = channel(sensor, 0.4 + reach * (T / T[-1]), unit)
    found = step("mag-motor", MAG, load)
    assert found.worthwhile == worth
    if worth:
        assert found.reason.startswith(f"{sensor.value} moved by {reach:.2g}")
    assert step("mag-motor", MAG, load, ground=STOOD).reason == "the motors never ran"


def test_a_load_with_holes_tells_nothing_and_a_corrupt_compensation_comes_first():
    values = np.linspace(0.0, 20.0, len(T))
    values[3] = np.nan
    assert not step("mag-motor", MAG, channel(Sensor.CURRENT, values, "A")).worthwhile
    corrupt = step("mag-motor", MAG, ground=STOOD, parameters={"COMPASS_MOT2_Y": np.inf, "COMPASS_OFS_X": np.nan})
    assert corrupt.worthwhile
    assert corrupt.reason.startswith("COMPASS_MOT2_Y in force is not a number")
