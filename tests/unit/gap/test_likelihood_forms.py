"""The cosine transform, its bins and the fit of powers, by closed forms and invariances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from mavcal.calib.gap.likelihood import (
    AxisNoise,
    bins_of,
    deviance,
    fast_length,
    fit_amplitudes,
    flicker,
    frequencies,
    random_walk,
    transform,
)
from tests.examples import examples


def largest_prime(n):
    factor, largest = 2, 1
    while n > 1:
        while n % factor == 0:
            n, largest = n // factor, factor
        factor += 1
    return largest


@settings(max_examples=examples(60), deadline=None)
@given(n=st.integers(1, 5000))
def test_a_fast_length_is_the_largest_without_a_prime_above_31(n):
    length = fast_length(n)
    assert largest_prime(length) <= 31
    assert all(largest_prime(other) > 31 for other in range(length + 1, n + 1))


@settings(max_examples=examples(20), deadline=None)
@given(n=st.integers(2, 300), seed=st.integers(0, 99))
def test_the_transform_keeps_the_energy_and_puts_the_mean_into_the_first_bin(n, seed):
    series = np.random.default_rng(seed).normal(size=(3, n))
    made = transform(series)
    np.testing.assert_allclose((made**2).sum(axis=1), (series**2).sum(axis=1))
    np.testing.assert_allclose(made[:, 0], series.mean(axis=1) * math.sqrt(n))


def test_a_cosine_of_a_bin_is_in_that_bin_alone():
    n, k = 64, 9
    wave = np.cos(np.pi * k * (np.arange(n) + 0.5) / n)
    made = transform(wave)
    assert made[k] == pytest.approx(math.sqrt(n / 2.0))
    assert np.abs(np.delete(made, k)).max() < 1e-12
    assert frequencies(n)[k] == pytest.approx(np.pi * k / n)


@pytest.mark.parametrize("n", [16, 400])
def test_a_walk_from_zero_has_a_third_of_its_last_variance_in_the_mean(n):
    """The first bin holds n times the square of the mean of a walk, whose expectation is near n^2 / 3."""
    power = random_walk(frequencies(n)[:1])[0]
    steps = np.arange(1, n + 1)
    exact = float((steps**2).sum()) / n
    assert power == pytest.approx(exact, rel=1.6 / n)


def test_noise_of_one_over_f_halves_with_each_octave():
    omega = np.array([0.1, 0.2, 0.4])
    np.testing.assert_allclose(flicker(omega) * omega, 1.0)
    ratio = random_walk(omega)[:-1] / random_walk(omega)[1:]
    np.testing.assert_allclose(ratio, 4.0, rtol=0.04)


@settings(max_examples=examples(20), deadline=None)
@given(n=st.integers(1, 20_000))
def test_merged_bins_hold_every_frequency_once(n):
    bins = bins_of(n)
    assert bins.counts.sum() == n
    assert (bins.counts >= 1.0).all()
    assert bins.starts[0] == 0
    assert (np.diff(bins.starts) > 0).all()
    assert (bins.counts[: min(n, 47)] == 1.0).all()
    values = np.random.default_rng(n).normal(size=(2, n))
    np.testing.assert_allclose(bins.total(values).sum(axis=1), values.sum(axis=1), atol=1e-9)
    np.testing.assert_allclose(bins.mean(np.ones((1, n))), 1.0)


def test_the_power_of_an_axis_is_its_base_and_its_densities_by_their_amplitudes():
    base = np.array([1.0, 2.0, 3.0])
    noise = AxisNoise(base, {"a": np.array([1.0, 0.0, 1.0]), "b": np.ones(3)}, {"a": 2.0, "b": 0.5})
    np.testing.assert_allclose(noise.power, [3.5, 2.5, 5.5])
    np.testing.assert_array_equal(base, [1.0, 2.0, 3.0])


def test_the_deviance_is_that_of_independent_normal_numbers():
    y, power = np.array([0.5, -2.0, 1.5]), np.array([1.0, 4.0, 2.0])
    normal = -2.0 * (-0.5 * y**2 / power - 0.5 * np.log(2.0 * np.pi * power)).sum()
    made = deviance(power, y**2, np.ones(3))
    assert made == pytest.approx(normal - 3.0 * math.log(2.0 * math.pi))


def white_and_walk(n=4000, seed=1, sizes=(0.5, 0.02)):
    rng = np.random.default_rng(seed)
    bins = bins_of(n)
    series = sizes[0] * rng.normal(size=n) + np.cumsum(sizes[1] * rng.normal(size=n))
    walk = bins.mean(random_walk(frequencies(n)))
    return bins, bins.total(transform(series) ** 2), [np.ones_like(walk), walk]


@pytest.mark.parametrize("seed", range(4))
def test_the_fit_is_the_maximum_that_another_minimiser_finds(seed):
    bins, periodogram, densities = white_and_walk(seed=seed)
    zero = np.zeros_like(densities[0])
    fit = fit_amplitudes(periodogram, bins.counts, zero, densities)

    def loss(logs):
        return deviance(np.exp(logs) @ np.array(densities), periodogram, bins.counts)

    other = minimize(loss, np.log([0.25, 4e-4]), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-6})
    assert fit.deviance == pytest.approx(other.fun, abs=1e-3)
    np.testing.assert_allclose(fit.amplitudes, np.exp(other.x), rtol=0.02)


@settings(max_examples=10, deadline=None)
@given(factor=st.floats(1e-6, 1e6))
def test_the_unit_of_the_readings_does_not_matter(factor):
    bins, periodogram, densities = white_and_walk()
    zero = np.zeros_like(densities[0])
    one = fit_amplitudes(periodogram, bins.counts, zero, densities)
    other = fit_amplitudes(factor * periodogram, bins.counts, zero, densities)
    np.testing.assert_allclose(other.amplitudes, factor * one.amplitudes, rtol=1e-3)
    assert other.deviance == pytest.approx(one.deviance + bins.counts.sum() * math.log(factor), abs=1e-3)


def test_the_information_of_a_white_level_is_half_the_numbers_over_its_square():
    counts = np.full(50, 4.0)
    fit = fit_amplitudes(9.0 * counts, counts, np.zeros(50), [np.ones(50)])
    assert fit.amplitudes[0] == pytest.approx(9.0)
    assert fit.information[0, 0] == pytest.approx(0.5 * 200.0 / 81.0)


def test_what_the_base_holds_already_is_not_added_again():
    counts = np.full(50, 4.0)
    fit = fit_amplitudes(9.0 * counts, counts, np.full(50, 5.0), [np.ones(50)])
    assert fit.amplitudes[0] == pytest.approx(4.0)
    assert fit.deviance == pytest.approx(200.0 * (math.log(9.0) + 1.0))
