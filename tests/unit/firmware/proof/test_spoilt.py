"""Samples that nothing explains do not decide; samples that contradict the new values do."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.firmware.proof.spoilt import MOST, PRICE, spoilt

N = 30
EVERY = np.ones(N, dtype=bool)


def covariance():
    """Scatter of 0.08 beside a common uncertainty of 0.14, as in the capture of an ArduCopter."""
    return 0.08**2 * np.eye(N) + 0.14**2 * np.ones((N, N))


@pytest.mark.parametrize("seed", range(20))
def test_single_wild_samples_are_found_and_no_healthy_one(seed):
    rng = np.random.default_rng(seed)
    wrong = 2.0 * rng.normal(size=N)  # what the old values would leave
    data = rng.normal(0.0, 0.08, N) + rng.normal(0.0, 0.14)
    assert not spoilt(np.array([data, data + wrong]), covariance(), EVERY).any()
    wild = rng.choice(N, 3, replace=False)
    data[wild] -= 0.62
    out = spoilt(np.array([data, data + wrong]), covariance(), EVERY)
    assert set(np.flatnonzero(out)) == set(wild)


def test_what_the_old_values_explain_is_not_left_out():
    """The new values would leave out a fifth of the samples; the old ones explain all, and are cheaper."""
    rng = np.random.default_rng(1)
    effect = np.where(np.arange(N) < 5, 1.0, 0.0)
    data = rng.normal(0.0, 0.08, N) + effect  # nothing was applied
    assert not spoilt(np.array([data, data - effect]), covariance(), EVERY).any()


def test_no_more_than_a_fifth_and_no_reading_at_rest_is_left_out():
    rng = np.random.default_rng(2)
    data = rng.normal(0.0, 5.0, N)
    assert spoilt(data[None], 0.01 * np.eye(N), EVERY).sum() == int(MOST * N)
    moving = np.arange(N) >= 20
    out = spoilt(data[None], 0.01 * np.eye(N), moving)
    assert out.sum() == int(MOST * 10)
    assert not out[:20].any()
    assert PRICE > 4.0
