"""Two units under one time stamp: what moves between their own moments is no noise of theirs."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.reference.expected_noise import (
    age_noise_of,
    age_of,
    with_age_noise,
    with_aged_noise,
    with_sway_noise,
    without_aged_samples,
)
from mavcal.calib.gap.reference.noise import learned_spectrum, spectrum_at
from mavcal.calib.recording import Sensor

AGE, NOISE, FS = 1e-3, 1e-3, 25.0


def pair(seed=0, swing=6.0, age=AGE, noise=NOISE, gap=0.0):
    """A gyroscope against another one that is older or younger by `age` (s, sd); it turns in the middle only."""
    rng = np.random.default_rng(seed)
    t = np.arange(2000) / FS
    quiet = np.where((t > 30.0) & (t < 40.0), 1.0, 0.02)[:, None]
    phase = 2.0 * np.pi * np.array([0.4, 0.5, 0.6]) * t[:, None]
    rate, slope = swing * quiet * np.sin(phase), swing * quiet * np.cos(phase) * 2.0 * np.pi * np.array([0.4, 0.5, 0.6])
    measured = rate + slope * age * rng.standard_normal((len(t), 1)) + noise * rng.standard_normal(rate.shape)
    seen = np.ones(len(t), dtype=bool)
    return Trace(Sensor.GYRO, (1,), t, measured + gap * rate, rate, seen, against=0)


def test_the_age_of_the_samples_is_learned():
    assert np.sqrt(age_of([pair()])) == pytest.approx(AGE, rel=0.15)
    assert age_of([pair(s, age=0.0) for s in range(20)]) == 0.0
    assert age_of([]) == 0.0


def test_samples_whose_moment_matters_more_than_the_noise_are_left_out():
    found = without_aged_samples(pair(), AGE**2)
    assert found.observed[:700].all()
    assert found.observed[750:1000].mean() < 0.3
    left = (pair().residual[found.observed] ** 2).mean()
    assert left < 1.5 * NOISE**2


def test_a_sensor_that_became_noisy_does_not_hide_itself():
    noisy = pair(noise=0.05)
    assert without_aged_samples(noisy, AGE**2).observed.mean() > 0.99


def test_a_flight_that_moves_more_is_expected_to_be_louder():
    nominal = dataclasses.replace(pair(swing=0.2), sigma=np.full(3, NOISE))
    lively = dataclasses.replace(pair(swing=1.0), sigma=np.full(3, NOISE))
    made = with_age_noise(lively, AGE**2, [nominal])
    slope = (np.diff(lively.ideal, axis=0) * FS) ** 2
    assert made.psd[0] == pytest.approx(NOISE**2 + AGE**2 * slope.mean(axis=0), rel=0.3)
    assert made.sigma == pytest.approx(np.sqrt(made.psd[0]))
    same = with_age_noise(nominal, AGE**2, [lively])
    assert same.sigma == pytest.approx(nominal.sigma)


def shaken(size, seed=0, own=0.0):
    """Two units whose samples are a millisecond apart, in a vehicle that shakes fast; `own`: noise of the first."""
    rng = np.random.default_rng(seed)
    t = np.arange(4000) / 40.0
    shake = size * np.sin(2.0 * np.pi * 13.0 * t + np.cumsum(0.5 * rng.standard_normal(len(t))))[:, None] * np.ones(3)
    slow = 5.0 * np.sin(2.0 * np.pi * 0.2 * t)[:, None] * np.ones(3)
    late = 0.08 * size * rng.standard_normal((len(t), 3))
    measured = slow + shake + late + (NOISE + own) * rng.standard_normal((len(t), 3))
    seen = np.ones(len(t), dtype=bool)
    return Trace(Sensor.ACCEL, (1,), t, measured, slow + shake, seen, against=0, sigma=np.full(3, NOISE))


def test_two_units_differ_more_in_gusts_and_noise_of_one_of_them_is_no_gust():
    calm = shaken(0.01)
    gusty = with_sway_noise(shaken(0.3, 1), [calm])
    assert gusty.psd is not None
    felt = gusty.residual.std(axis=0)
    assert np.sqrt(gusty.psd.mean(axis=0)) == pytest.approx(felt, rel=0.1)
    noisy = shaken(0.01, 2, own=0.05)
    assert (
        with_sway_noise(noisy, [calm]).psd is None
        or with_sway_noise(noisy, [calm]).psd.mean() < 0.1 * noisy.residual.var()
    )


def flight_of(swings, seed=0, age=AGE):
    """A gyroscope beside a reference that turns by `swings` rad/s about x, y, z; samples are late by `age` (sd)."""
    made = pair(seed, 1.0)
    rng = np.random.default_rng(seed + 100)
    ideal = made.ideal * np.asarray(swings)
    slope = np.gradient(ideal, 1.0 / FS, axis=0)
    late = slope * age * rng.standard_normal((len(made.t), 1))
    measured = ideal + late + 1e-5 * rng.standard_normal(ideal.shape)
    return dataclasses.replace(made, measured=measured, ideal=ideal, against=None)


def declared(trace, spectrum):
    """`trace` with the noise that another flight has."""
    return dataclasses.replace(trace, psd=spectrum.psd, psd_hz=spectrum.hz)


def excess(trace):
    """Power there over the power expected, by axis."""
    there = learned_spectrum(trace)
    return there.dof @ (
        there.psd / spectrum_at(dataclasses.replace(there, psd=expected(trace, there.hz)), there.hz, FS, None)
    )


def expected(trace, hz):
    return np.column_stack([np.interp(hz, trace.psd_hz, column) for column in trace.psd.T])


def test_an_axis_that_another_flight_did_not_turn_is_expected_to_be_as_late_as_those_that_it_did():
    calm, lively = flight_of((1.0, 1.0, 0.0)), flight_of((4.0, 1.0, 3.0), 1)
    plain = declared(lively, learned_spectrum(calm))
    made = with_aged_noise(plain, age_noise_of([calm]))
    count = learned_spectrum(lively).dof.sum()
    assert (excess(plain) / count)[[0, 2]].min() > 10.0
    assert (excess(made) / count).max() < 3.0
    assert made.psd[:, 1] == pytest.approx(expected(plain, made.psd_hz)[:, 1], rel=0.3)


def test_a_calmer_flight_is_not_expected_to_be_quieter_by_its_age():
    calm, lively = flight_of((1.0, 1.0, 1.0)), flight_of((3.0, 3.0, 3.0), 1)
    plain = declared(calm, learned_spectrum(lively))
    assert with_aged_noise(plain, age_noise_of([lively])) is plain


def test_noise_that_does_not_follow_the_movement_says_nothing_of_age():
    assert age_noise_of([flight_of((1.0, 1.0, 1.0), s, age=0.0) for s in range(10)]) == {}


def test_pairs_and_single_units_have_an_age_of_their_own():
    found = age_noise_of([flight_of((1.0, 1.0, 1.0)), dataclasses.replace(flight_of((1.0, 1.0, 1.0), 1), against=0)])
    assert set(found) == {(Sensor.GYRO, True), (Sensor.GYRO, False)}
