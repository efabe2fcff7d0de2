"""An attitude that is not supported condemns no good sensor: made flights whose attitude is wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.health.finding import BAD, HealthVerdict, judged_value
from mavcal.calib.health.limits import FORCE
from mavcal.calib.health.report import health
from mavcal.calib.health.support import support_of
from mavcal.calib.recording import Sensor
from tests.unit.health.made import flight

START, END = 25.0, 155.0
"""s: in the air from the first sample to the last one."""


def airborne(seed=1, **kw):
    return flight(seed, **kw).between(START, END)


def replaced(recording, *channels):
    new = {(c.sensor, c.instance): c for c in channels}
    return recording.with_channels(new.get((c.sensor, c.instance), c) for c in recording.channels)


def attitude(recording):
    return recording.channel(Sensor.ATTITUDE, 0)


def turned_by(recording, rates):
    """The attitude that an estimator has which believes in that rate, rad/s, on top of the true one."""
    q = attitude(recording)
    wrong = Rotation.from_rotvec(np.outer(q.t - q.t[0], rates))
    values = (Rotation.from_quat(q.values, scalar_first=True) * wrong).as_quat(scalar_first=True)
    return dataclasses.replace(q, values=values)


def with_offset(recording, instance, rates):
    gyro = recording.channel(Sensor.GYRO, instance)
    return dataclasses.replace(gyro, values=gyro.values + rates)


def with_constant_compasses(recording):
    """Every compass delivers one value, and the estimator's heading stays with it."""
    dead = [
        dataclasses.replace(c, values=np.tile([20.0, 3.0, 41.0], (len(c), 1)))
        for c in recording.channels
        if c.sensor == Sensor.MAG
    ]
    q = attitude(recording)
    angles = Rotation.from_quat(q.values, scalar_first=True).as_euler("ZYX")
    angles[:, 0] = 0.0
    held = dataclasses.replace(q, values=Rotation.from_euler("ZYX", angles).as_quat(scalar_first=True))
    gyros = [with_offset(recording, i, 0.0) for i in recording.instances(Sensor.GYRO)]
    spun = []
    for gyro in gyros:  # it really turns by 8 deg/s all the time
        down = Rotation.from_euler("ZYX", angles).as_matrix()[:, 2, :]
        at = np.column_stack([np.interp(gyro.t, q.t, column) for column in down.T])
        spun.append(dataclasses.replace(gyro, values=gyro.values + np.radians(8.0) * at))
    return replaced(recording, *dead, held, *spun)


def verdicts(recording):
    return {(s.sensor, s.instance): s.verdict for s in health(recording).sensors}


def offset_of(recording, instance=0):
    (found,) = [
        f
        for s in health(recording).sensors
        for f in s.findings
        if (f.check, f.sensor, f.instance) == ("offset", Sensor.GYRO, instance)
    ]
    return found


def test_a_good_flight_supports_its_attitude():
    recording = airborne()
    found = support_of(recording, attitude(recording))
    assert (found.tilt, found.heading) == ("", "")
    assert not any(v in BAD for v in verdicts(recording).values())


@pytest.mark.parametrize("units", [1, 2])
def test_gyroscopes_are_not_condemned_by_a_heading_that_a_dead_compass_holds(units):
    recording = with_constant_compasses(airborne(units=units))
    assert "reads the same throughout" in support_of(recording, attitude(recording)).heading
    found = verdicts(recording)
    assert all(found[Sensor.GYRO, i] not in BAD for i in range(units))
    assert found[Sensor.MAG, 0] == HealthVerdict.FAULTY
    one = offset_of(recording)
    assert one.verdict == HealthVerdict.CANNOT_SAY
    assert "ten seconds at rest would decide" in one.text
    assert (found[Sensor.GYRO, 0] == HealthVerdict.OK) == (units == 2)  # two that agree are two witnesses


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("offset", [(-9.9, -8.9, -2.0), (0.0, 11.0, 0.0), (14.0, 0.0, 5.0)])
def test_an_accelerometer_is_not_condemned_by_an_attitude_that_a_gyroscope_tumbles(seed, offset):
    recording = airborne(seed, units=1)
    rates = np.radians(offset)
    recording = replaced(recording, with_offset(recording, 0, rates), turned_by(recording, rates))
    assert "deg away from up" in support_of(recording, attitude(recording)).tilt
    found = verdicts(recording)
    assert found[Sensor.ACCEL, 0] not in BAD
    assert found[Sensor.GYRO, 0] == HealthVerdict.FAULTY
    assert found[Sensor.MAG, 0] not in BAD
    assert "while the direction of the force stood still" in offset_of(recording).text


def test_a_gyroscope_is_still_found_beside_an_attitude_that_others_support():
    recording = airborne()
    recording = replaced(recording, with_offset(recording, 1, np.radians([0.0, 8.0, 0.0])))
    found = verdicts(recording)
    assert (found[Sensor.GYRO, 0], found[Sensor.GYRO, 1]) == (HealthVerdict.OK, HealthVerdict.FAULTY)


def test_gyroscopes_that_agree_against_an_attitude_are_named_with_it():
    recording = airborne()
    off = [with_offset(recording, i, np.radians([0.0, 0.0, 8.0])) for i in (0, 1)]
    one = offset_of(replaced(recording, *off))
    assert one.verdict == HealthVerdict.SUSPICIOUS
    assert "either all are off, or the attitude is. Ten seconds at rest decide" in one.text


def test_a_gyroscope_that_is_off_alone_about_the_vertical_is_faulty_where_a_compass_supports_the_heading():
    recording = airborne(units=1)
    recording = replaced(recording, with_offset(recording, 0, np.radians([0.0, 0.0, 8.0])))
    assert verdicts(recording)[Sensor.GYRO, 0] == HealthVerdict.FAULTY


def test_an_accelerometer_that_lies_across_is_found_beside_one_that_supports_the_attitude():
    recording = airborne()
    accel = recording.channel(Sensor.ACCEL, 1)
    recording = replaced(recording, dataclasses.replace(accel, values=accel.values[:, [2, 1, 0]]))
    found = verdicts(recording)
    assert (found[Sensor.ACCEL, 0], found[Sensor.ACCEL, 1]) == (HealthVerdict.OK, HealthVerdict.FAULTY)


@pytest.mark.parametrize(("value", "sd"), [(0.33, 3.03), (2.97, 3.36), (0.0, 1.0)])
def test_an_error_that_swallows_the_number_says_nothing(value, sd):
    assert judged_value(value, sd, FORCE) == HealthVerdict.CANNOT_SAY


@pytest.mark.parametrize("tilted", [17.0, 23.0])
def test_an_attitude_that_leans_away_from_a_force_as_long_as_gravity_judges_nobody(tilted):
    recording = airborne(11)
    q = attitude(recording)
    leaning = Rotation.from_euler("y", tilted, degrees=True) * Rotation.from_quat(q.values, scalar_first=True)
    wrong = replaced(recording, dataclasses.replace(q, values=leaning.as_quat(scalar_first=True)))
    assert "deg away from up" in support_of(wrong, attitude(wrong)).tilt
    assert not any(s.verdict in BAD for s in health(wrong).sensors if s.sensor == Sensor.ACCEL)


def test_an_accelerometer_far_off_across_gravity_does_not_condemn_the_attitude():
    recording = airborne(12, units=1)
    accel = recording.channel(Sensor.ACCEL, 0)
    off = replaced(recording, dataclasses.replace(accel, values=accel.values + np.array([3.0, 0.0, 0.0])))
    assert support_of(off, attitude(off)).tilt == ""  # its force is longer than gravity
