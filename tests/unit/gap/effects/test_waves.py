"""Waves that follow one rotor's angle, against waves that are made here; and that noise shows none."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.effects import catalogue
from mavcal.calib.recording import Sensor

from .conftest import make
from .recovery import amplitudes, noisy

WAVES = {e.id: e for e in catalogue() if e.form == "~wave"}
SIGMA = {Sensor.ACCEL: 0.3, Sensor.GYRO: 0.02}


def wave(trace, rotor, order, lead):
    """A wave of amplitude one at the mean speed; integrated by a sum of trapezoids over half samples."""
    speed = trace.rotor_hz[:, rotor - 1]
    fine = np.interp(np.arange(2 * len(speed) - 1) / 2.0, np.arange(len(speed)), speed)
    turns = np.append(0.0, np.cumsum(0.5 * (fine[1:] + fine[:-1])))[::2] / (2.0 * trace.fs)
    return (speed / speed.mean()) ** 2 * np.cos(2.0 * np.pi * order * turns + lead)


def best(effect, trace):
    grid = effect.shape.grid(trace)
    left = [amplitudes(effect, trace, theta)[2] for theta in grid]
    return float(grid[int(np.argmin(left))])


@pytest.mark.parametrize(("kind", "rotor", "order"), [("vibration", 1, 1), ("vibration", 3, 2), ("aliasing", 2, 4)])
@pytest.mark.parametrize("sensor", list(SIGMA))
@pytest.mark.parametrize("seed", range(2))
def test_order_and_amplitude_are_recovered(sensor, kind, rotor, order, seed):
    trace, sigma, effect = make(sensor, fs=200.0, seconds=30.0), SIGMA[sensor], WAVES[f"{sensor}_{kind}"]
    size, lead = np.array([0.5, -0.2, 0.1]) * sigma, 0.7
    found = noisy(trace, np.outer(wave(trace, rotor, order, lead), size), sigma, seed)
    theta = best(effect, found)
    assert theta == 100.0 * rotor + order
    beta, sd, _ = amplitudes(effect, found, theta)
    truth = np.concatenate([size * np.cos(lead), -size * np.sin(lead)])
    assert (np.abs(beta - truth) < 3.5 * sigma * sd).all()


@pytest.mark.parametrize("name", list(WAVES))
def test_noise_shows_no_wave(name):
    effect = WAVES[name]
    sigma = SIGMA[effect.sensor]
    trace = make(effect.sensor, fs=100.0, seconds=20.0)
    for seed in range(8):
        plain = noisy(trace, np.zeros(3), sigma, seed)
        level = float((plain.residual**2).sum())
        grid = effect.shape.grid(plain)
        gains = [(level - amplitudes(effect, plain, theta)[2]) / sigma**2 for theta in grid]
        assert max(gains) < 6.0 + 2.0 * np.log(len(grid)) + 4.0 * np.sqrt(12.0)


def test_every_rotor_has_its_orders_and_none_is_on_both_sides_of_half_the_rate():
    trace = make(Sensor.ACCEL, fs=200.0)
    shown, folded = (WAVES[f"accel_{kind}"].shape.grid(trace) for kind in ("vibration", "aliasing"))
    assert {int(v) // 100 for v in shown} == {1, 2, 3, 4}
    assert not set(shown) & set(folded)
    for rotor_order in (*shown, *folded):
        rotor, order = divmod(int(rotor_order), 100)
        speed = trace.rotor_hz[:, rotor - 1]
        assert (order * speed[speed > 5.0].mean() < 100.0) == (rotor_order in shown)


def test_without_a_recorded_speed_or_with_rotors_at_rest_there_is_no_wave():
    trace = make(Sensor.GYRO)
    unknown = dataclasses.replace(trace, rotor_hz=None)
    still = dataclasses.replace(trace, rotor_hz=np.zeros_like(trace.rotor_hz))
    for kind in ("vibration", "aliasing"):
        assert WAVES[f"gyro_{kind}"].missing(unknown)[0] == "no rotor speed recorded"
        assert WAVES[f"gyro_{kind}"].missing(still) is not None


def test_what_the_firmwares_filter_takes_is_taken():
    trace = make(Sensor.ACCEL, fs=200.0)
    effect = WAVES["accel_vibration"]
    bare = effect.signals(trace, 101.0)
    behind = effect.signals(dataclasses.replace(trace, low_pass_hz=20.0), 101.0)
    ratio = trace.rotor_hz[:, 0].mean() / 20.0
    gain = 1.0 / np.sqrt(1.0 + ratio**4)
    assert (behind**2).sum() == pytest.approx(gain**2 * (bare**2).sum(), rel=1e-6)
