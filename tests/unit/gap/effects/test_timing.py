"""Delay, low-pass and clock: against signals whose shifted and filtered forms are known in closed form."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import butter, freqs

from mavcal.calib.gap.effects import by_id
from mavcal.calib.recording import Sensor

from .conftest import make
from .recovery import amplitudes, fitted, noisy

F = np.array([0.7, 2.9, 7.3])
"""Hz, one wave an axis and a common one."""


def waves(t: np.ndarray, gain=lambda f: np.ones_like(f, dtype=complex)) -> np.ndarray:
    """Steady waves through `gain`, shape (N, 3)."""
    phase = np.exp(2j * np.pi * t[:, None] * F)
    return (gain(F) * phase).imag + 0.5 * np.real(gain(np.array([1.7])) * np.exp(2j * np.pi * 1.7 * t))[:, None]


def trace_of_waves(seconds: float = 60.0, fs: float = 100.0):
    trace = make(Sensor.GYRO, "hover", seconds=seconds, fs=fs)
    ideal = waves(trace.t)
    return dataclasses.replace(trace, ideal=ideal, measured=ideal.copy(), spin=np.gradient(ideal, trace.t, axis=0))


@pytest.mark.parametrize("delay", [0.0013, 0.02, -0.007, 0.11])
def test_a_delay_is_the_signal_at_an_earlier_time(delay):
    trace = trace_of_waves()
    expected = waves(trace.t - delay) - trace.ideal
    inner = slice(50, -50)
    column = by_id()["gyro_delay"].columns(trace, delay)[0]
    np.testing.assert_allclose(column[inner], expected[inner], atol=2e-4)
    found, _, _ = fitted(by_id()["gyro_delay"], noisy(trace, expected, 0.05, 1))
    assert found == pytest.approx(delay, abs=1e-4)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cutoff", [4.0, 15.0])
def test_a_low_pass_of_one_pole_or_two_is_recovered(order, cutoff):
    trace = trace_of_waves()
    b, a = butter(order, 2 * np.pi * cutoff, analog=True)
    change = waves(trace.t, lambda f: freqs(b, a, 2 * np.pi * f)[1]) - trace.ideal
    change[:100] = 0.0
    measured = noisy(trace, change, 0.02, 2)
    measured = dataclasses.replace(measured, observed=trace.t > 1.0)
    effect = by_id()["gyro_low_pass"]
    found, _, _ = fitted(effect, measured)
    assert found == pytest.approx(cutoff, rel=0.03)
    omega = np.pi * np.arange(1000) / 1000
    expected = np.abs(freqs(b, a, omega * trace.fs)[1]) ** 2
    same, faster = effect.noise_gain(measured, omega, cutoff)
    np.testing.assert_allclose(same, expected, atol=1e-6)
    aliases = [omega + 2.0 * np.pi * k for k in range(-60, 61)]
    folded = sum(np.abs(freqs(b, a, np.abs(w) * trace.fs)[1]) ** 2 for w in aliases)
    np.testing.assert_allclose(faster / faster[0], folded / folded[0], atol=2e-3)


@pytest.mark.parametrize("ppm", [150.0, -2000.0])
def test_a_clock_that_drifts_is_recovered(ppm):
    trace = trace_of_waves()
    change = waves(trace.t * (1.0 - 1e-6 * ppm)) - trace.ideal
    found, _, _ = fitted(by_id()["clock_drift"], noisy(trace, change, 0.05, 3))
    assert found == pytest.approx(ppm, abs=5.0)


def test_delay_and_low_pass_are_told_apart():
    trace = trace_of_waves()
    late = noisy(trace, waves(trace.t - 0.02) - trace.ideal, 0.02, 4)
    delay, low_pass = by_id()["gyro_delay"], by_id()["gyro_low_pass"]
    left = [amplitudes(e, late, fitted(e, late)[0])[2] for e in (delay, low_pass)]
    assert left[0] < 0.9 * left[1]


@pytest.mark.parametrize("effect_id", ["gyro_delay", "accel_delay", "mag_low_pass", "clock_drift"])
def test_rest_shows_no_timing(effect_id):
    effect = by_id()[effect_id]
    sensor = effect.sensor
    lack = effect.missing(make(sensor, "static"))
    assert lack is not None
    assert "changes by" in lack[0]
    assert effect.missing(make(sensor, "tumble")) is None


def test_the_clock_is_judged_by_the_turning_alone():
    trace = make(Sensor.MAG, "tumble")
    assert by_id()["clock_drift"].missing(dataclasses.replace(trace, ideal=np.ones_like(trace.ideal))) is None


def test_a_reference_made_from_the_recording_has_its_clock():
    trace = trace_of_waves()
    effect = by_id()["clock_drift"]
    assert effect.missing(trace) is None
    assert effect.missing(dataclasses.replace(trace, rate_known=False)) is not None


@pytest.mark.parametrize(("effect_id", "theta"), [("gyro_delay", 0.008), ("gyro_low_pass", 25.0)])
def test_a_recording_that_begins_in_the_midst_of_a_movement_has_no_jump_at_its_ends(effect_id, theta):
    """What an end changes of one sample is spread over all frequencies, where nothing else moves."""
    trace = trace_of_waves()
    column = by_id()[effect_id].columns(trace, theta)[0]
    b, a = butter(1, 2 * np.pi * theta, analog=True)
    late = waves(trace.t - theta), waves(trace.t, lambda f: freqs(b, a, 2 * np.pi * f)[1])
    expected = late[effect_id == "gyro_low_pass"] - trace.ideal
    off = np.abs(column - expected)
    assert off[:3].max() < 0.1 * np.abs(expected).max()
    assert off[-3:].max() < 0.1 * np.abs(expected).max()
