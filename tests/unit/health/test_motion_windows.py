"""Means over windows in flight, by closed forms: steady turns, ramps, pauses, edges of what is covered."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.health.motion import (
    LEAST_WINDOWS,
    WINDOW_S,
    WindowMeans,
    difference,
    rate_error,
    usable,
    vertical_force,
)
from mavcal.calib.recording import Channel, Sensor, Stage
from tests.examples import examples

G = 9.80665


def series(t, values, sensor=Sensor.ACCEL, unit="m/s2"):
    return Channel(sensor, 0, np.asarray(t, dtype=float), np.asarray(values, dtype=float), unit, Stage.CORRECTED, "IMU")


def attitude(t, turned):
    return series(t, turned.as_quat(scalar_first=True), Sensor.ATTITUDE, "1")


def test_a_median_and_its_error_are_those_of_the_windows():
    values = np.array([[1.0], [2.0], [3.0], [4.0], [100.0]])
    made = WindowMeans(np.arange(5.0), values)
    assert made.median[0] == 3.0
    assert made.sd[0] == pytest.approx(1.2533 * 1.4826 * 1.0 / math.sqrt(5.0))


def test_the_error_of_a_median_is_right_for_normal_windows():
    """The standard error of a median of normal values is 1.2533 sigma over the root of their number."""
    rng = np.random.default_rng(3)
    made = [WindowMeans(np.arange(101.0), rng.normal(size=(101, 1))) for _ in range(400)]
    told = np.mean([m.sd[0] for m in made])
    assert told == pytest.approx(np.std([m.median[0] for m in made]), rel=0.1)


@pytest.mark.parametrize("windows", [0, 1, 2, 3, 4])
def test_three_windows_are_enough(windows):
    made = WindowMeans(np.arange(float(windows)), np.zeros((windows, 1)))
    assert made.enough == (windows >= 3)
    assert LEAST_WINDOWS == 3


def test_usable_samples_are_finite_and_their_time_goes_on():
    t = np.array([0.0, 1.0, 1.0, 2.0, 3.0])
    values = np.arange(15.0).reshape(5, 3)
    values[3, 1] = np.nan
    kept = usable(series(t, values))
    np.testing.assert_array_equal(kept.t, [0.0, 1.0, 3.0])
    np.testing.assert_array_equal(kept.values, values[[0, 1, 4]])
    clean = series([0.0, 1.0], np.zeros((2, 3)))
    assert usable(clean) is clean


@settings(max_examples=examples(20), deadline=None)
@given(angles=st.tuples(st.floats(-3.0, 3.0), st.floats(-1.5, 1.5), st.floats(-3.0, 3.0)), extra=st.floats(-2.0, 2.0))
def test_the_vertical_force_is_gravity_and_what_lifts_in_every_attitude(angles, extra):
    t = np.arange(0.0, 45.0, 0.1)
    turned = Rotation.from_euler("ZYX", angles)
    force = turned.inv().apply([0.0, 0.0, -G - extra])
    windows = vertical_force(
        series(t, np.tile(force, (len(t), 1))), attitude(t, Rotation.concatenate([turned] * len(t)))
    )
    np.testing.assert_allclose(windows.values, G + extra, atol=1e-9)
    assert windows.enough


def test_a_force_across_gravity_is_no_vertical_force():
    t = np.arange(0.0, 45.0, 0.1)
    level = attitude(t, Rotation.identity(len(t)))
    windows = vertical_force(series(t, np.tile([3.0, -4.0, -G], (len(t), 1))), level)
    np.testing.assert_allclose(windows.values, G, atol=1e-9)


@settings(max_examples=examples(15), deadline=None)
@given(
    rate=st.tuples(*[st.floats(-0.5, 0.5)] * 3),
    offset=st.tuples(*[st.floats(-0.3, 0.3)] * 3),
    begin=st.floats(-1000.0, 1000.0),
)
def test_a_steady_turn_leaves_the_offset_of_the_gyroscope(rate, offset, begin):
    t = begin + np.arange(0.0, 45.0, 0.05)
    turned = Rotation.from_rotvec((t - begin)[:, None] * np.array(rate))
    gyro = series(t, np.tile(np.array(rate) + offset, (len(t), 1)), Sensor.GYRO, "rad/s")
    made = rate_error(gyro, attitude(t[::4], turned[::4]))
    np.testing.assert_allclose(made.values, np.tile(offset, (len(made.t), 1)), atol=1e-6)
    assert len(made.t) == 4


def test_a_rate_that_rises_is_integrated_by_trapezoids_without_a_lag():
    """The turn of a rate that grows by 0.02 rad/s2 is 0.01 t^2; a rectangle rule would be off by 0.001 rad/s."""
    t = np.arange(0.0, 45.0, 0.1)
    turned = Rotation.from_rotvec(0.01 * t[:, None] ** 2 * np.array([0.0, 0.0, 1.0]))
    gyro = series(t, 0.02 * t[:, None] * np.array([0.0, 0.0, 1.0]), Sensor.GYRO, "rad/s")
    np.testing.assert_allclose(rate_error(gyro, attitude(t, turned)).values, 0.0, atol=1e-9)


def test_two_units_differ_by_first_minus_second_where_both_were_sampled():
    t = np.arange(0.0, 60.0, 0.1)
    ramp = np.column_stack([0.5 * t, np.zeros_like(t), -t])
    first = series(t, ramp + np.array([1.0, 2.0, 3.0]))
    between = series(t[:-1] + 0.03, ramp[:-1] + 0.03 * np.array([0.5, 0.0, -1.0]))
    made = difference(first, between)
    np.testing.assert_allclose(made.values, np.tile([1.0, 2.0, 3.0], (len(made.t), 1)), atol=1e-9)
    np.testing.assert_allclose(difference(between, first).values, -np.tile([1.0, 2.0, 3.0], (6, 1)), atol=1e-9)


def test_a_window_is_used_from_eight_of_its_ten_seconds_on():
    t = np.arange(0.0, 30.0, 0.1)
    flat = series(t, np.ones((len(t), 3)))
    for missing, left in ((1.8, 3), (2.4, 2)):
        kept = flat.take((t < 11.0) | (t > 11.0 + missing))
        assert len(difference(kept, kept).t) == left, missing


def test_windows_are_timed_by_their_middle():
    t = 500.0 + np.arange(0.0, 40.05, 0.1)
    made = difference(series(t, np.ones((len(t), 3))), series(t, np.zeros((len(t), 3))))
    np.testing.assert_allclose(made.t, 500.0 + WINDOW_S * np.array([0.5, 1.5, 2.5, 3.5]))


def test_a_sample_counts_for_the_time_since_the_one_before():
    """Half the window at 10 Hz, half at 20 Hz: the mean of 0 and 1 is one half, not two thirds."""
    t = np.concatenate([np.arange(0.0, 5.0, 0.1), np.arange(5.0, 10.0, 0.05)])
    t = np.concatenate([t, t + 10.0, t + 20.0])
    values = np.tile(((t % 10.0) >= 4.99)[:, None].astype(float), 3)
    made = difference(series(t, values), series(t, np.zeros_like(values)))
    np.testing.assert_allclose(made.values, 0.5, atol=0.01)


def test_samples_in_a_gap_of_the_attitude_tell_nothing():
    """A step of half a second is still interpolated; a longer one is not."""
    t = np.arange(0.0, 40.0, 0.1)
    accel = series(t, np.tile([0.0, 0.0, -G], (len(t), 1)))
    for step, windows in ((0.5, 4), (0.75, 0)):
        sparse = np.arange(0.0, 40.5, step)
        assert len(vertical_force(accel, attitude(sparse, Rotation.identity(len(sparse)))).t) == windows, step
        gyro = dataclasses.replace(accel, sensor=Sensor.GYRO, values=np.zeros((len(t), 3)), unit="rad/s")
        assert (len(rate_error(gyro, attitude(sparse, Rotation.identity(len(sparse)))).t) > 0) == (windows > 0), step
        assert (len(difference(accel, series(sparse, np.zeros((len(sparse), 3)))).t) > 0) == (windows > 0), step


def test_nothing_is_extrapolated_beyond_the_other_channel():
    t = np.arange(0.0, 60.0, 0.1)
    whole = series(t, np.tile([0.0, 0.0, -G], (len(t), 1)))
    part = (t >= 20.0) & (t <= 40.0)
    level = attitude(t, Rotation.identity(len(t)))
    for made in (
        vertical_force(whole, level.take(part)),
        difference(whole, whole.take(part)),
        rate_error(dataclasses.replace(whole, sensor=Sensor.GYRO).take(part), level),
    ):
        assert len(made.t) == 2
        assert (made.t > 20.0).all()
        assert (made.t < 40.0).all()


@pytest.mark.parametrize("rows", [0, 1])
def test_fewer_than_two_samples_tell_nothing(rows):
    t = np.arange(0.0, 40.0, 0.1)
    whole, level = series(t, np.ones((len(t), 3))), attitude(t, Rotation.identity(len(t)))
    few = slice(0, rows)
    assert vertical_force(whole.take(few), level).values.shape == (0, 1)
    assert vertical_force(whole, level.take(few)).values.shape == (0, 1)
    assert rate_error(whole.take(few), level).values.shape == (0, 3)
    assert rate_error(whole, level.take(few)).values.shape == (0, 3)
    assert difference(whole, whole.take(few)).values.shape == (0, 3)
