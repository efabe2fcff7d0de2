"""Effects put into real recordings: what is injected is known, what the recording has of its own is not.

Sizes are counted against the recording's own sample-to-sample noise, so that lambda is a scale and no promise: a real
sensor's slow noise is larger than its fast one.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.blind.missions import Rng
from mavcal.calib.recording import Channel, Recording, Sensor

Array = NDArray[np.float64]
Inject = Callable[[Channel, float, Rng], Array]
"""``inject(channel, lambda, rng)``: the new values."""

SENSOR = {"accel": Sensor.ACCEL, "gyro": Sensor.GYRO, "mag": Sensor.MAG}


def fast_sd(channel: Channel) -> float:
    """Noise of a sample from the median difference of neighbours' differences; motion is slow beside it."""
    second = np.diff(channel.values, n=2, axis=0)
    return float(np.median(np.abs(second)) / 0.6745 / math.sqrt(6.0))


def _size(channel: Channel, shape: Array, severity: float) -> float:
    """Factor that gives `shape` that lambda."""
    return math.sqrt(severity / float(np.sum(shape**2))) * fast_sd(channel)


def _bias(channel: Channel, severity: float, rng: Rng) -> Array:
    shape = np.tile(rng.standard_normal(3), (len(channel), 1))
    return channel.values + _size(channel, shape, severity) * shape


def _scale(channel: Channel, severity: float, rng: Rng) -> Array:
    shape = channel.values * rng.standard_normal(3)
    return channel.values + _size(channel, shape, severity) * shape


def _step(channel: Channel, severity: float, rng: Rng) -> Array:
    at = int(rng.uniform(0.2, 0.8) * len(channel))
    shape = np.outer(np.arange(len(channel)) >= at, rng.standard_normal(3))
    return channel.values + _size(channel, shape, severity) * shape


def _noise(channel: Channel, severity: float, rng: Rng) -> Array:
    # For a small ratio r of variances the divergence is r^2 / 2 a value.
    extra = math.sqrt(2.0 * severity / channel.values.size)
    return channel.values + math.sqrt(extra) * fast_sd(channel) * rng.standard_normal(channel.values.shape)


def _hold(channel: Channel, severity: float, rng: Rng) -> Array:
    rows = rng.choice(np.arange(1, len(channel)), max(1, round(severity / 6.0)), replace=False)
    source = np.arange(len(channel))
    source[rows] = 0
    return channel.values[np.maximum.accumulate(source)]


KINDS: Mapping[str, Inject] = {
    "accel_bias": _bias,
    "gyro_bias": _bias,
    "mag_hard_iron": _bias,
    "accel_scale": _scale,
    "gyro_scale": _scale,
    "accel_step": _step,
    "gyro_step": _step,
    "mag_step": _step,
    "accel_noise": _noise,
    "gyro_noise": _noise,
    "gyro_hold": _hold,
}
LOWEST, HIGHEST = 1e3, 1e5


def injected(recording: Recording, kind: str, seed: int) -> tuple[Recording, dict[str, Any]]:
    """The recording with one effect, and its label."""
    rng = np.random.default_rng([seed, 9])
    severity = math.exp(rng.uniform(math.log(LOWEST), math.log(HIGHEST)))
    sensor = SENSOR[kind.partition("_")[0]]
    old = recording.channel(sensor)
    new = dataclasses.replace(old, values=KINDS[kind](old, severity, rng))
    label = {"effect": kind, "lambda_of_fast_noise": severity, "seed": seed}
    return recording.with_channels(new if c is old else c for c in recording.channels), label


def halves(recording: Recording) -> tuple[Recording, Recording]:
    """First and second half by time."""
    start, end = recording.span
    middle = 0.5 * (start + end)
    return recording.between(start, middle), recording.between(middle, end + 1.0)
