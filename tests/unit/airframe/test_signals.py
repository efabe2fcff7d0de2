"""Filters of series on a grid against closed forms and against the firmwares' own arithmetic at their own rate."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from mavcal.calib.airframe.signals import Grid, kept_below, spline

FS = 100.0
T = np.arange(600) / FS
SMOOTH = (0.3 * np.sin(2.0 * np.pi * 1.3 * T) * np.exp(-(((T - 3.0) / 1.2) ** 2)))[:, None]
"""Still at both ends."""


def test_nothing_changes_what_is_not_filtered() -> None:
    grid, values = Grid(600, FS), np.random.default_rng(1).normal(size=(600, 3))
    assert grid.through(values, None) is values
    np.testing.assert_allclose(grid.series(grid.spectrum(values)), values, atol=1e-12)
    np.testing.assert_allclose(grid.through(values, grid.behind(0.0, 0.0)), values, atol=1e-12)
    assert grid.butterworth(0.0) is None
    assert grid.butterworth(50.0) is None


@pytest.mark.parametrize("response", ["butterworth", "lag", "delay"])
def test_a_series_begins_at_rest_in_its_first_value(response: str) -> None:
    grid, steady = Grid(600, FS), np.full((600, 2), 3.0)
    made = {"butterworth": grid.butterworth(20.0), "lag": grid.behind(0.0, 0.1), "delay": grid.behind(0.05, 0.0)}
    np.testing.assert_allclose(grid.through(steady, made[response]), 3.0, atol=1e-9)


@pytest.mark.parametrize("delay", [-0.01, 0.0025, 0.02, 0.0333])
def test_a_delay_may_be_a_part_of_a_row(delay: float) -> None:
    at = T - delay
    known = 0.3 * np.sin(2.0 * np.pi * 1.3 * at) * np.exp(-(((at - 3.0) / 1.2) ** 2))
    grid = Grid(600, FS)
    np.testing.assert_allclose(grid.through(SMOOTH, grid.behind(delay, 0.0))[:, 0], known, atol=1e-3)


@pytest.mark.parametrize("tau", [0.005, 0.03, 0.2])
def test_a_lag_answers_a_ramp_late_by_its_time_constant(tau: float) -> None:
    ramp = np.clip(T - 1.0, 0.0, None)[:, None]
    found = Grid(600, FS).through(ramp, Grid(600, FS).behind(0.0, tau))
    settled = 1.0 + 8.0 * tau < T
    np.testing.assert_allclose((ramp - found)[settled & (T < 5.5), 0], tau, atol=0.002)


def test_a_lag_goes_smoothly_through_zero() -> None:
    """A simulator may be ahead of the reader's filter: the slope by tau is that of the series, on both sides."""
    grid, slope = Grid(600, FS), np.gradient(SMOOTH[:, 0], 1.0 / FS)
    for tau in (-0.005, -1e-4, 1e-4, 0.005):
        found = grid.through(SMOOTH, grid.behind(0.0, tau)) - SMOOTH
        np.testing.assert_allclose(found[:, 0] / tau, -slope, atol=0.15)


@pytest.mark.parametrize("corner", [10.0, 20.0])
def test_the_filter_is_that_of_a_firmware_at_its_own_rate(corner: float) -> None:
    """At 1 kHz, where the firmware filters; the same taps written for 100 Hz are another filter."""
    fine = np.arange(6000) / 1000.0
    sharp = np.tanh(80.0 * (fine - 2.0)) - np.tanh(80.0 * (fine - 2.3))
    known = lfilter(*butter(2, corner, fs=1000.0), sharp)[::10]
    grid = Grid(600, FS)
    found = grid.through(sharp[::10, None], grid.butterworth(corner))[:, 0]
    coarse = lfilter(*butter(2, corner, fs=FS), sharp[::10])
    assert np.abs(found - known).max() < 0.01
    assert np.abs(coarse - known).max() > 5.0 * np.abs(found - known).max()


def test_what_a_grid_would_fold_back_is_left_out() -> None:
    fine = np.arange(8000) / 400.0
    slow, fast = np.sin(2.0 * np.pi * 3.0 * fine), np.sin(2.0 * np.pi * 97.0 * fine)
    kept = kept_below((slow + fast)[:, None], 400.0, FS)[:, 0]
    assert np.abs(kept - slow)[400:-400].max() < 0.01
    assert kept_below(slow[::4, None], 100.0, FS) is not None
    np.testing.assert_array_equal(kept_below(slow[::4, None], 100.0, FS)[:, 0], slow[::4])


def test_a_curve_leaves_out_stamps_that_do_not_grow() -> None:
    stamps = np.array([0.0, 0.1, 0.1, 0.2, 0.15, 0.3, 0.4])
    values = stamps[:, None] * [1.0, -2.0]
    found = spline(stamps, values)
    np.testing.assert_allclose(found(0.25), [0.25, -0.5], atol=1e-9)
    np.testing.assert_allclose(found(0.25, 1), [1.0, -2.0], atol=1e-9)
