"""Noise that goes with the motors, and flights that use them more or less."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.reference.expected_noise import motor_noise_of, with_motor_noise
from mavcal.calib.recording import Sensor

QUIET, LOUD, THROTTLE = 0.002, 0.02, 0.6


def pair(flying, seed=0, loud=LOUD, **over):
    """Two accelerometers against each other; for the part `flying` of the time the motors run."""
    rng = np.random.default_rng(seed)
    n = 3000
    t = np.arange(n) / 25.0
    throttle = np.where(np.arange(n) < flying * n, THROTTLE, 0.0)
    sd = np.sqrt(QUIET**2 + (loud * throttle) ** 2)[:, None]
    ideal = np.tile([0.0, 0.0, -9.8], (n, 1))
    seen = np.ones(n, dtype=bool)
    measured = ideal + sd * rng.standard_normal((n, 3))
    return Trace(Sensor.ACCEL, (1,), t, measured, ideal, seen, against=0, throttle=throttle, **over)


def test_noise_that_follows_the_motors_is_learned():
    found = motor_noise_of([pair(0.3)])[Sensor.ACCEL]
    assert np.sqrt(found.variance) == pytest.approx([LOUD] * 3, rel=0.1)
    assert found.power == pytest.approx(0.3 * THROTTLE**2, rel=0.01)


def test_steady_noise_follows_nothing():
    assert not any(motor_noise_of([pair(0.3, s, loud=0.0)])[Sensor.ACCEL].variance.any() for s in range(20))
    assert motor_noise_of([dataclasses.replace(pair(0.3), throttle=None)]) == {}


def test_a_flight_that_flies_longer_is_expected_to_be_louder():
    found = motor_noise_of([pair(0.2)])
    sigma = np.full(3, np.sqrt(QUIET**2 + 0.2 * (LOUD * THROTTLE) ** 2))
    longer = with_motor_noise(pair(0.9, sigma=sigma), found)
    assert longer.sigma == pytest.approx(np.std(longer.residual, axis=0), rel=0.05)
    assert longer.psd == pytest.approx(np.tile(longer.sigma**2, (2, 1)))
    shorter = with_motor_noise(pair(0.1, sigma=sigma), found)
    assert shorter.sigma is sigma


def test_one_sensor_alone_has_half_of_the_noise_of_a_difference():
    found = motor_noise_of([pair(0.2)])
    alone = with_motor_noise(dataclasses.replace(pair(0.9, sigma=np.full(3, QUIET)), against=None), found)
    both = with_motor_noise(pair(0.9, sigma=np.full(3, QUIET)), found)
    assert alone.sigma**2 - QUIET**2 == pytest.approx(0.5 * (both.sigma**2 - QUIET**2))
