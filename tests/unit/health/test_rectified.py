"""A shift of the mean that comes with the vibration is the mount's, one that is always there the calibration's."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.health.finding import HealthVerdict
from mavcal.calib.health.report import health
from mavcal.calib.health.vibration import rectified
from mavcal.calib.recording import Sensor
from tests.unit.health.made import flight


def changed(recording, change, instances=(0, 1)):
    """`recording` with `change` (t, values) made of the accelerometers in flight."""
    return recording.with_channels(
        dataclasses.replace(c, values=change(c.t, c.values.copy()))
        if c.sensor == Sensor.ACCEL and c.instance in instances
        else c
        for c in recording.channels
    )


def shaken(size, shift, constant=0.0):
    """Vibration along z of `size` m/s2 (1 sd) in flight, which moves the mean by `shift`, and a constant."""

    def change(t, values):
        flying = (t > 20.0) & (t < 160.0)
        noise = np.random.default_rng(3).normal(size=len(t))
        values[:, 2] += np.where(flying, size * noise + shift, 0.0) + constant
        return values

    return change


def accelerometer(report, instance=0):
    return next(s for s in report.sensors if (s.sensor, s.instance) == (Sensor.ACCEL, instance))


@pytest.mark.parametrize("shift", [1.5, 3.5, -2.0])
def test_a_shift_that_comes_with_the_vibration_is_damped_and_not_calibrated(shift):
    report = health(changed(flight(1), shaken(9.0, shift)))
    for instance in (0, 1):
        one = accelerometer(report, instance)
        assert one.verdict == HealthVerdict.SUSPICIOUS
        assert "no calibration cures it" in one.findings[0].text
        assert not any("alibrate" in action for action in one.actions)
    assert report.action.startswith("Damp the mount")


def test_one_unit_that_rectifies_does_not_accuse_the_other():
    report = health(changed(flight(2), shaken(9.0, 3.0), instances=(1,)))
    assert accelerometer(report, 0).verdict == HealthVerdict.OK
    assert accelerometer(report, 1).verdict == HealthVerdict.SUSPICIOUS


@pytest.mark.parametrize("constant", [1.0, -1.0])
def test_an_offset_that_is_always_there_is_the_calibration(constant):
    recording = changed(flight(3), shaken(0.5, 0.0, constant))
    assert rectified(recording) == {}
    report = health(recording)
    assert accelerometer(report).verdict == HealthVerdict.FAULTY
    assert report.action.startswith("Calibrate the accelerometer")


def test_both_are_told_where_both_are_there():
    one = accelerometer(health(changed(flight(4), shaken(9.0, 3.0, 1.0))))
    texts = " / ".join(f.text for f in one.bad)
    assert "no calibration cures it" in texts
    assert "in calm seconds; gravity is" in texts
    assert one.actions[0].startswith("Damp the mount")
    assert any(action.startswith("Calibrate") for action in one.actions)


@pytest.mark.parametrize("seed", range(5))
def test_strong_vibration_without_a_shift_moves_nothing(seed):
    assert rectified(changed(flight(seed), shaken(9.0, 0.0))) == {}


def test_without_a_calm_second_the_vibration_is_named_and_nobody_accused():
    recording = changed(flight(5), shaken(9.0, 3.0)).between(30.0, 150.0)
    one = accelerometer(health(recording))
    assert one.verdict == HealthVerdict.SUSPICIOUS
    assert "it was never calm" in one.findings[0].text
    assert not any("alibrate" in action for action in one.actions)


def test_samples_at_the_end_of_the_range_shift_a_mean_and_no_calibration_cures_it():
    limit = 4.0 * 9.80665

    def change(t, values):
        flying = ((t > 20.0) & (t < 160.0))[:, None]
        noise = 25.0 * np.random.default_rng(3).normal(size=values.shape)
        return np.clip(values + np.where(flying, noise, 0.0), -limit, limit)

    one = accelerometer(health(changed(flight(15, units=1), change)))
    assert any("samples at 4 g" in finding.text for finding in one.bad)
    assert not any("alibrate" in action for action in one.actions)
