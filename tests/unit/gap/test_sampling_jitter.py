"""A tone that goes with the rate of change is jitter of the sampling; a vibration is there whatever happens."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap.sampling_jitter import is_sampling_jitter
from mavcal.calib.gap.schema import EffectEstimate
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from tests.unit.gap.export.making import effect

T = np.arange(0.0, 60.0, 0.0025)
HZ = 80.0
TURNS = np.column_stack([np.sin(5.0 * T), 0.4 * np.cos(3.0 * T), 0.2 * np.sin(0.6 * T)])


def recording(*units: np.ndarray) -> Recording:
    rng = np.random.default_rng(1)
    noisy = (values + 1e-3 * rng.normal(size=values.shape) for values in units)
    return Recording(
        tuple(Channel(Sensor.GYRO, k, T, values, "rad/s", Stage.FILTERED, "IMU") for k, values in enumerate(noisy))
    )


def tone(*instances: int) -> EffectEstimate:
    return effect("gyro_vibration", instances=instances, amplitude=(3e-3, 3e-3, 3e-3), frequency_hz=HZ)


def late(swing_s: float = 5e-4) -> np.ndarray:
    """Turns that are read up to `swing_s` early or late, 80 times a second."""
    moment = T + swing_s * np.sin(2.0 * np.pi * HZ * T)
    return np.column_stack([np.interp(moment, T, TURNS[:, axis]) for axis in range(3)])


def shaken(size: float = 3e-3) -> np.ndarray:
    return TURNS + size * np.sin(2.0 * np.pi * HZ * T)[:, None]


def test_a_tone_that_goes_with_the_rate_of_change_is_jitter() -> None:
    """Unit 2 of ArduPilot's simulator, sampled at 760 Hz, had a vibration of 80 Hz in every livelier flight."""
    assert is_sampling_jitter(tone(2), recording(TURNS, late()))


@pytest.mark.parametrize("instances", [(1,), (1, 2)])
def test_a_vibration_is_none(instances: tuple[int, ...]) -> None:
    assert not is_sampling_jitter(tone(*instances), recording(shaken(), shaken()))


def test_both_units_must_have_it() -> None:
    assert not is_sampling_jitter(tone(1, 2), recording(shaken(), late()))


def test_an_effect_without_a_frequency_is_none() -> None:
    assert not is_sampling_jitter(effect("gyro_scale"), recording(late()))


@pytest.mark.parametrize("rows", [slice(0, 0), slice(0, 10), slice(0, 200)])
def test_a_short_recording_says_nothing(rows: slice) -> None:
    whole = recording(TURNS, late()).channel(Sensor.GYRO, 1)
    short = Channel(Sensor.GYRO, 1, whole.t[rows], whole.values[rows], "rad/s", Stage.FILTERED, "IMU")
    assert not is_sampling_jitter(tone(2), Recording((short,)))


def test_samples_that_are_missing_are_left_out() -> None:
    damaged = late()
    damaged[4000:4010] = np.nan
    assert is_sampling_jitter(tone(2), recording(TURNS, damaged))
