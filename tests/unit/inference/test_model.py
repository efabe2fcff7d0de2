"""The marginal likelihood of one model: exact where it is linear, and near the integral where it is not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from mavcal.calib.inference.model import Posterior, Term, laplace
from mavcal.calib.inference.quadratic import Quadratic


def seen(y: np.ndarray, noise: np.ndarray, centre: np.ndarray) -> Quadratic:
    """The log-density of normal data `y` with covariance `noise` about any `centre`."""
    precision = np.linalg.inv(noise)
    return Quadratic(
        centre, precision @ (y - centre), precision, float(multivariate_normal.logpdf(y, centre, noise))
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(5))
def test_a_linear_model_has_its_exact_marginal_likelihood(seed: int) -> None:
    """Two records of 4 and 3 numbers of the same 3 amplitudes, from any start."""
    rng = np.random.default_rng(seed)
    maps = [rng.normal(size=(4, 3)), rng.normal(size=(3, 3))]
    noises = [a @ a.T + 0.1 * np.eye(len(a)) for a in (rng.normal(size=(4, 4)), rng.normal(size=(3, 3)))]
    data = [rng.normal(size=4), rng.normal(size=3)]
    mean, sd = rng.normal(size=3), np.array([0.1, 1.0, 30.0])
    terms = [
        Term(seen(y, noise, rng.normal(size=len(y))), lambda z, h=h: (h @ z, h))
        for h, noise, y in zip(maps, noises, data, strict=True)
    ]
    value, best, covariance = laplace(terms, 5.0 * rng.normal(size=3), mean, sd)
    h = np.vstack(maps)
    noise = np.zeros((7, 7))
    noise[:4, :4], noise[4:, 4:] = noises
    y, prior = np.concatenate(data), np.diag(sd**2)
    assert value == pytest.approx(multivariate_normal.logpdf(y, h @ mean, h @ prior @ h.T + noise), rel=1e-9)
    gain = prior @ h.T @ np.linalg.inv(h @ prior @ h.T + noise)
    np.testing.assert_allclose(best, mean + gain @ (y - h @ mean), rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(covariance, prior - gain @ h @ prior, rtol=1e-6, atol=1e-6)


def test_a_product_of_amplitudes_is_near_its_integral() -> None:
    """A ratio of two records: ``sim = a``, ``real = a (1 + s)``, as an airframe's effects act."""
    a, sd = 25.0, np.array([20.0, 0.2])

    def scaled(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([z[0] * (1.0 + z[1])]), np.array([[1.0 + z[1], z[0]]])

    def plain(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return z[:1], np.array([[1.0, 0.0]])

    noise = np.array([[0.1**2]])
    terms = [
        Term(seen(np.array([22.5]), noise, np.zeros(1)), scaled),
        Term(seen(np.array([a]), noise, np.zeros(1)), plain),
    ]
    value, best, covariance = laplace(terms, np.array([10.0, 0.0]), np.array([25.0, 0.0]), sd)

    def by_scale(s: float) -> float:
        """The integral over `a` at a given ratio."""
        ratio = np.array([1.0 + s, 1.0])
        cov = np.diag([0.01, 0.01]) + 400.0 * np.outer(ratio, ratio)
        return float(multivariate_normal.pdf([22.5, a], 25.0 * ratio, cov) * norm.pdf(s, 0.0, 0.2))

    whole, _ = quad(by_scale, -0.2, 0.0, points=[-0.1])
    assert value == pytest.approx(np.log(whole), abs=0.01)
    assert best[1] == pytest.approx(-0.1, abs=0.001)
    assert np.sqrt(covariance[1, 1]) == pytest.approx(0.1 / 25.0 * np.hypot(1.0, 0.9), rel=0.02)


def test_a_model_without_amplitudes_is_its_data() -> None:
    says = seen(np.array([1.0, 2.0]), np.eye(2), np.zeros(2))
    empty = np.empty(0)
    value, best, covariance = laplace([Term(says, lambda z: (np.zeros(2), np.empty((2, 0))))], empty, empty, empty)
    assert value == pytest.approx(multivariate_normal.logpdf([1.0, 2.0], np.zeros(2)))
    assert best.shape == (0,)
    assert covariance.shape == (0, 0)


def test_a_block_finds_its_own_amplitudes() -> None:
    one = Posterior(0.0, np.arange(4.0), np.diag(np.arange(4.0)), {"first": slice(1, 2), "second": slice(2, 4)})
    mean, covariance = one.of("second")
    np.testing.assert_array_equal(mean, [2.0, 3.0])
    np.testing.assert_array_equal(covariance, np.diag([2.0, 3.0]))
