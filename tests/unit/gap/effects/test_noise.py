"""Spectra against the noise that the project's own simulation makes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import dct

from mavcal.calib.gap.effects import by_id
from mavcal.calib.recording import Sensor
from mavcal.calib.simulate import noise

from .conftest import make

N = 7000
OMEGA = np.pi * np.arange(N) / N


@pytest.mark.parametrize(
    ("kind", "made", "tolerance"),
    [
        ("noise", lambda rng, size, fs: noise.white(rng, N, size, fs), 0.05),
        ("flicker", lambda rng, size, fs: noise.flicker(rng, N, size), 0.05),
        ("random_walk", lambda rng, size, fs: noise.random_walk(rng, N, size, fs), 0.15),
    ],
)
def test_the_power_in_each_octave_is_the_densitys(kind, made, tolerance):
    trace = make(Sensor.ACCEL, "static")
    size, rng = np.array([0.5, 1.0, 2.0]), np.random.default_rng(11)
    power = sum(dct(made(rng, size, trace.fs), axis=0, norm="ortho") ** 2 for _ in range(20)) / 20.0
    density = by_id()[f"accel_{kind}"].density(trace, OMEGA, np.nan)[0]
    # A walk and flicker that begin at zero differ from stationary ones in the lowest bins.
    for low, high in ((64, 256), (256, 1024), (1024, N // 2)):
        measured = (power[low:high] / density[low:high, None]).mean(axis=0)
        np.testing.assert_allclose(measured, size**2, rtol=tolerance)


def test_amplitudes_are_named_per_axis_and_squared():
    for kind, name, unit in (
        ("noise", "density", "uT/sqrt(Hz)"),
        ("flicker", "instability", "uT"),
        ("random_walk", "random_walk", "uT*sqrt(Hz)"),
    ):
        parameters = by_id()[f"mag_{kind}"].parameters
        assert [p.name for p in parameters] == [f"{name}.{axis}" for axis in "xyz"]
        assert all(p.squared and p.unit == unit for p in parameters)


def test_the_lowest_bin_is_finite_and_seconds_are_too_short():
    trace = make(Sensor.GYRO, "static", seconds=10.0)
    for kind in ("flicker", "random_walk"):
        effect = by_id()[f"gyro_{kind}"]
        assert np.isfinite(effect.density(trace, OMEGA, np.nan)).all()
        assert effect.missing(trace)[0] == "10 s of data"
        assert effect.missing(make(Sensor.GYRO, "static")) is None
