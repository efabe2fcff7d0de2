from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap.likelihood import bins_of, fast_length, fit_amplitudes, frequencies, random_walk, transform


def test_the_transform_of_a_random_walk_has_the_stated_power():
    rng = np.random.default_rng(0)
    y = transform(np.cumsum(rng.normal(size=(400, 256)), axis=1))
    ratio = (y**2).mean(axis=0)[1:] / random_walk(frequencies(256))[1:]
    assert ratio.mean() == pytest.approx(1.0, abs=0.03)
    assert np.abs(ratio - 1.0).max() < 6.0 * np.sqrt(2.0 / 400)


def test_amplitudes_of_white_noise_and_a_walk_are_found_together():
    rng = np.random.default_rng(1)
    n = 20_000
    series = 0.7 * rng.normal(size=n) + np.cumsum(0.01 * rng.normal(size=n))
    bins = bins_of(n)
    walk = bins.mean(random_walk(frequencies(n)))
    fit = fit_amplitudes(
        bins.total(transform(series) ** 2), bins.counts, np.zeros_like(walk), [np.ones_like(walk), walk]
    )
    sd = np.sqrt(np.diag(np.linalg.inv(fit.information)))
    assert np.all(np.abs(fit.amplitudes - [0.49, 1e-4]) < 4.0 * sd)


def test_an_amplitude_that_is_not_there_is_zero_and_never_negative():
    rng = np.random.default_rng(2)
    bins = bins_of(5000)
    power = bins.total(transform(0.9 * rng.normal(size=5000)) ** 2)
    fit = fit_amplitudes(power, bins.counts, np.ones(len(bins.counts)), [np.ones(len(bins.counts))])
    assert 0.0 <= fit.amplitudes[0] < 1e-12


@pytest.mark.parametrize("power", [0.0, 1.0])
@pytest.mark.parametrize("base", [0.0, 1.0])
def test_densities_or_a_recording_without_any_power_are_no_trouble(power, base):
    bins = bins_of(500)
    n = len(bins.counts)
    densities = [np.zeros(n), np.full(n, 1e-200), np.ones(n), bins.mean(random_walk(frequencies(500)))]
    fit = fit_amplitudes(power * bins.counts, bins.counts, np.full(n, base), densities)
    assert np.isfinite(fit.amplitudes).all()
    assert (fit.amplitudes >= 0.0).all()
    assert np.isfinite(fit.deviance)
    assert np.isfinite(fit.information).all()
    assert fit.amplitudes[0] == 0.0


def test_a_start_near_the_truth_is_found_from_the_powers_alone():
    bins = bins_of(20_000)
    walk = bins.mean(random_walk(frequencies(20_000)))
    series = np.random.default_rng(3).normal(0.0, 0.7, 20_000)
    power = bins.total(transform(series) ** 2)
    cold = fit_amplitudes(power, bins.counts, np.zeros_like(walk), [np.ones_like(walk), walk])
    warm = fit_amplitudes(power, bins.counts, np.zeros_like(walk), [np.ones_like(walk), walk], np.array([0.49, 0.0]))
    assert cold.deviance == pytest.approx(warm.deviance, abs=1e-2)


def test_nothing_to_fit_is_the_loss_of_the_base():
    counts, base = np.full(20, 3.0), np.linspace(1.0, 2.0, 20)
    found = fit_amplitudes(counts * base, counts, base, [])
    assert found.deviance == pytest.approx(float(counts @ np.log(base) + counts.sum()))
    assert found.amplitudes.shape == (0,)


@pytest.mark.parametrize("n", [1, 37, 1993, 6999, 14_000, 13_999, 41_003])
def test_next_to_nothing_is_lost_to_a_length_that_transforms_fast(n):
    length = fast_length(n)
    assert 0.993 * n - 1 < length <= n
    for prime in (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31):
        while length % prime == 0:
            length //= prime
    assert length == 1
