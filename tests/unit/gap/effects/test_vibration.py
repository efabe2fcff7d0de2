"""Lines, aliases, rotor noise, rectification and tones against waves that are made here."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.fft import dct

from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.effects.vibration import folded
from mavcal.calib.recording import Sensor

from .conftest import make
from .recovery import amplitudes, fitted, noisy


def _spectrum(values):
    return dct(values, axis=0, norm="ortho") ** 2


def _omega(trace):
    return np.pi * np.arange(len(trace.t)) / len(trace.t)


@pytest.mark.parametrize("f", [13.0, 50.0, 87.0, 100.0, 163.0, 350.0])
def test_folding_is_what_sampling_does(f):
    n, fs = 1000, 100.0
    power = np.abs(np.fft.rfft(np.cos(2 * np.pi * f * np.arange(n) / fs + 0.3)))
    assert folded(np.array([f]), fs)[0] == pytest.approx(np.argmax(power) * fs / n)


@pytest.mark.parametrize(("kind", "harmonic"), [("vibration", 1), ("aliasing", 2)])
def test_a_line_that_follows_the_rotors_has_its_power_where_the_density_says(kind, harmonic):
    trace = make(Sensor.ACCEL, fs=200.0)
    rotor = trace.rotor_hz * 1.6
    rotor[:, 1:] = rotor[:, :1]
    trace = dataclasses.replace(trace, rotor_hz=rotor)
    phase = 2 * np.pi * np.cumsum(harmonic * rotor[:, 0]) / trace.fs
    size = (rotor[:, 0] / rotor[rotor > 5].mean()) ** 2
    y = 3.0 * size * np.cos(phase)
    effect = by_id()[f"accel_{kind}"]
    theta = harmonic * rotor[rotor > 5].mean()
    grid = effect.shape.grid(trace)
    assert np.abs(grid - theta).min() < 1e-6
    assert effect.missing(trace) is None
    density = effect.density(trace, _omega(trace), theta)[0]
    power = _spectrum(y)
    assert density.sum() * 9.0 == pytest.approx(power.sum(), rel=0.1)
    assert power[density > 0.02 * density.max()].sum() > 0.9 * power.sum()
    assert (density > 0.02 * density.max()).mean() < 0.35
    follow = effect.variance(trace)
    assert follow.mean() == pytest.approx(1.0)
    assert follow[rotor[:, 0] == 0.0].max() == 0.0


def test_without_rotor_speeds_a_line_is_found_at_its_frequency_while_the_motors_run():
    trace = dataclasses.replace(make(Sensor.ACCEL, fs=400.0), rotor_hz=None)
    on = trace.throttle > 0.05
    y = np.where(on, 4.0 * np.sin(2 * np.pi * 87.0 * trace.t), 0.0)[:, None] * [1.0, 0.5, 0.0]
    effect = by_id()["accel_vibration"]
    found = effect.shape.screen(trace, noisy(trace, y, 0.01, 1).residual)
    assert np.abs(found - 87.0).min() <= 0.5
    theta = found[np.argmin(np.abs(found - 87.0))]
    density = effect.density(trace, _omega(trace), theta)[0]
    power = _spectrum(y)
    assert power[:, 0].sum() / density.sum() == pytest.approx(16.0, rel=0.03)
    assert power[density > 0.0, 0].sum() > 0.97 * power[:, 0].sum()


def test_rotors_beyond_half_the_rate_are_aliases_and_not_vibration():
    trace = make(Sensor.GYRO, fs=100.0)
    fast = dataclasses.replace(trace, rotor_hz=trace.rotor_hz * 3.0)
    assert "beyond half the sampling rate, 50 Hz" in by_id()["gyro_vibration"].missing(fast)[0]
    assert by_id()["gyro_aliasing"].missing(fast) is None
    slow = dataclasses.replace(trace, rotor_hz=trace.rotor_hz * 0.15)
    assert "lie below" in by_id()["gyro_aliasing"].missing(slow)[0]
    unknown = dataclasses.replace(trace, rotor_hz=None)
    assert by_id()["gyro_aliasing"].missing(unknown)[0] == "no rotor speed recorded"
    assert by_id()["gyro_vibration"].missing(unknown) is None
    nothing = dataclasses.replace(unknown, throttle=None)
    assert "throttle" in by_id()["gyro_vibration"].missing(nothing)[0]


def test_rotor_noise_follows_the_speed_in_time():
    trace = make(Sensor.GYRO)
    effect = by_id()["gyro_rotor_noise"]
    speed = trace.rotor_hz.mean(axis=1)
    size = 0.02 * (speed / speed.max()) ** 2
    y = np.random.default_rng(3).normal(size=trace.ideal.shape) * size[:, None]
    model = effect.variance(trace) * effect.density(trace, _omega(trace), np.nan)[0].mean()
    fit = (model @ (y**2).mean(axis=1)) / (model @ model)
    assert fit == pytest.approx((size**2).mean() / trace.fs, rel=0.05)
    assert effect.missing(trace) is None
    steady = dataclasses.replace(trace, rotor_hz=np.full_like(trace.rotor_hz, 80.0))
    assert "varies by 0 %" in effect.missing(steady)[0]


def test_rectification_is_recovered_with_the_rotors_power():
    trace = make(Sensor.ACCEL)
    power = (trace.rotor_hz**4).mean(axis=1)
    truth = np.array([0.02, -0.05, 0.1])
    change = np.outer(power / power.max(), truth)
    beta, sd, _ = amplitudes(by_id()["accel_vibration_rectification"], noisy(trace, change, 0.02, 4), np.nan)
    assert (np.abs(beta - truth) < 4.0 * 0.02 * sd).all()


@pytest.mark.parametrize("f", [0.4231, 3.337, 41.0])
def test_a_tone_is_found_and_its_frequency_refined(f):
    trace = make(Sensor.MAG)
    wave = 2 * np.pi * f * trace.t
    change = np.outer(np.cos(wave), [0.2, 0.0, -0.1]) + np.outer(np.sin(wave), [0.0, 0.3, 0.1])
    found, beta, sd = fitted(by_id()["mag_tone"], noisy(trace, change, 0.2, 5))
    assert found == pytest.approx(f, abs=1e-3)
    assert (np.abs(beta - [0.2, 0.0, -0.1, 0.0, 0.3, 0.1]) < 6.0 * 0.2 * sd).all()
