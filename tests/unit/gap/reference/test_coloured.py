"""Spectra of nominal recordings: white noise is called white, few coefficients are not believed, lines survive."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from mavcal.calib.gap.likelihood import flicker, random_walk
from mavcal.calib.gap.reference.noise import ResidualSpectrum, learned_spectrum, two_sided_chances

from .test_noise import trace, walk, white

SD = 0.02


def test_white_noise_is_called_white():
    called = [learned_spectrum(trace(white(2000, SD, seed))).white for seed in range(200)]
    assert np.mean(called) > 0.99


@pytest.mark.parametrize("seed", range(10))
def test_noise_with_a_walk_or_a_line_is_not_called_white(seed):
    assert not learned_spectrum(trace(white(4000, SD, seed) + walk(4000, 0.002, seed + 100))).white
    t = np.arange(4000) / 100.0
    line = 0.5 * SD * np.cos(2.0 * np.pi * 17.0 * t)[:, None] * [1.0, 0.0, 0.0]
    assert not learned_spectrum(trace(white(4000, SD, seed) + line)).white


@pytest.mark.parametrize("seed", range(20))
def test_few_low_coefficients_of_white_noise_do_not_move_the_smoothed_spectrum(seed):
    found = learned_spectrum(trace(white(2000, SD, seed)))
    assert found.dof[0] < 10
    ratio = found.smoothed().psd / SD**2
    assert ratio.min() > 0.5
    assert ratio[1:].max() < 2.0
    assert ratio[0].max() < 3.0


@pytest.mark.parametrize("amplitude", [1.0, 3.0])
@pytest.mark.parametrize("seed", range(5))
def test_a_line_survives(amplitude, seed):
    t, hz = np.arange(8000) / 100.0, 17.0
    line = amplitude * SD * np.cos(2.0 * np.pi * hz * t)[:, None] * [1.0, 0.0, 0.0]
    raw = learned_spectrum(trace(white(8000, SD, seed) + line))
    found = raw.smoothed()
    near = int(np.abs(found.hz - hz).argmin())
    assert found.psd[near, 0] > 0.7 * raw.psd[near, 0]
    assert found.psd[near, 0] > 5.0 * found.psd[[near - 2, near + 2], 0].max()
    assert (found.psd[:, 1:] < 4.0 * SD**2).all()


@pytest.mark.parametrize("amplitude", [1.0, 3.0, 10.0])
def test_a_line_does_not_raise_the_noise_far_from_it(amplitude):
    t, hz = np.arange(8000) / 100.0, 17.0
    line = amplitude * SD * np.cos(2.0 * np.pi * hz * t)[:, None] * [1.0, 0.0, 0.0]
    found = learned_spectrum(trace(white(8000, SD, 1) + line)).smoothed()
    assert np.median(found.psd[found.hz < 5.0, 0]) < 2.0 * SD**2


@pytest.mark.parametrize("seed", range(10))
def test_a_walk_keeps_its_slope(seed):
    found = learned_spectrum(trace(white(8000, SD, seed) + walk(8000, 0.002, seed + 100))).smoothed()
    omega = 2.0 * np.pi * found.hz / found.fs
    truth = SD**2 + 0.002**2 * random_walk(omega)
    assert (np.abs(np.log(found.psd / truth[:, None]))[1:] < np.log(2.0)).all()


@pytest.mark.parametrize("seed", range(5))
def test_a_drift_that_returns_to_its_mean_is_not_carried_on_as_a_walk(seed):
    """Seen about its corner, of its level below that few coefficients tell: a walk would be a hundred times as loud."""
    rng, pull = np.random.default_rng(seed), 2.0 * np.pi * 1.0 / 100.0
    steps = 0.01 * rng.standard_normal((20000, 3))
    drift = lfilter([1.0], [1.0, pull - 1.0], steps, axis=0)
    found = learned_spectrum(trace(white(20000, 0.002, seed + 50) + drift)).smoothed()
    omega = 2.0 * np.pi * found.hz / found.fs
    truth = 0.002**2 + 0.01**2 / (1.0 / random_walk(omega) + pull**2)
    slow = found.hz < 0.3
    assert (np.abs(np.log(found.psd[slow] / truth[slow, None])) < np.log(3.0)).all()


def test_flicker_of_the_fit_is_what_the_noise_has():
    hz = np.geomspace(0.01, 50.0, 40)
    truth = 1e-4 + 1e-5 * flicker(2.0 * np.pi * hz / 100.0)
    exact = ResidualSpectrum(hz, np.column_stack([truth] * 3), np.full(40, 50.0), 100.0)
    assert exact.smoothed().psd == pytest.approx(exact.psd, rel=0.02)


def test_a_line_is_widened_to_the_speeds_of_other_flights_and_slow_noise_is_not():
    hz = np.geomspace(0.1, 50.0, 200)
    psd = np.ones((200, 3))
    fast, slow = int(np.argmin(np.abs(hz - 20.0))), int(np.argmin(np.abs(hz - 1.0)))
    psd[[fast, slow]] = 100.0
    wide = ResidualSpectrum(hz, psd, np.full(200, 50.0), 100.0).widened()
    ratio = np.abs(np.log(hz / hz[fast]))
    assert (wide.psd[ratio < 0.07] == 100.0).all()
    assert (wide.psd[(ratio > 0.09) & (hz > 5.0)] == 1.0).all()
    assert (wide.psd[hz < 4.0] == psd[hz < 4.0]).all()


def test_chances_are_those_of_sums_of_squares():
    rng = np.random.default_rng(0)
    means = (rng.normal(size=(4000, 12)) ** 2).mean(axis=1)
    found = two_sided_chances(means[:, None], np.full(4000, 12.0))[:, 0]
    assert np.mean(found < 0.05) == pytest.approx(0.05, abs=0.012)
    assert found.max() <= 1.0
