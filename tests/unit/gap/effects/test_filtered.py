"""Amplitudes are the sensor's: what the firmware's own filter took before the log is added again."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.fft import dct
from scipy.signal import butter, lfilter

from mavcal.calib.gap.effects import by_id
from mavcal.calib.recording import Sensor

from .conftest import make
from .recovery import amplitudes, noisy

CUTOFF = 20.0
OVER = 8


def _logged(values: np.ndarray, fs: float) -> np.ndarray:
    """Samples of a filter that runs at eight times the rate of the log."""
    b, a = butter(2, CUTOFF, fs=OVER * fs)
    return lfilter(b, a, values, axis=0)[OVER - 1 :: OVER]


@pytest.fixture
def trace():
    return dataclasses.replace(make(Sensor.ACCEL, fs=200.0, seconds=40.0), low_pass_hz=CUTOFF, rotor_hz=None)


def _fine(trace):
    return np.repeat(trace.t, OVER) + np.tile((np.arange(OVER) - OVER + 1) / (OVER * trace.fs), len(trace.t))


def test_a_vibration_has_its_amplitude_before_the_filter(trace):
    fine = _fine(trace)
    on = np.repeat(trace.throttle > 0.05, OVER)
    power = dct(_logged(np.where(on, 4.0 * np.sin(2 * np.pi * 71.0 * fine), 0.0), trace.fs), norm="ortho") ** 2
    omega = np.pi * np.arange(len(power)) / len(power)
    density = by_id()["accel_vibration"].density(trace, omega, 71.0)[0]
    assert np.sqrt(power.sum() / density.sum()) == pytest.approx(4.0, rel=0.04)


def test_a_tone_has_its_amplitude_and_phase_before_the_filter(trace):
    logged = _logged(np.cos(2 * np.pi * 31.0 * _fine(trace))[:, None] * [2.0, 0.0, 1.0], trace.fs)
    beta, _, _ = amplitudes(by_id()["accel_tone"], noisy(trace, logged, 1e-3, 1), 31.0)
    np.testing.assert_allclose(beta, [2.0, 0.0, 1.0, 0.0, 0.0, 0.0], atol=0.03)


def test_white_noise_has_its_density_before_the_filter(trace):
    size = 0.01 * np.sqrt(OVER * trace.fs)
    y = _logged(np.random.default_rng(4).normal(0.0, size, (OVER * len(trace.t), 3)), trace.fs)
    power = dct(y, axis=0, norm="ortho") ** 2
    omega = np.pi * np.arange(len(power)) / len(power)
    density = by_id()["accel_noise"].density(trace, omega, np.nan)[0]
    inside = slice(10, len(power) * 6 // 10)
    ratio = np.sqrt((power[inside] / density[inside, None]).mean(axis=0))
    np.testing.assert_allclose(ratio, 0.01, rtol=0.05)
