"""What the families of the catalogue share: columns of signals, turns, the pole of what comes late, movement."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from mavcal.calib.gap.effects.parts import (
    AXES,
    axiswise,
    body_from_ned,
    crossed,
    first_missing,
    lagged,
    missing_movement,
    on_each_axis,
    per_axis,
    spread,
)
from mavcal.calib.recording import Sensor
from tests.examples import examples

from .conftest import make

angles = st.tuples(*[st.floats(-3.0, 3.0)] * 3)


def test_a_ramp_through_one_pole_is_exact_however_long_a_sample_is():
    dt, tau = 1.0, 1.5
    t = dt * np.arange(12)
    expected = 2.0 * (t - tau * (1.0 - np.exp(-t / tau))) + 7.0
    np.testing.assert_allclose(lagged(2.0 * t + 7.0, dt, tau), expected, atol=1e-12)


@settings(max_examples=examples(15), deadline=None)
@given(tau=st.floats(0.05, 20.0), dt=st.floats(0.01, 2.0), seed=st.integers(0, 99))
def test_a_pole_follows_straight_lines_as_an_integrated_equation_does(tau, dt, seed):
    x = np.random.default_rng(seed).normal(size=6)
    t = dt * np.arange(6)
    made = lagged(x, dt, tau)
    y = x[0]
    for k in range(5):
        slope = (x[k + 1] - x[k]) / dt
        exact = solve_ivp(
            lambda s, v, k=k, slope=slope: (x[k] + slope * s - v) / tau, (0.0, dt), [y], rtol=1e-9, atol=1e-12
        )
        y = exact.y[0, -1]
        assert made[k + 1] == pytest.approx(y, abs=1e-6)
    assert len(t) == len(made)


def test_a_constant_stays_and_a_pole_works_on_columns():
    np.testing.assert_allclose(lagged(np.full((10, 2), 3.0), 0.1, 5.0), 3.0)
    both = np.column_stack([np.arange(10.0), -np.arange(10.0)])
    made = lagged(both, 0.1, 0.5)
    np.testing.assert_allclose(made[:, 0], -made[:, 1])
    np.testing.assert_allclose(made[:, 0], lagged(both[:, 0], 0.1, 0.5))


def test_columns_of_signals_lie_on_one_axis_each_in_the_order_of_their_names():
    signals = np.arange(8.0).reshape(2, 4)
    columns = on_each_axis(signals)
    assert columns.shape == (6, 4, 3)
    for j in range(6):
        signal, axis = divmod(j, 3)
        np.testing.assert_array_equal(columns[j, :, axis], signals[signal])
        assert not np.delete(columns[j], axis, axis=1).any()
    made = axiswise(lambda trace, theta: theta * np.ones((1, len(trace.t))))(make(Sensor.GYRO, seconds=1.0), 2.0)
    np.testing.assert_allclose(made.sum(axis=0), 2.0)
    assert [p.name for p in per_axis("bias", "m/s2")] == [f"bias.{axis}" for axis in AXES]


@settings(max_examples=examples(25), deadline=None)
@given(turn=angles, vector=angles)
def test_a_cross_product_is_the_first_order_of_a_turn(turn, vector):
    small = 1e-6 * np.array(turn)
    exact = Rotation.from_rotvec(small).apply(vector) - vector
    made = np.einsum("j,jni->ni", small, crossed(np.array([vector])))
    np.testing.assert_allclose(made[0], exact, atol=1e-10)


@settings(max_examples=examples(25), deadline=None)
@given(euler=angles, size=st.floats(0.1, 10.0))
def test_quaternions_take_north_east_down_to_the_body_whatever_their_length(euler, size):
    turned = Rotation.from_euler("ZYX", euler)
    made = body_from_ned(size * turned.as_quat(scalar_first=True)[None])
    np.testing.assert_allclose(made[0], turned.inv().as_matrix(), atol=1e-12)


def test_the_spread_is_that_of_the_liveliest_column_where_observed():
    values = np.column_stack([np.arange(10.0), np.zeros(10)])
    values[3] = 1e9
    seen = np.arange(10) != 3
    assert spread(values, seen) == pytest.approx(np.delete(np.arange(10.0), 3).std())
    assert spread(values, np.zeros(10, dtype=bool)) == 0.0


@pytest.mark.parametrize(("sensor", "least"), [(Sensor.ACCEL, 0.3), (Sensor.GYRO, 0.02), (Sensor.MAG, 2.0)])
def test_a_reading_moves_from_three_hundredths_of_its_use_on(sensor, least):
    trace = make(sensor, seconds=10.0)
    for factor, lacks in ((0.98, True), (1.02, False)):
        wave = np.zeros_like(trace.ideal)
        wave[::2, 1] = 2.0 * factor * least
        missing = missing_movement(sensor)(dataclasses.replace(trace, ideal=wave))
        assert (missing is not None) == lacks
    assert missing_movement(sensor)(dataclasses.replace(trace, ideal=np.zeros_like(trace.ideal)))[0].endswith(
        f"varies by 0 {trace.unit}"
    )


def test_a_reference_that_does_not_follow_turns_says_nothing_of_a_gyroscope_alone():
    for sensor in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG):
        slow = dataclasses.replace(make(sensor, seconds=30.0), rate_known=False)
        assert (missing_movement(sensor)(slow) is not None) == (sensor is Sensor.GYRO)


def test_the_first_condition_that_is_not_met_is_told():
    trace = make(Sensor.GYRO, seconds=1.0)
    met, first, second = (lambda found: lambda _: found)(None), lambda _: ("a", "b"), lambda _: ("c", "d")
    assert first_missing([met, first, second])(trace) == ("a", "b")
    assert first_missing([met, met])(trace) is None
    assert first_missing(iter([second]))(trace) == first_missing([second])(trace) == ("c", "d")
