"""Long series in two bands: the same coefficients, put together again as they were."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.likelihood import transform
from mavcal.calib.gap.model.bands import assembled, combined, resampled, split
from mavcal.calib.gap.model.views import View, views_of
from mavcal.calib.gap.problem import GapProblem, ReferenceInfo, ReferenceKind
from mavcal.calib.recording import Sensor
from tests.unit.gap.effects.conftest import make

SIGMA = 0.05


def view_of(seconds: float, *, hole: slice | None = None, fs: float = 200.0) -> View:
    trace = make(Sensor.ACCEL, seconds=seconds, fs=fs)
    noise = np.random.default_rng(1).normal(0.0, SIGMA, trace.ideal.shape)
    seen = trace.observed.copy()
    if hole is not None:
        seen[hole] = False
    trace = dataclasses.replace(trace, measured=trace.ideal + noise, observed=seen, sigma=np.full(3, SIGMA))
    (view,) = views_of(GapProblem((trace,), ReferenceInfo(ReferenceKind.SIM), seconds), {}, {})
    return view


@pytest.fixture(scope="module")
def whole() -> View:
    return view_of(150.0)


@pytest.fixture(scope="module")
def bands(whole: View) -> tuple[View, ...]:
    return split([whole])


@pytest.mark.parametrize(("n", "m"), [(1000, 250), (999, 100), (1000, 1000), (1024, 37)])
def test_a_lower_rate_keeps_the_coefficients(n, m):
    series = np.random.default_rng(0).normal(size=(2, n, 3))
    lower = resampled(series, m)
    assert lower.shape == (2, m, 3)
    kept = transform(np.moveaxis(series, 1, -1))[..., :m] * np.sqrt(m / n)
    assert transform(np.moveaxis(lower, 1, -1)) == pytest.approx(kept, abs=1e-12)


def test_slow_movement_keeps_its_size_at_a_lower_rate():
    t = np.arange(2000) / 100.0
    slow = 3.0 + np.cos(2.0 * np.pi * 0.2 * t)
    at = (np.arange(400) + 0.5) * 5.0 - 0.5
    assert resampled(slow[None], 400)[0] == pytest.approx(np.interp(at / 100.0, t, slow), abs=1e-2)


def test_two_bands_make_the_series_again(whole, bands):
    lower, upper = bands
    assert (lower.n, lower.first, upper.n) == (upper.first, 0, lower.whole.n)
    assert lower.whole.n == whole.n
    assert combined(lower.residual, upper.residual) == pytest.approx(whole.residual, abs=1e-9)


def test_each_band_has_its_own_coefficients_of_the_whole(whole, bands):
    lower, upper = bands
    spectrum = transform(np.ascontiguousarray(whole.residual.T))
    assert lower.spectra(lower.residual) == pytest.approx(spectrum[:, : lower.n] * np.sqrt(lower.gain), abs=1e-9)
    assert upper.spectra(upper.residual) == pytest.approx(spectrum[:, lower.n :], abs=1e-9)
    assert lower.count + upper.count == whole.n
    assert lower.omega[-1] < upper.omega[0]


def test_noise_is_declared_for_each_band_as_it_is_seen_there(bands):
    for band in bands:
        power = (band.spectra(band.residual) ** 2).mean(axis=1)
        assert power == pytest.approx(band.variance, rel=0.06)


def test_the_power_of_both_bands_is_that_of_the_whole(whole, bands):
    power = [np.full(band.count, 3.0 * band.gain) for band in bands for _ in range(3)]
    made = assembled(bands, power, 0, 1)
    assert made == pytest.approx(np.full(whole.n, 3.0))


def test_a_short_series_is_left_alone():
    view = view_of(60.0)
    assert split([view]) == (view,)


def test_a_hole_leaves_both_bands_without_it():
    hole = slice(8000, 8020)
    lower, upper = split([view_of(150.0, hole=hole)])
    assert upper.n == 29_980
    assert not upper.keep[hole].any()
    assert lower.keep.mean() == pytest.approx(1.0 - 20.0 / 30_000.0, abs=2e-4)
    assert np.isfinite(lower.residual).all()
    assert lower.residual.std() == pytest.approx(np.sqrt(lower.gain) * SIGMA, rel=0.1)


def test_a_reference_that_moves_fast_makes_the_lower_band_wider(bands):
    trace = make(Sensor.ACCEL, seconds=150.0, fs=200.0)
    shaken = trace.ideal + 5.0 * np.cos(2.0 * np.pi * 40.0 * trace.t)[:, None]
    noise = np.random.default_rng(1).normal(0.0, SIGMA, shaken.shape)
    trace = dataclasses.replace(trace, ideal=shaken, measured=shaken + noise, sigma=np.full(3, SIGMA))
    (view,) = views_of(GapProblem((trace,), ReferenceInfo(ReferenceKind.SIM), 150.0), {}, {})
    lower = split([view])[0]
    assert lower.fs > 80.0 > bands[0].fs
