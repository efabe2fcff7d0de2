"""Residuals of a fit against their noise, and their colour."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.stats.residuals import residual_statistics


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
