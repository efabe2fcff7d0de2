"""Residuals of a fit against their noise, and their colour."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.stats import chi2, norm
from scipy.stats import t as t_distribution

from mavcal.calib.stats.residuals import first_correlation, residual_statistics, student_variance
from tests.examples import examples


def test_white_noise_of_the_right_size_passes():
    rng = np.random.default_rng(1)
    found = residual_statistics(2.0 * rng.standard_normal((5000, 3)), 15000 - 12, 2.0)
    assert found["white"] is True
    assert found["p_value"] is not None
    assert 0.001 < found["p_value"] < 0.999


def test_noise_that_is_larger_than_stated_is_improbable():
    rng = np.random.default_rng(2)
    found = residual_statistics(1.1 * rng.standard_normal(5000), 4991, 1.0)
    assert found["p_value"] is not None
    assert found["p_value"] < 1e-6


@pytest.mark.parametrize("columns", [1, 3])
def test_a_slow_drift_is_not_white(columns):
    drift = np.cumsum(np.random.default_rng(3).standard_normal((500, columns)), axis=0)
    found = residual_statistics(drift - drift.mean(axis=0), 499 * columns, None)
    assert found["white"] is False
    assert found["chi2"] is None
    assert found["p_value"] is None


def test_few_residuals_do_not_tell_their_colour():
    found = residual_statistics(np.array([1.0, -1.0, 0.5]), 0, 1.0)
    assert found["white"] is None
    assert found["p_value"] is None


def test_the_first_correlation_of_known_series():
    assert first_correlation(np.array([1.0, -1.0, 1.0, -1.0])) == pytest.approx(-0.75)
    assert first_correlation(np.array([1.0, 1.0, -1.0, -1.0])) == pytest.approx(0.25)
    assert first_correlation(np.zeros(10)) == 0.0


def test_columns_are_series_of_their_own():
    one, other = np.array([1.0, 1.0, 1.0, -3.0]), np.array([2.0, -2.0, 2.0, -2.0])
    both = residual_statistics(np.column_stack([one, other]), 6, None)
    # (1 + 1 - 3) and -12, over 12 and 16: no product of the last of one with the first of the other
    assert both["first_correlation"] == pytest.approx((-1.0 - 12.0) / 28.0)


def test_an_autoregression_has_the_correlation_it_was_made_with():
    x = lfilter([1.0], [1.0, -0.6], np.random.default_rng(5).normal(size=20_000))
    assert residual_statistics(x, 19_999, None)["first_correlation"] == pytest.approx(0.6, abs=0.02)


@pytest.mark.parametrize(("n", "told"), [(8, None), (9, True)])
def test_eight_pairs_are_needed_to_tell_the_colour(n, told):
    series = np.resize([1.0, 1.0, -1.0, -1.0], n)
    assert residual_statistics(series, n - 1, 1.0)["white"] is told


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("correlation", "white"), [(0.325, True), (0.333, False)])
def test_a_chance_of_one_in_a_thousand_is_the_limit_of_white(sign, correlation, white):
    """Two-sided: a correlation of 3.29 over the root of a hundred pairs."""
    series = np.zeros(101)
    series[[0, 1, 3]] = 1.0, sign, np.sqrt(1.0 / correlation - 2.0)
    found = residual_statistics(series, 100, None)
    assert found["first_correlation"] == pytest.approx(sign * correlation)
    assert found["white"] is white


@given(seed=st.integers(0, 500), scale=st.floats(1e-3, 1e3))
@settings(max_examples=examples(20), deadline=None)
def test_the_unit_of_residuals_does_not_matter(seed, scale):
    x = np.random.default_rng(seed).normal(size=(40, 2))
    one, other = residual_statistics(x, 70, 1.3), residual_statistics(x * scale, 70, 1.3 * scale)
    assert other["chi2"] == pytest.approx(one["chi2"], rel=1e-9)
    assert other["first_correlation"] == pytest.approx(one["first_correlation"], rel=1e-9)
    assert other["p_value"] == pytest.approx(chi2.sf(float((x**2).sum()) / 1.69, 70), rel=1e-9)


@pytest.mark.parametrize("noise_sd", [None, 0.0, -1.0])
def test_without_a_noise_to_compare_with_there_is_no_chi_square(noise_sd):
    found = residual_statistics(np.ones(20), 19, noise_sd)
    assert found["chi2"] is None
    assert found["p_value"] is None
    assert found["dof"] == 19


def test_without_degrees_of_freedom_there_is_a_sum_and_no_chance():
    found = residual_statistics(np.array([3.0, 4.0]), 0, 2.0)
    assert found["chi2"] == pytest.approx(25.0 / 4.0)
    assert found["p_value"] is None


@pytest.mark.parametrize("dof", [2.0, 5.0, 30.0, 1e6])
def test_the_widened_error_holds_what_a_normal_one_should(dof):
    """Student's distribution holds 95 % within 1.96 sd of the widened error."""
    half = norm.ppf(0.975) * np.sqrt(student_variance(dof))
    assert t_distribution.cdf(half, dof) - t_distribution.cdf(-half, dof) == pytest.approx(0.95, abs=1e-9)


def test_fewer_degrees_of_freedom_widen_more():
    factors = [student_variance(dof) for dof in (1.0, 2.0, 4.0, 8.0, 100.0)]
    assert sorted(factors, reverse=True) == factors
    assert factors[-1] > 1.0
