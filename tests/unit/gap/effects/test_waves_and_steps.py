"""Signals of steps, tones and late temperatures, sample by sample."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.gap.effects.events import RAMP_S, likeliest_steps, ramp_signal, step_moments, step_signal
from mavcal.calib.gap.effects.lattice import dead_band, quantisation, saturation
from mavcal.calib.gap.effects.limits import clipped_column, dead_column
from mavcal.calib.gap.effects.magnetic import (
    GRADIENT,
    earth_columns,
    gradient_columns,
    lagged_current_signal,
    soft_iron_columns,
    throttle_signal,
)
from mavcal.calib.gap.effects.noise import filter_power_gain, flicker_density, walk_density, white_density
from mavcal.calib.gap.effects.temperature import (
    best_reference_temperature,
    lagged_temperature,
    lags,
    reference_temperatures,
    temperature_powers,
)
from mavcal.calib.gap.effects.timing import cutoffs, delays, drifts, rms_slope, shifted_ideal, stretched_ideal
from mavcal.calib.gap.effects.tone import tone_frequencies, tone_signals
from mavcal.calib.gap.likelihood import frequencies, random_walk
from mavcal.calib.recording import Sensor
from tests.examples import examples

from .conftest import make


@settings(max_examples=examples(20), deadline=None)
@given(moment=st.floats(0.5, 9.0))
def test_a_step_rises_within_the_sample_before_its_moment(moment):
    trace = make(Sensor.GYRO, seconds=10.0, fs=50.0)
    signal = step_signal(trace, moment)[0]
    assert signal[trace.t <= moment - 0.02].max() < 1e-9
    assert signal[trace.t >= moment].min() > 1.0 - 1e-9
    between = (trace.t > moment - 0.02) & (trace.t < moment)
    np.testing.assert_allclose(signal[between], 1.0 - 50.0 * (moment - trace.t[between]), atol=1e-9)


def test_a_slow_step_takes_a_second_and_a_half_about_its_moment():
    trace = make(Sensor.GYRO, seconds=10.0, fs=100.0)
    signal = ramp_signal(trace, 5.0)[0]
    assert signal[trace.t <= 5.0 - 0.5 * RAMP_S].max() < 1e-9
    assert signal[trace.t >= 5.0 + 0.5 * RAMP_S].min() > 1.0 - 1e-9
    assert signal[np.isclose(trace.t, 5.0)] == pytest.approx(0.5)
    inside = np.abs(trace.t - 5.0) < 0.5 * RAMP_S - 0.02
    np.testing.assert_allclose(np.diff(signal[inside]), 0.01 / RAMP_S, atol=1e-9)


def test_a_step_at_the_very_ends_is_not_tried():
    trace = make(Sensor.GYRO, seconds=10.0, fs=50.0)
    tried = step_moments(trace)
    assert (tried[0], tried[-1]) == (pytest.approx(trace.t[5]), pytest.approx(trace.t[-6]))
    short = make(Sensor.GYRO, seconds=0.1, fs=50.0)
    np.testing.assert_array_equal(step_moments(short), short.t)


def test_of_a_pulse_both_edges_are_tried():
    trace = make(Sensor.MAG, seconds=40.0, fs=25.0)
    noise = np.random.default_rng(1).normal(scale=0.1, size=trace.ideal.shape)
    pulse = np.where((trace.t > 12.0) & (trace.t < 15.0), 1.0, 0.0)[:, None] * [0.0, 1.0, 0.0]
    found = likeliest_steps(trace, noise + pulse)
    assert np.abs(found - 12.0).min() < 0.1
    assert np.abs(found - 15.0).min() < 0.1
    assert (np.diff(found) > 0.0).all()
    assert len(likeliest_steps(trace, np.zeros_like(noise))) == 1


@pytest.mark.parametrize("cutoff", [None, 10.0])
def test_a_tone_is_a_cosine_and_a_sine_behind_the_filter(cutoff):
    trace = dataclasses.replace(make(Sensor.ACCEL, seconds=10.0), low_pass_hz=cutoff)
    cosine, sine = tone_signals(trace, 10.0)
    size = 1.0 if cutoff is None else 1.0 / np.sqrt(2.0)
    late_by = 0.0 if cutoff is None else np.pi / 2.0  # a two-pole Butterworth filter is a quarter late at its cut-off
    phase = 2.0 * np.pi * 10.0 * (trace.t - trace.t[0]) - late_by
    np.testing.assert_allclose(cosine, size * np.cos(phase), atol=1e-9)
    np.testing.assert_allclose(sine, size * np.sin(phase), atol=1e-9)


def test_frequencies_are_tried_from_five_periods_to_half_the_rate():
    trace = make(Sensor.ACCEL, seconds=10.0)
    tried = tone_frequencies(trace)
    assert tried[0] == pytest.approx(0.5)
    assert tried[-1] == pytest.approx(50.0 - 0.1)
    np.testing.assert_allclose(np.diff(tried), 0.1)


def test_noise_is_stated_by_its_allan_coefficients():
    """White of density one is fs a sample; a walk is that of unit steps over fs; flicker is in between."""
    trace = make(Sensor.GYRO, seconds=5.0)
    omega = frequencies(500)
    np.testing.assert_allclose(white_density(trace, omega, np.nan), trace.fs)
    np.testing.assert_allclose(walk_density(trace, omega, np.nan)[0], random_walk(omega) / trace.fs)
    geometric = np.sqrt(white_density(trace, omega, np.nan) * walk_density(trace, omega, np.nan))
    np.testing.assert_allclose(flicker_density(trace, omega, np.nan), geometric)
    filtered = dataclasses.replace(trace, low_pass_hz=10.0)
    at_cutoff = np.array([2.0 * np.pi * 10.0 / trace.fs])
    assert filter_power_gain(filtered, at_cutoff)[0] == pytest.approx(0.5)
    np.testing.assert_allclose(
        white_density(filtered, omega, np.nan), white_density(trace, omega, np.nan) * filter_power_gain(filtered, omega)
    )


@settings(max_examples=examples(20), deadline=None)
@given(samples=st.floats(-8.0, 8.0))
def test_a_slow_wave_is_moved_by_any_part_of_a_sample(samples):
    trace = make(Sensor.GYRO, seconds=10.0)
    t = trace.t
    moved = dataclasses.replace(trace, ideal=np.column_stack([np.sin(3.0 * t), np.cos(5.0 * t), 0.5 * t]))
    middle = slice(50, -50)
    at = t - samples / trace.fs
    expected = np.column_stack([np.sin(3.0 * at), np.cos(5.0 * at), 0.5 * at])
    np.testing.assert_allclose(shifted_ideal(moved, samples)[middle], expected[middle], atol=1e-6)


def test_a_clock_that_runs_slow_is_late_in_proportion_to_the_time_gone():
    trace = make(Sensor.GYRO, seconds=20.0)
    t = trace.t
    moved = dataclasses.replace(trace, ideal=np.column_stack([np.sin(3.0 * t), np.cos(2.0 * t), t]))
    at = t * (1.0 - 2e-3)
    expected = np.column_stack([np.sin(3.0 * at), np.cos(2.0 * at), at])
    np.testing.assert_allclose(stretched_ideal(moved, 2e-3)[20:-20], expected[20:-20], atol=1e-6)
    np.testing.assert_allclose(stretched_ideal(moved, 0.0), moved.ideal, atol=1e-9)


def test_delays_and_drifts_are_tried_either_way_and_cutoffs_beyond_the_rate():
    trace = make(Sensor.GYRO, seconds=50.0)
    for tried in (delays(trace), drifts(trace)):
        np.testing.assert_allclose(tried, -tried[::-1])
        assert (np.diff(tried) > 0.0).all()
    assert delays(trace)[-1] == pytest.approx(0.5)
    assert delays(trace)[len(delays(trace)) // 2] == pytest.approx(0.125 / trace.fs)
    assert drifts(trace)[-1] == pytest.approx(5000.0)
    assert drifts(trace)[3] == pytest.approx(1e6 * 1e-3 / float(trace.t[-1]), rel=1e-6)
    assert cutoffs(trace)[[0, -1]] == pytest.approx([0.5, 800.0])


def test_the_slope_is_that_of_the_liveliest_axis_where_two_samples_follow_each_other():
    trace = make(Sensor.GYRO, seconds=10.0)
    steep = dataclasses.replace(trace, ideal=np.column_stack([trace.t, -3.0 * trace.t, 0.0 * trace.t]))
    assert rms_slope(steep) == pytest.approx(3.0)
    every_second = dataclasses.replace(steep, observed=np.arange(len(trace.t)) % 2 == 0)
    assert rms_slope(every_second) == 0.0


@settings(max_examples=examples(20), deadline=None)
@given(t_ref=st.floats(20.0, 40.0), slopes=st.tuples(*[st.floats(0.5, 2.0)] * 3))
def test_the_temperature_at_which_slopes_vanish_is_found(t_ref, slopes):
    warm = 30.0 + 8.0 * np.sin(np.arange(400) * 0.03)
    residual = (warm - t_ref)[:, None] * np.array(slopes)
    assert best_reference_temperature(warm, residual, np.ones(400, dtype=bool)) == pytest.approx(t_ref, abs=1e-6)


def test_a_temperature_that_vanishes_nowhere_near_is_held_at_the_range_that_is_tried():
    warm = 30.0 + 8.0 * np.sin(np.arange(400) * 0.03)
    seen = np.ones(400, dtype=bool)
    far = best_reference_temperature(warm, 1e-3 * (warm - 30.0)[:, None] + 5.0 * np.ones((400, 3)), seen)
    assert far == pytest.approx(warm.min() - 20.0)
    assert best_reference_temperature(np.full(400, 25.0), np.ones((400, 3)), seen) == 25.0


def test_references_reach_twenty_degrees_beyond_what_was_seen_and_lags_a_third_of_the_recording():
    trace = make(Sensor.GYRO, seconds=70.0)
    tried = reference_temperatures(trace)
    assert tried[[0, -1]] == pytest.approx([trace.temperature.min() - 20.0, trace.temperature.max() + 20.0])
    assert lags(trace)[-1] <= 70.0 / 3.0 < 60.0
    assert len(lags(make(Sensor.GYRO, seconds=3.0))) == 1


def test_powers_of_the_temperature_are_about_the_reference():
    trace = make(Sensor.GYRO, seconds=5.0)
    d = trace.temperature - 22.0
    np.testing.assert_allclose(temperature_powers(trace, 22.0), [d, d**2, d**3])


def test_a_late_temperature_is_that_of_a_pole():
    trace = make(Sensor.GYRO, seconds=60.0)
    step = dataclasses.replace(trace, temperature=np.where(trace.t < 10.0, 20.0, 40.0))
    signal = lagged_temperature(step, 5.0)[0]
    after_one = signal[np.searchsorted(trace.t, 15.0)] - signal[0]
    assert after_one / (signal[-1] - signal[0]) == pytest.approx(1.0 - np.exp(-1.0), abs=0.01)


def test_an_end_of_the_range_takes_what_lies_beyond_and_a_dead_band_what_lies_within():
    trace = make(Sensor.ACCEL, seconds=1.0)
    ideal = np.array([[3.0, -3.0, 0.5], [1.0, -0.2, 0.0]])
    small = dataclasses.replace(trace, ideal=ideal)
    np.testing.assert_allclose(clipped_column(small, 2.0)[0], [[-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(dead_column(small, 0.6)[0], [[0.0, 0.0, -0.5], [0.0, 0.2, 0.0]])
    blurred = dataclasses.replace(small, unit_sd=0.06)
    np.testing.assert_allclose(dead_column(blurred, 0.6)[0], [[0.0, 0.0, -0.5], [0.0, 0.0, 0.0]])


@settings(max_examples=examples(20), deadline=None)
@given(entries=st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6))
def test_soft_iron_is_a_symmetric_matrix(entries):
    trace = make(Sensor.MAG, seconds=1.0)
    xx, yy, zz, xy, xz, yz = entries
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    made = np.einsum("j,jni->ni", np.array(entries), soft_iron_columns(trace, np.nan))
    np.testing.assert_allclose(made, trace.ideal @ matrix.T, atol=1e-9)


def test_a_field_of_the_place_is_what_the_body_sees_of_it():
    trace = make(Sensor.MAG, seconds=5.0)
    field = np.array([20.0, 1.5, 45.0])
    np.testing.assert_allclose(np.einsum("j,jni->ni", field, earth_columns(trace, np.nan)), trace.field, atol=1e-9)


def test_gradients_have_no_source_and_no_curl_and_vanish_in_the_middle_of_the_path():
    for g in GRADIENT:
        assert np.trace(g) == 0.0
        np.testing.assert_array_equal(g, g.T)
    trace = make(Sensor.MAG, seconds=5.0)
    columns = gradient_columns(trace, np.nan)
    path = trace.place - trace.place.mean(axis=0)
    back = np.einsum("jni,nki->jnk", columns, np.linalg.inv(_body_from_ned(trace)))
    np.testing.assert_allclose(back, [path @ g.T for g in GRADIENT], atol=1e-9)


def _body_from_ned(trace):
    return earth_columns(trace, np.nan).transpose(1, 2, 0)


def test_a_current_is_taken_before_and_a_throttle_to_a_power():
    trace = make(Sensor.MAG, seconds=10.0)
    ramp = dataclasses.replace(trace, current=2.0 * trace.t, throttle=trace.t / 10.0 - 0.1)
    np.testing.assert_allclose(lagged_current_signal(ramp, 0.2)[0, 100:], 2.0 * (trace.t[100:] - 0.2))
    raised = throttle_signal(ramp, 1.5)[0]
    assert raised[0] == 0.0
    np.testing.assert_allclose(raised[200:], (trace.t[200:] / 10.0 - 0.1) ** 1.5)


def test_a_few_samples_at_an_end_or_at_zero_prove_nothing():
    """Four are too few of either, and five of them are looked at."""
    trace = make(Sensor.ACCEL, seconds=10.0)
    values = trace.ideal + np.random.default_rng(1).normal(scale=0.02, size=trace.ideal.shape)
    top = np.argsort(values[:, 0])[-4:]
    piled = values.copy()
    piled[top, 0] = values[top, 0].max()
    assert saturation(dataclasses.replace(trace, measured=piled)) is None
    near = np.argsort(np.abs(values[:, 0]))[:4]
    zeroed = values.copy()
    zeroed[near, 0] = 0.0
    assert dead_band(dataclasses.replace(trace, measured=zeroed)) is None
    assert quantisation(dataclasses.replace(trace, measured=values)) is None
