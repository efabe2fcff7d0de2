from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.problem import ReferenceKind
from mavcal.calib.gap.reference import build
from mavcal.calib.gap.reference.noise import ResidualSpectrum
from mavcal.calib.gap.reference.simulator import denoised, error_sd, with_reference_error
from mavcal.calib.recording import Sensor

from .test_recorded import RATE, SECONDS, SIGMA, by_sensor, channel, flown, truth

T = np.arange(int(RATE * SECONDS)) / RATE
FORCE = truth(T)[0][Sensor.ACCEL]


def noisy(seed=0, sd=0.02, values=FORCE):
    return values + sd * np.random.default_rng(seed).standard_normal(values.shape)


def test_the_movement_is_kept_and_the_noise_is_not():
    found = denoised(channel(Sensor.ACCEL, T, noisy()))
    left = found.signal.values - FORCE
    assert left.std() < 0.4 * 0.02
    assert np.sqrt(found.noise.psd.min(axis=0)) == pytest.approx(0.02, rel=0.08)
    assert error_sd(found.noise) == pytest.approx(left.std(axis=0).max(), rel=0.5)


def shared(kept):
    """What a filter takes from readings, times their error: noise in a reference that a filter seems to explain."""
    fast = kept - np.apply_along_axis(np.convolve, 0, kept, np.ones(5) / 5.0, "same")
    return float(((kept - FORCE) * fast)[50:-50].sum())


def test_what_is_left_out_has_nothing_in_common_with_what_is_kept():
    raw = sum(shared(noisy(seed)) for seed in range(6))
    kept = sum(shared(denoised(channel(Sensor.ACCEL, T, noisy(seed))).signal.values) for seed in range(6))
    assert abs(kept) < 0.02 * raw


def test_a_line_among_noise_is_movement():
    swing = FORCE + 0.02 * np.sin(2 * np.pi * 17.3 * T)[:, None]
    kept = denoised(channel(Sensor.ACCEL, T, noisy(values=swing))).signal.values
    wave = np.exp(2j * np.pi * 17.3 * T)
    assert np.abs((kept - FORCE).T @ wave) * 2.0 / len(T) == pytest.approx(0.02, rel=0.25)


@pytest.mark.parametrize("sd", [0.0, 1e-9])
def test_readings_without_noise_stay_as_they_are(sd):
    found = denoised(channel(Sensor.ACCEL, T, noisy(sd=sd)))
    assert found is None or np.abs(found.signal.values - FORCE).max() < 1e-6


def test_noise_that_is_filtered_is_not_told_from_movement():
    shaped = np.apply_along_axis(np.convolve, 0, noisy(values=np.zeros_like(FORCE)), np.hanning(30) / 15.0, "same")
    assert denoised(channel(Sensor.ACCEL, T, FORCE + shaped)) is None


def test_a_hole_is_not_filled():
    rows = np.r_[0:800, 900 : len(T)]
    found = denoised(channel(Sensor.ACCEL, T[rows], noisy()[rows]))
    assert found.signal.t == pytest.approx(T[rows])
    assert (found.signal.values - FORCE[rows]).std() < 0.4 * 0.02


def test_noise_from_elsewhere_gets_the_error_of_the_reference():
    hz, count = np.array([1.0, 30.0]), np.array([100.0, 900.0])
    reference = ResidualSpectrum(hz, np.array([[2.0] * 3, [1.0] * 3]), count, 100.0)
    own = ResidualSpectrum(hz, np.full((2, 3), 5.0), count, 100.0)
    assert with_reference_error(own, reference).psd[:, 0] == pytest.approx([6.0, 5.0])


def test_a_simulators_readings_serve_without_their_noise_and_declare_it():
    problem = build(flown(reference=False), flown(seed=2, reference=False))
    assert problem.reference.kind is ReferenceKind.SIM
    trace = by_sensor(problem)[Sensor.ACCEL]
    assert trace.residual.std() == pytest.approx(SIGMA[Sensor.ACCEL], rel=0.15)
    assert trace.psd is not None
    assert trace.psd[0] == pytest.approx(2.0 * trace.psd[-1], rel=0.2)
    assert 0.0 < trace.ideal_sd < 0.5 * SIGMA[Sensor.ACCEL]


def test_noise_of_readings_of_another_rate_is_not_declared():
    sim = flown(seed=2, reference=False)
    slower = sim.with_channels(dataclasses.replace(c, t=c.t[::2], values=c.values[::2]) for c in sim.channels)
    trace = by_sensor(build(flown(reference=False), slower))[Sensor.ACCEL]
    assert trace.sigma is None
    assert trace.ideal_sd > 0.0
