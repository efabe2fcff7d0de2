"""What is integrated out of a quadratic is integrated out: the same numbers by way of covariances."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal, ortho_group

from mavcal.calib.inference.quadratic import Quadratic


def spread(rng: np.random.Generator, count: int, decades: float = 1.0) -> np.ndarray:
    """A positive definite matrix whose eigenvalues span so many decades."""
    turned = ortho_group.rvs(count, random_state=rng) if count > 1 else np.eye(1)
    return (turned * 10.0 ** rng.uniform(-0.5 * decades, 0.5 * decades, count)) @ turned.T


def made(seed: int, count: int = 5) -> Quadratic:
    rng = np.random.default_rng(seed)
    return Quadratic(rng.normal(size=count), rng.normal(size=count), spread(rng, count, 2.0), rng.normal())


def measured(quadratic: Quadratic) -> tuple[np.ndarray, np.ndarray, float]:
    """The same as a measurement of the parameters: value, covariance, and the log of the factor before the density."""
    covariance = np.linalg.inv(quadratic.curvature)
    gain = covariance @ quadratic.gradient
    factor = quadratic.constant + 0.5 * quadratic.gradient @ gain
    factor += 0.5 * np.linalg.slogdet(2.0 * np.pi * covariance)[1]
    return quadratic.centre + gain, covariance, float(factor)


def test_value_and_slope_belong_together() -> None:
    one, step = made(0), 1e-6
    theta = np.linspace(-1.0, 1.0, 5)
    by_hand = [(one.at(theta + step * e) - one.at(theta - step * e)) / (2.0 * step) for e in np.eye(5)]
    np.testing.assert_allclose(one.slope(theta), by_hand, rtol=1e-6, atol=1e-8)
    assert one.at(one.centre) == one.constant
    np.testing.assert_array_equal(one.slope(one.centre), one.gradient)


@pytest.mark.parametrize("seed", range(6))
def test_parameters_without_interest_are_integrated_out_under_their_priors(seed: int) -> None:
    one, rng = made(seed), np.random.default_rng(100 + seed)
    gone = rng.permutation([True, True, False, False, False])
    mean, sd = rng.normal(size=5), 10.0 ** rng.uniform(-1.0, 1.0, 5)
    left = one.without(gone, mean, sd)
    value, covariance, factor = measured(one)
    for _ in range(3):
        theta = rng.normal(size=3)
        whole = mean.copy()
        whole[~gone] = theta
        known = factor + multivariate_normal.logpdf(value, whole, covariance + np.diag(np.where(gone, sd**2, 0.0)))
        assert left.at(theta) == pytest.approx(known, rel=1e-9, abs=1e-9)


def test_a_parameter_that_the_data_do_not_touch_goes_without_a_trace() -> None:
    one = made(3, 4)
    curvature, gradient = np.zeros((5, 5)), np.zeros(5)
    curvature[:4, :4], gradient[:4] = one.curvature, one.gradient
    wide = Quadratic(np.append(one.centre, 7.0), gradient, curvature, one.constant)
    left = wide.without(np.arange(5) == 4, np.full(5, 2.0), np.full(5, 0.3))
    theta = np.array([0.1, -0.2, 0.3, 0.4])
    assert left.at(theta) == pytest.approx(one.at(theta), abs=1e-12)
    np.testing.assert_allclose(left.curvature, one.curvature, rtol=1e-12)


def test_integrated_one_by_one_or_together_is_the_same() -> None:
    one = made(5)
    mean, sd = np.linspace(-1.0, 1.0, 5), np.linspace(0.2, 3.0, 5)
    together = one.without(np.array([True, False, True, False, False]), mean, sd)
    first = one.without(np.array([True, False, False, False, False]), mean, sd)
    second = first.without(np.array([False, True, False, False]), mean[1:], sd[1:])
    theta = np.array([0.5, -0.5, 1.0])
    assert second.at(theta) == pytest.approx(together.at(theta), rel=1e-11)


@pytest.mark.parametrize("seed", range(6))
def test_a_discrepancy_adds_its_covariance_to_that_of_the_measurement(seed: int) -> None:
    one, rng = made(seed), np.random.default_rng(200 + seed)
    apart = spread(rng, 5, 3.0)
    wider = one.with_discrepancy(np.linalg.inv(apart))
    value, covariance, factor = measured(one)
    np.testing.assert_allclose(wider.curvature, np.linalg.inv(covariance + apart), rtol=1e-8, atol=1e-10)
    for _ in range(3):
        theta = rng.normal(size=5)
        known = factor + multivariate_normal.logpdf(value, theta, covariance + apart)
        assert wider.at(theta) == pytest.approx(known, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("decades", [6.0, 10.0])
def test_a_discrepancy_beside_data_that_say_nothing_or_very_much_of_a_direction(decades: float) -> None:
    """In axes in which both are diagonal every direction has a closed form; some have no data at all."""
    rng = np.random.default_rng(1)
    axes = np.diag(10.0 ** np.linspace(-0.25 * decades, 0.25 * decades, 6)) @ ortho_group.rvs(6, random_state=rng)
    k = np.array([0.0, 0.0, 1e-6, 1.0, 1e6, 1e12])
    g, d = rng.normal(size=6) * np.sqrt(k), rng.normal(size=6)
    curvature = (axes * k) @ axes.T
    one = Quadratic(np.zeros(6), axes @ g, 0.5 * (curvature + curvature.T), 1.5)
    wider = one.with_discrepancy(axes @ axes.T)
    known = 1.5 + np.sum(0.5 * g**2 / (1.0 + k) - 0.5 * np.log1p(k) + (g * d - 0.5 * k * d**2) / (1.0 + k))
    assert wider.at(np.linalg.solve(axes.T, d)) == pytest.approx(known, rel=1e-5, abs=1e-5)
    assert np.linalg.eigvalsh(wider.curvature).min() > -1e-9 * np.abs(wider.curvature).max()


def test_no_record_however_long_says_more_than_the_model_is_right_to() -> None:
    precision = spread(np.random.default_rng(4), 5)
    for length in (1.0, 1e4, 1e10):
        one = made(2)
        longer = Quadratic(one.centre, length * one.gradient, length * one.curvature)
        room = precision - longer.with_discrepancy(precision).curvature
        assert np.linalg.eigvalsh(room).min() > -1e-9


def test_a_discrepancy_that_is_no_covariance_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        made(1).with_discrepancy(np.diag([1.0, 1.0, 0.0, 1.0, -1.0]))
