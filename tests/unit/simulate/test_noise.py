from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import welch

from mavcal.calib.simulate.noise import flicker, half_derivative, half_integral, random_walk, white

RATE = 50.0
COUNT = 60_000


def allan(x: np.ndarray, m: int) -> float:
    """Overlapping Allan deviation of rates x at m samples, from sums alone (IEEE 952, C.2)."""
    theta = np.concatenate([[0.0], np.cumsum(x)])
    second = theta[2 * m :] - 2.0 * theta[m:-m] + theta[: -2 * m]
    return float(np.sqrt((second**2).mean() / 2.0) / m)


def test_white_noise_has_its_allan_deviation():
    x = white(np.random.default_rng(1), COUNT, np.array([0.02, 0.0, 0.1]), RATE)
    for m in (1, 10, 100):
        assert allan(x[:, 0], m) == pytest.approx(0.02 / np.sqrt(m / RATE), rel=0.08)
        assert allan(x[:, 2], m) == pytest.approx(0.1 / np.sqrt(m / RATE), rel=0.08)
    assert not x[:, 1].any()


def test_the_allan_deviation_of_flicker_is_flat_at_its_floor():
    x = flicker(np.random.default_rng(2), COUNT, np.full(3, 0.3))
    floor = 0.3 * np.sqrt(2.0 * np.log(2.0) / np.pi)
    for m in (20, 60, 200):
        found = np.sqrt(np.mean([allan(x[:, k], m) ** 2 for k in range(3)]))
        assert found == pytest.approx(floor, rel=0.1)


def test_flicker_has_the_same_spectrum_at_every_rate():
    for rate in (20.0, 200.0):
        x = flicker(np.random.default_rng(3), COUNT, np.full(3, 0.3))
        f, power = welch(x, rate, nperseg=2048, axis=0)
        band = (f > rate / 500) & (f < rate / 20)
        assert (power[band].mean(axis=1) * 2.0 * np.pi * f[band] / (2.0 * 0.3**2)).mean() == pytest.approx(
            1.0, rel=0.05
        )


def test_a_random_walk_has_its_allan_deviation():
    x = random_walk(np.random.default_rng(4), COUNT, np.array([0.05, 0.05, 0.0]), RATE)
    assert not x[0].any()
    assert not x[:, 2].any()
    for m in (50, 150):
        found = np.sqrt(np.mean([allan(x[:, k], m) ** 2 for k in range(2)]))
        assert found == pytest.approx(0.05 * np.sqrt(m / RATE / 3.0), rel=0.12)


def test_half_an_integral_undoes_half_a_derivative():
    both = np.convolve(half_integral(50), half_derivative(50))[:50]
    np.testing.assert_allclose(both, np.eye(50)[0], atol=1e-12)
    np.testing.assert_allclose(np.convolve(half_derivative(50), half_derivative(50))[:4], [1, -1, 0, 0], atol=1e-12)


def test_poles_filter_the_flicker():
    draws = flicker(np.random.default_rng(5), 4000, np.full(3, 0.3), np.array([1.0]))
    coloured = flicker(np.random.default_rng(5), 4000, np.full(3, 0.3), np.array([1.0, -0.5]))
    np.testing.assert_allclose(coloured[1:] - 0.5 * coloured[:-1], draws[1:], atol=1e-12)
