"""Increments of an inertial unit between nodes, by motions with a closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.gap.reference.signals import Signal
from mavcal.calib.gap.reference.strapdown import STEPS, WARMTH_UNIT, Increments
from tests.examples import examples

T = np.arange(0.0, 10.001, 0.01)
NODES = np.arange(0.0, 9.01, 0.5)
NONE = np.zeros((len(NODES) - 1, 3))
triples = st.tuples(*[st.floats(-2.0, 2.0)] * 3).map(np.array)


def signal(values, t=T):
    return Signal(t, np.broadcast_to(np.asarray(values, dtype=float), (len(t), 3)).copy())


@settings(max_examples=examples(20), deadline=None)
@given(rate=triples, force=triples)
def test_a_steady_rate_and_force_are_turned_as_a_rigid_body_turns(rate, force):
    """Velocity in the axes of the start is the integral of exp(w s) f over half a second, by a fine sum."""
    between = Increments.of(signal(rate), signal(force), NODES).integrated(NONE, NONE)
    np.testing.assert_allclose(between.turn.as_rotvec(), np.tile(0.5 * rate, (len(NONE), 1)), atol=1e-9)
    s = (np.arange(2000) + 0.5) * 0.5 / 2000
    exact = Rotation.from_rotvec(s[:, None] * rate).apply(force).sum(axis=0) * 0.5 / 2000
    np.testing.assert_allclose(between.velocity, np.tile(exact, (len(NONE), 1)), atol=3e-3)


def test_rates_at_the_steps_are_those_of_the_signal():
    rate = np.array([0.1, -0.2, 0.3])
    between = Increments.of(signal(rate), signal(0.0), NODES).integrated(NONE, NONE)
    assert between.rate.shape == (len(NONE), STEPS, 3)
    np.testing.assert_allclose(between.rate, np.broadcast_to(rate, between.rate.shape), atol=1e-9)
    assert len(between.within) == STEPS
    np.testing.assert_allclose(between.within[0].magnitude(), 0.0, atol=1e-12)
    half = between.within[STEPS // 2].as_rotvec()
    np.testing.assert_allclose(half, np.tile(0.25 * rate, (len(NONE), 1)), atol=1e-9)


@settings(max_examples=10, deadline=None)
@given(offset=triples, push=triples)
def test_biases_of_an_interval_are_taken_off(offset, push):
    increments = Increments.of(signal(offset), signal(push), NODES)
    clean = increments.integrated(NONE + offset, NONE + push)
    np.testing.assert_allclose(clean.turn.magnitude(), 0.0, atol=1e-9)
    np.testing.assert_allclose(clean.velocity, 0.0, atol=1e-9)


def test_a_matrix_of_the_gyroscope_and_a_turn_of_the_accelerometer_are_undone():
    rate, force = np.array([0.2, -0.1, 0.4]), np.array([1.0, 2.0, -9.8])
    matrix = np.eye(3) + np.array([[0.1, 0.02, 0.0], [0.0, -0.1, 0.03], [0.05, 0.0, 0.2]])
    turn = Rotation.from_rotvec([0.1, -0.2, 0.3])
    wrong = Increments.of(signal(matrix @ rate), signal(turn.apply(force)), NODES)
    right = Increments.of(signal(rate), signal(force), NODES).integrated(NONE, NONE)
    found = wrong.integrated(NONE, NONE, matrix, turn)
    np.testing.assert_allclose((found.turn.inv() * right.turn).magnitude(), 0.0, atol=1e-9)
    np.testing.assert_allclose(found.velocity, right.velocity, atol=1e-9)


def test_a_rate_that_changes_is_integrated_exactly_along_straight_lines():
    ramp = 0.3 * T[:, None] * np.array([1.0, 0.0, -2.0])
    increments = Increments.of(Signal(T, ramp), signal(0.0), NODES)
    exact = 0.15 * (NODES[1:] ** 2 - NODES[:-1] ** 2)
    np.testing.assert_allclose(increments.angle.sum(axis=1), exact[:, None] * [1.0, 0.0, -2.0], atol=1e-9)


def test_nodes_beyond_the_samples_hold_the_last_reading_and_are_not_known():
    short = T[T < 5.0]
    increments = Increments.of(signal([1.0, 0.0, 0.0], short), signal(0.0, short), NODES)
    np.testing.assert_allclose(increments.angle.sum(axis=1)[:, 0], 0.5, atol=1e-9)
    np.testing.assert_array_equal(increments.known, NODES[1:] < short[-1] + 0.005)


def test_an_interval_in_a_hole_of_either_sensor_is_not_known():
    holed = T[(T < 3.1) | (T > 3.9)]
    for gyro, accel in ((holed, T), (T, holed)):
        known = Increments.of(signal(0.1, gyro), signal(0.0, accel), NODES).known
        np.testing.assert_array_equal(np.flatnonzero(~known), [6, 7])


def test_sampling_costs_nothing_where_nothing_changes_and_more_the_faster_it_does():
    still = Increments.of(signal(0.3), signal(1.0), NODES)
    np.testing.assert_allclose(still.sampling, 0.0, atol=1e-12)
    errors = []
    for hz in (3.3, 11.7, 23.3):
        wave = np.sin(2.0 * np.pi * hz * T)[:, None] * [1.0, 0.5, 0.2]
        errors.append(Increments.of(Signal(T, wave), Signal(T, 3.0 * wave), NODES).sampling)
    assert (errors[0][0] < errors[1][0]).all()
    assert (errors[1][0] < errors[2][0]).all()
    np.testing.assert_allclose(errors[0][0] / errors[0][0, 0], [1.0, 0.5, 0.2], rtol=1e-6)  # each axis has its own
    np.testing.assert_allclose([e[1] / e[0] for e in errors], 3.0, rtol=1e-6)


def test_slow_samples_last_over_several_intervals_and_count_so_much_more():
    """Samples every 2 s between nodes every 0.5 s: an error lasts four intervals, twice in standard deviation."""
    slow, nodes = np.arange(0.0, 100.0, 2.0), np.arange(0.0, 90.0, 0.5)
    wave = np.random.default_rng(1).normal(size=(len(slow), 3))
    made = Increments.of(Signal(slow, wave), Signal(slow, wave), nodes)
    assert (made.sampling[0] > 0.0).all()
    coarse = Increments.of(Signal(slow[::2], wave[::2]), Signal(slow[::2], wave[::2]), nodes).angle.sum(axis=1)
    change = np.sqrt(np.mean((made.angle.sum(axis=1) - coarse)[made.known] ** 2, axis=0))
    assert made.sampling[0] == pytest.approx(2.0 * change, rel=1e-6)


@pytest.mark.parametrize(("span", "counted"), [(2.9, False), (3.1, True)])
def test_a_temperature_counts_from_three_kelvin_on(span, counted):
    warm = np.linspace(20.0, 20.0 + span, len(NODES))
    made = Increments.of(signal(0.0), signal(0.0), NODES, warm).warmth
    assert made.any() == counted
    if counted:
        assert made.mean() == pytest.approx(0.0, abs=1e-12)
        np.testing.assert_allclose(np.diff(made), span / (len(NODES) - 1) / WARMTH_UNIT)
    assert not Increments.of(signal(0.0), signal(0.0), NODES).warmth.any()
