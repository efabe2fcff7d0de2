"""What a flight tells without a rest, on motions whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.health.motion import WINDOW_S, difference, rate_error, vertical_force
from mavcal.calib.recording import Sensor
from tests.examples import examples
from tests.unit.health.made import flight


def channels(recording, sensor):
    return recording.find(sensor)[0], recording.find(Sensor.ATTITUDE)[0]


@settings(max_examples=examples(15), deadline=None)
@given(offset=st.tuples(*[st.floats(-0.5, 0.5)] * 3), seed=st.integers(0, 50))
def test_the_offset_of_a_gyroscope_is_told_within_its_uncertainty(offset, seed):
    gyro, attitude = channels(flight(seed, units=1), Sensor.GYRO)
    clean = rate_error(gyro, attitude).median
    moved = rate_error(
        type(gyro)(*(gyro.sensor, 0, gyro.t, gyro.values + offset, gyro.unit, gyro.stage, "IMU")), attitude
    )
    np.testing.assert_allclose(moved.median - clean, offset, atol=2e-3)
    assert (moved.sd < 0.01).all()


def test_the_vertical_force_is_gravity_whatever_the_flight_does():
    for seed in range(5):
        accel, attitude = channels(flight(seed, units=1), Sensor.ACCEL)
        windows = vertical_force(accel, attitude)
        assert windows.median[0] == pytest.approx(9.80665, abs=0.3)
        assert windows.enough


def test_no_window_spans_a_pause_and_none_is_made_of_it():
    accel, attitude = channels(flight(1, units=1), Sensor.ACCEL)
    keep = (accel.t < 60.0) | (accel.t > 100.0)
    windows = vertical_force(accel.take(keep), attitude)
    middles = windows.t
    assert not ((middles > 60.0 + WINDOW_S / 2) & (middles < 100.0 - WINDOW_S / 2)).any()


def test_two_units_that_are_the_same_differ_by_nothing_and_too_few_samples_tell_nothing():
    accel, _ = channels(flight(1, units=1), Sensor.ACCEL)
    assert (difference(accel, accel).median == 0.0).all()
    assert not difference(accel.take(slice(0, 1)), accel).enough
    assert not difference(accel, accel.take(slice(0, 1))).enough
