"""Signals between their samples, and the uniform grid that jittering stamps lie on."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap.reference.signals import LONGEST_HOLE_S, Signal, grid_of, interpolated, low_passed, slow_values
from mavcal.calib.recording import Channel, Sensor, Stage
from tests.examples import examples

T = np.arange(0.0, 10.0, 0.1)


def channel(t, values=None, sensor=Sensor.GYRO):
    t = np.asarray(t, dtype=float)
    made = np.column_stack([np.sin(t), np.cos(t), t]) if values is None else np.asarray(values, dtype=float)
    return Channel(sensor, 0, t, made, "rad/s", Stage.RAW, "IMU")


def cubic(t):
    return np.column_stack([1.0 + t - 0.3 * t**2 + 0.02 * t**3, 2.0 - t**2])


@settings(max_examples=examples(25), deadline=None)
@given(wanted=st.lists(st.floats(0.0, 9.9), min_size=1, max_size=20))
def test_a_cubic_is_exact_between_its_samples(wanted):
    t = np.array(sorted(wanted))
    np.testing.assert_allclose(Signal(T, cubic(T)).at(t), cubic(t), atol=1e-9)


def test_values_are_held_at_the_ends_and_exact_at_the_samples():
    signal = Signal(T, cubic(T))
    np.testing.assert_allclose(signal.at(np.array([-5.0, 0.0, 9.9, 50.0])), cubic(np.array([0.0, 0.0, 9.9, 9.9])))
    assert signal.at(T.copy()) is signal.values


def test_across_a_hole_a_signal_is_straight():
    kept = (T < 3.0) | (T > 5.0)
    signal = Signal(T[kept], np.sin(3.0 * T[kept])[:, None])
    first, last = T[kept][T[kept] < 4.0][-1], T[kept][T[kept] > 4.0][0]
    middle = 0.5 * (first + last)
    expected = 0.5 * (np.sin(3.0 * first) + np.sin(3.0 * last))
    assert signal.at(np.array([middle]))[0, 0] == pytest.approx(expected)
    np.testing.assert_array_equal(signal.known(np.array([2.0, middle, 6.0])), [True, False, True])
    np.testing.assert_array_equal(signal.known(np.array([first, last])), [True, True])


@pytest.mark.parametrize(("steps", "known"), [(3, True), (4, False)])
def test_three_and_a_half_steps_are_a_hole(steps, known):
    t = np.concatenate([np.arange(20) * 0.1, 1.9 + 0.1 * steps + np.arange(20) * 0.1])
    assert Signal(t, t[:, None]).known(np.array([1.9 + 0.05 * steps]))[0] == known


def test_half_a_step_beyond_the_ends_is_still_known():
    signal = Signal(T, cubic(T))
    np.testing.assert_array_equal(signal.known(np.array([-0.06, -0.04, 9.94, 9.96])), [False, True, True, False])


def test_a_signal_of_a_channel_leaves_out_what_is_not_finite_and_stamps_that_stand_still():
    t = np.array([0.0, 0.1, 0.1, 0.2, 0.3, 0.4, 0.5])
    values = np.column_stack([t, t, t])
    values[4, 1] = np.nan
    made = Signal.of(channel(t, values))
    np.testing.assert_array_equal(made.t, [0.0, 0.1, 0.2, 0.4, 0.5])
    assert Signal.of(channel(t[:5], values[:5])) is None
    assert Signal.of(channel([])) is None


def test_a_later_signal_reads_the_same_later_and_its_change_is_the_slope():
    signal = Signal(T, cubic(T))
    np.testing.assert_allclose(signal.shifted(0.35).at(T[10:20] + 0.35), cubic(T[10:20]), atol=1e-9)
    line = Signal(T, np.column_stack([3.0 * T, -T]))
    np.testing.assert_allclose(line.rate_of_change().values, np.tile([3.0, -1.0], (len(T), 1)), atol=1e-9)


def test_what_changes_slowly_is_taken_of_the_first_channel_that_has_two_samples():
    none = channel([0.0, 1.0], np.full((2, 1), np.nan), Sensor.TEMPERATURE)
    warm = channel([0.0, 1.0], [[20.0], [30.0]], Sensor.TEMPERATURE)
    other = channel([0.0, 1.0], [[50.0], [50.0]], Sensor.TEMPERATURE)
    wanted = np.array([-1.0, 0.5, 2.0])
    np.testing.assert_allclose(slow_values([none, warm, other], wanted)[:, 0], [20.0, 25.0, 30.0])
    assert slow_values([none], wanted) is None
    assert slow_values([], wanted) is None
    np.testing.assert_allclose(interpolated(T, cubic(T), T[:5]), cubic(T[:5]))


@settings(max_examples=examples(25), deadline=None)
@given(
    step=st.floats(0.002, 0.5),
    start=st.floats(-100.0, 100.0),
    share=st.floats(0.0, 0.2),
    seed=st.integers(0, 1000),
    lost=st.sets(st.integers(1, 58), max_size=10),
)
@example(step=0.5, start=0.0, share=0.1953125, seed=466, lost={1, 2, 3, 4, 8, 15, 34, 39, 47})
def test_stamps_that_jitter_and_samples_that_are_lost_lie_on_the_grid_they_came_from(step, start, share, seed, lost):
    rng = np.random.default_rng(seed)
    number = np.array([k for k in range(60) if k not in lost])
    stamps = start + step * (number + share * rng.uniform(-1.0, 1.0, len(number)))
    grid = grid_of(channel(stamps))
    np.testing.assert_array_equal(grid.point, number)
    np.testing.assert_array_equal(grid.sample, np.arange(len(number)))
    assert np.median(np.diff(grid.t)) == pytest.approx(step, rel=0.02)
    assert (grid.repeated, grid.cut) == (0, False)
    np.testing.assert_array_equal(np.flatnonzero(grid.observed), number)


def test_stamps_of_whole_milliseconds_are_kept_apart():
    """400 Hz in whole milliseconds: steps of 2 and 3 ms."""
    stamps = np.round(np.arange(800) / 400.0, 3)
    grid = grid_of(channel(stamps))
    assert len(grid.point) == 800
    assert grid.observed.all()
    assert np.diff(grid.t)[0] == pytest.approx(1.0 / 400.0, rel=1e-3)


def test_samples_of_one_stamp_count_once_and_are_counted():
    stamps = np.repeat(np.arange(50) * 0.1, 2)
    grid = grid_of(channel(stamps))
    assert (len(grid.t), grid.repeated) == (50, 50)
    np.testing.assert_array_equal(grid.sample, np.arange(0, 100, 2))


def test_of_a_recording_with_a_long_hole_the_longest_part_is_taken():
    early, late = np.arange(30) * 0.1, 2.9 + LONGEST_HOLE_S + 0.5 + np.arange(50) * 0.1
    grid = grid_of(channel(np.concatenate([early, late])))
    assert grid.cut
    assert grid.stamps[0] == late[0]
    assert len(grid.t) == 50
    near = 2.9 + LONGEST_HOLE_S - 0.5 + np.arange(50) * 0.1
    whole = grid_of(channel(np.concatenate([early, near])))
    assert not whole.cut
    assert whole.observed.sum() == 80


def test_samples_that_are_not_finite_are_holes_of_the_grid():
    values = np.ones((40, 3))
    values[7, 2] = np.nan
    grid = grid_of(channel(np.arange(40) * 0.1, values))
    assert not grid.observed[7]
    assert grid.observed.sum() == 39


@pytest.mark.parametrize("stamps", [[], [0.0, 0.1, 0.2], [0.0, 0.1, 0.1, 0.2]])
def test_fewer_than_four_times_are_no_time_series(stamps):
    with pytest.raises(InvalidInputError, match="samples are no time series"):
        grid_of(channel(stamps))


def test_derivatives_of_a_signal_that_is_not_smoothed_are_those_of_its_spline():
    made = low_passed(Signal(T, np.sin(T)[:, None]))
    assert made.cutoff_hz is None
    assert not made.noise.any()
    middle = slice(5, -5)
    np.testing.assert_allclose(made.first[middle, 0], np.cos(made.t[middle]), atol=1e-4)
    np.testing.assert_allclose(made.second[middle, 0], -np.sin(made.t[middle]), atol=2e-3)


def test_a_line_goes_through_the_filter_as_it_is_and_what_is_left_out_is_its_noise():
    rng = np.random.default_rng(1)
    t = np.arange(4000) / 100.0
    line = np.column_stack([2.0 * t - 5.0, -t])
    straight = low_passed(Signal(t, line), 5.0)
    np.testing.assert_allclose(straight.values, line, atol=1e-9)
    np.testing.assert_allclose(straight.first, np.tile([2.0, -1.0], (len(t), 1)), atol=1e-6)
    noisy = low_passed(Signal(t, line + rng.normal(scale=[0.1, 0.2], size=line.shape)), 5.0)
    np.testing.assert_allclose(noisy.noise, np.array([0.1, 0.2]) * np.sqrt(1.0 - 5.0 / 50.0), rtol=0.05)
