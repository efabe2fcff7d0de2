from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import welch

from mavcal.calib.blind.airframe.air import LEAST_PASSING, Gust, Weather, air_over_time, dryden, scales

DT = 0.02


def test_turbulence_has_its_deviations_and_no_mean():
    # Twenty hours, some twenty thousand correlation times.
    drawn = dryden(Weather(4.0, 0.0, 0.8), 2_000_000, DT, np.random.default_rng(1))
    _, _, ratio = scales()
    assert drawn.std(axis=0) == pytest.approx([0.8, 0.8, 0.8 * ratio], rel=0.04)
    assert drawn.mean(axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=0.05)


def test_turbulence_has_drydens_spectrum():
    drawn = dryden(Weather(4.0, 0.0, 1.0), 1_000_000, DT, np.random.default_rng(2))
    frequency, along = welch(drawn[:, 0], 1.0 / DT, nperseg=8192)
    _, across = welch(drawn[:, 1], 1.0 / DT, nperseg=8192)
    length, _, _ = scales()
    tau = length / math.hypot(4.0, LEAST_PASSING)
    for at in (0.05, 0.3, 1.0):
        k = int(np.argmin(abs(frequency - at)))
        near = slice(max(1, k - 8), k + 9)
        x = (2.0 * math.pi * frequency[near] * tau) ** 2
        # MIL-F-8785C 3.7.1.2, one-sided over Hz
        assert along[near].mean() == pytest.approx((4.0 * tau / (1.0 + x)).mean(), rel=0.1)
        assert across[near].mean() == pytest.approx((2.0 * tau * (1.0 + 3.0 * x) / (1.0 + x) ** 2).mean(), rel=0.1)


def test_scales_are_those_of_the_standard_near_the_ground():
    horizontal, vertical, ratio = scales(20.0)
    assert vertical == pytest.approx(20.0 * 0.3048)
    assert horizontal == pytest.approx(20.0 * 0.3048 / (0.177 + 0.000823 * 20.0) ** 1.2)
    assert ratio == pytest.approx((0.177 + 0.000823 * 20.0) ** 0.4)


def test_wind_is_steady_and_a_gust_is_one_smooth_pulse():
    t = np.arange(0.0, 30.0, DT)
    gust = Gust(10.0, 2.0, (3.0, -4.0, 0.0))
    air = air_over_time(Weather(1.0, 2.0, 0.0, (gust,)), t, np.random.default_rng(3))
    outside = (t < 10.0) | (t > 12.0)
    assert np.ptp(air[outside], axis=0) == pytest.approx([0.0, 0.0, 0.0])
    assert air[0] == pytest.approx([1.0, 2.0, 0.0])
    assert air[np.argmin(abs(t - 11.0))] == pytest.approx([4.0, -2.0, 0.0])
    assert (air[:, 0] - 1.0).sum() * DT == pytest.approx(0.5 * 3.0 * 2.0, rel=1e-3)
