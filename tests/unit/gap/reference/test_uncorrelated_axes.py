from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.reference.align import uncorrelated_axes
from mavcal.calib.gap.reference.checks import refusal_of
from mavcal.calib.recording import Sensor

FS, N = 100.0, 6000


def swaying(seed=0, lowest=0.2):
    rng = np.random.default_rng(seed)
    t = np.arange(N) / FS
    waves = [
        rng.normal(size=3) * np.sin(2 * np.pi * f * t[:, None] + rng.uniform(0, 6, 3))
        for f in lowest * (1 + np.arange(5))
    ]
    return 2.0 * np.sum(waves, axis=0) + np.array([0.0, 0.0, -9.8])


def trace(measured, ideal, sensor=Sensor.ACCEL, **over):
    return Trace(sensor, (0,), np.arange(N) / FS, measured, ideal, np.ones(N, dtype=bool), **over)


def noise(sd, seed=1):
    return sd * np.random.default_rng(seed).standard_normal((N, 3))


def test_a_sensor_of_another_movement_is_refused_by_its_axes():
    ideal = swaying()
    measured = ideal + noise(0.05)
    measured[:, 1] = noise(0.05)[:, 1]
    assert uncorrelated_axes(trace(measured, ideal), 0.3).tolist() == [False, True, False]
    assert "on y" in refusal_of(trace(measured, ideal))[1]


def test_a_reference_that_wanders_is_no_movement():
    wandering = np.cumsum(noise(0.2, 3), axis=0)
    assert uncorrelated_axes(trace(swaying() + noise(0.05), wandering), 0.3).all()


@pytest.mark.parametrize("gap", ["shakes", "late", "small", "still"])
def test_poor_sensors_still_follow(gap):
    ideal = swaying()
    t = np.arange(N)[:, None] / FS
    measured = {
        "shakes": ideal + 20.0 * np.sin(2 * np.pi * 31.0 * t),
        "late": np.roll(ideal, 40, axis=0),
        "small": 0.4 * ideal,
        "still": ideal + noise(0.05),
    }[gap]
    moves = 100.0 if gap == "still" else 0.3
    assert not uncorrelated_axes(trace(measured + noise(0.05), ideal), moves).any()


def test_exchanged_axes_are_another_matter():
    ideal = swaying()
    assert not uncorrelated_axes(trace(ideal[:, [1, 0, 2]] + noise(0.05), ideal), 0.3).any()


def test_single_damaged_rows_are_no_noise():
    ideal = swaying()
    measured = ideal + noise(0.05)
    assert refusal_of(trace(measured, ideal)) is None
    measured[[70, 3000]] += 1e4
    assert "2 such rows" in refusal_of(trace(measured, ideal))[1]
