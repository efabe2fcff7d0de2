"""Ends of the range and dead bands that lie before the noise: recovered from the mean, and absent from plain noise."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.effects import forward_models
from mavcal.calib.gap.effects.limits import candidate_limits, candidate_widths
from mavcal.calib.gap.problem import Trace
from mavcal.calib.recording import Sensor

from .conftest import make
from .recovery import amplitudes, fitted, noisy

SIGMA = {Sensor.ACCEL: 0.05, Sensor.GYRO: 0.01, Sensor.MAG: 0.5}


def with_sigma(trace):
    return dataclasses.replace(trace, sigma=np.full(3, SIGMA[trace.sensor]))


def clipped(trace, limit):
    return np.maximum(np.minimum(trace.ideal, limit), -limit) - trace.ideal


def emptied(trace, width):
    change = -trace.ideal.copy()
    change[np.abs(trace.ideal) >= width] = 0.0
    return change


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("name", "limit"), [("accel_saturation", 9.0), ("gyro_saturation", 0.8), ("mag_saturation", 47.0)]
)
def test_an_end_of_the_range_is_recovered(name, limit, seed):
    trace = with_sigma(make(Sensor(name.split("_")[0]), fs=50.0))
    sigma = SIGMA[trace.sensor]
    found, _, _ = fitted(forward_models()[name][-1], noisy(trace, clipped(trace, limit), sigma, seed))
    beyond = int((np.abs(trace.ideal) > limit).sum())
    assert abs(found - limit) < 3.0 * sigma / np.sqrt(beyond)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("name", "width"), [("accel_dead_band", 0.4), ("gyro_dead_band", 0.05), ("mag_dead_band", 4.0)]
)
def test_a_dead_band_is_recovered(name, width, seed):
    trace = with_sigma(make(Sensor(name.split("_")[0]), fs=50.0))
    sigma = SIGMA[trace.sensor]
    found, _, _ = fitted(forward_models()[name][-1], noisy(trace, emptied(trace, width), sigma, seed))
    assert found == pytest.approx(width, rel=0.01)


@pytest.mark.parametrize("kind", ["saturation", "dead_band"])
@pytest.mark.parametrize("sensor", list(SIGMA))
def test_noise_shows_neither(sensor, kind):
    effect, sigma = forward_models()[f"{sensor}_{kind}"][-1], SIGMA[sensor]
    trace = with_sigma(make(sensor, fs=25.0))
    for seed in range(10):
        plain = noisy(trace, np.zeros(3), sigma, seed)
        level = float((plain.residual**2).sum())
        gains = [(level - amplitudes(effect, plain, theta)[2]) / sigma**2 for theta in effect.shape.grid(plain)]
        assert max(gains) < 12.0


@pytest.mark.parametrize("kind", ["saturation", "dead_band"])
@pytest.mark.parametrize("sensor", list(SIGMA))
def test_what_is_tried_reaches_from_hardly_seen_to_everything(sensor, kind):
    effect, sigma = forward_models()[f"{sensor}_{kind}"][-1], SIGMA[sensor]
    trace = with_sigma(make(sensor, fs=50.0))
    grid = effect.shape.grid(trace)
    assert (np.diff(grid) > 0.0).all()
    assert 5 <= len(grid) <= 26
    energy = [float((effect.columns(trace, theta) ** 2).sum()) / sigma**2 for theta in grid]
    assert min(energy) < 30.0
    assert max(energy) > 1e4
    assert 0.0 <= grid[0] <= grid[-1] <= np.abs(trace.ideal).max()


def test_the_noise_is_taken_from_the_trace_where_none_is_declared():
    effect = forward_models()["gyro_saturation"][-1]
    trace = noisy(make(Sensor.GYRO, fs=50.0), np.zeros(3), 0.01, 1)
    declared = effect.shape.grid(with_sigma(trace))
    assert effect.shape.grid(trace) == pytest.approx(declared, rel=0.1)


def test_where_nothing_moves_through_zero_there_is_no_dead_band():
    trace = make(Sensor.MAG, fs=25.0)
    away = dataclasses.replace(trace, ideal=60.0 + 0.1 * trace.ideal)
    assert "stays away from zero" in forward_models()["mag_dead_band"][-1].missing(away)[0]
    assert forward_models()["mag_dead_band"][-1].missing(trace) is None
    still = dataclasses.replace(trace, ideal=np.zeros_like(trace.ideal))
    assert forward_models()["mag_saturation"][-1].missing(still) is not None
    assert forward_models()["mag_dead_band"][-1].missing(still) is not None


def test_noise_of_the_reference_is_no_limit():
    rng = np.random.default_rng(3)
    n = 4000
    ideal = np.where(np.arange(n)[:, None] < n // 2, 0.0, rng.normal(size=(n, 3))) + 0.01 * rng.normal(size=(n, 3))
    trace = Trace(
        Sensor.GYRO, (0,), np.arange(n) / 100.0, ideal, ideal, np.ones(n, bool), sigma=np.full(3, 0.01), ideal_sd=0.01
    )
    assert candidate_widths(trace).min() > 0.05
    assert candidate_limits(trace).max() < np.abs(ideal).max() - 0.05


def test_noise_inside_the_reference_is_no_dead_band():
    """A reference that follows another unit has its noise: to set it to zero at rest would explain that noise."""
    trace = with_sigma(make(Sensor.GYRO, fs=50.0))
    noise = 1e-3 * np.random.default_rng(3).standard_normal(trace.ideal.shape)
    still = np.zeros_like(trace.ideal)
    still[len(still) // 2 :] = trace.ideal[len(still) // 2 :]
    exact = dataclasses.replace(trace, ideal=still + noise, measured=still, sigma=np.full(3, 1e-4))
    effect = forward_models()["gyro_dead_band"][-1]

    def gain(t):
        level = float((t.residual**2).sum())
        return max(level - amplitudes(effect, t, theta)[2] for theta in effect.shape.grid(t)) / level

    assert gain(exact) > 0.3
    blurred = dataclasses.replace(exact, unit_sd=1e-3)
    assert candidate_widths(blurred).min() > 5e-3
    assert gain(blurred) < 0.05
