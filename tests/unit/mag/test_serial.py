from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mavcal.calib.mag.serial import (
    variance_inflation,
    weakened_information,
    white_variance,
    widened_scatter,
)
from mavcal.calib.stats.residuals import first_correlation


def autoregressive(rng: np.random.Generator, count: int, rho: float) -> Any:
    drive = rng.normal(size=count)
    series = np.empty(count)
    series[0] = drive[0] / np.sqrt(1 - rho**2)
    for k in range(1, count):
        series[k] = rho * series[k - 1] + drive[k]
    return series


@pytest.mark.parametrize("rho", [0.3, 0.6, 0.9])
def test_a_first_order_process_gives_its_formula(rho: float) -> None:
    """(1 + rho)/(1 - rho), METHODS 3.5."""
    rng = np.random.default_rng(1)
    found = np.mean([variance_inflation(autoregressive(rng, 4000, rho)) for _ in range(20)])
    assert found == pytest.approx((1 + rho) / (1 - rho), rel=0.15)


def test_white_series_are_left_alone() -> None:
    rng = np.random.default_rng(2)
    found = np.array([variance_inflation(rng.normal(size=1000)) for _ in range(300)])
    assert np.mean(found == 1.0) > 0.97
    assert found.max() < 1.5


def test_repeated_samples_count_once() -> None:
    rng = np.random.default_rng(3)
    assert variance_inflation(np.repeat(rng.normal(size=2000), 5)) == pytest.approx(5.0, rel=0.2)


def test_degenerate_series() -> None:
    assert variance_inflation(np.zeros(10)) == 1.0
    assert variance_inflation(np.array([1.0])) == 1.0
    assert first_correlation(np.zeros(5)) == 0.0
    assert white_variance(np.array([2.0])) == 0.0


def test_white_part_of_a_slow_series() -> None:
    rng = np.random.default_rng(4)
    slow = 5.0 * np.sin(np.linspace(0.0, 20.0, 5000))
    assert white_variance(slow + 0.1 * rng.normal(size=5000)) == pytest.approx(0.01, rel=0.1)


def test_a_mean_of_correlated_samples_is_worth_less() -> None:
    """One parameter, its derivative 1: the information of the mean falls by the inflation of the series."""
    rng = np.random.default_rng(5)
    series = autoregressive(rng, 20_000, 0.8)
    weak, factor = weakened_information(np.array([[20_000.0]]), np.ones((1, 20_000)), series)
    assert weak[0, 0] == pytest.approx(20_000.0 / 9.0, rel=0.25)
    assert factor == pytest.approx(9.0, rel=0.25)
    wide, same = widened_scatter(np.array([[2.0]]), np.ones((1, 20_000)), series)
    assert wide[0, 0] == pytest.approx(2.0 * same)


def test_scores_that_turn_against_the_misfit_are_not_widened() -> None:
    rng = np.random.default_rng(6)
    series = autoregressive(rng, 20_000, 0.8)
    signs = np.where(rng.random(20_000) < 0.5, 1.0, -1.0)[None, :]
    _, factor = weakened_information(np.array([[20_000.0]]), signs, series)
    assert factor < 1.2
