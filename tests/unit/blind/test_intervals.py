from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.blind.intervals import brier_skill, calibration_error, detection_limit, resampled, wilson


def test_wilson_interval_by_hand():
    low, high = wilson(9, 10)
    assert (low, high) == (pytest.approx(0.5958, abs=1e-4), pytest.approx(0.9821, abs=1e-4))
    assert wilson(0, 0) == (0.0, 1.0)
    assert wilson(5, 5)[1] == 1.0


def test_an_interval_of_rows_drawn_again_is_that_of_the_mean():
    rows = np.random.default_rng(4).normal(3.0, 2.0, 400)
    low, high = resampled(lambda values: float(np.mean(values)), rows)
    assert high - low == pytest.approx(2 * 1.96 * np.std(rows) / 20.0, rel=0.1)
    assert low < np.mean(rows) < high
    assert resampled(lambda values: float(np.mean(values)), rows) == (low, high)
    assert resampled(lambda values: None, rows) == (-np.inf, np.inf)


def test_calibrated_probabilities_have_no_error_and_skill():
    rng = np.random.default_rng(1)
    p = rng.random(20_000)
    hit = rng.random(20_000) < p
    assert calibration_error(p, hit) < 0.02
    assert brier_skill(p, hit) == pytest.approx(1.0 - 6.0 / 9.0, abs=0.03)  # 1 - E p(1-p) / (1/4)
    assert calibration_error(np.full(100, 0.9), [True] * 50 + [False] * 50) == pytest.approx(0.4)
    assert brier_skill([0.5], [True]) == 0.0


def test_the_limit_of_detection_is_the_table_of_the_noncentral_chi_square():
    # No effect is found as often as the level says; df 3 at 0.005/45 meets the prototype's table at its ends.
    assert detection_limit(1e-9, 3, 0.01) == pytest.approx(0.01, rel=1e-3)
    assert detection_limit(20.0, 3, 0.01 / 60) == pytest.approx(0.55, abs=0.1)
    assert detection_limit(70.0, 3, 0.01 / 60) > 0.999
