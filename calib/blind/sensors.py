"""Sensors: from truth on the fine grid to logged numbers, and what an error of theirs is.

A sensor without error reads truth at the time stamp, plus white noise of its datasheet's density over the band of the
log, rounded to its step. An :class:`Effect` alters one of the stages, in the order in which nature applies them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.blind.missions import OVERSAMPLING, Rng, World

Array = NDArray[np.float64]
SENSORS = ("accel", "gyro", "mag")


class Order(IntEnum):
    """Where along the way from truth to number an effect acts."""

    PLACE = 0  # what is there at the sensor: field, lever arm, vibration
    AXES = 1  # orientation and orthogonality of the axes
    GAIN = 2
    OFFSET = 3
    TIME = 4  # filters and delays
    LIMIT = 5


@dataclass(frozen=True)
class Quality:
    """A sensor's noise (sd a sample), rounding step and rate relative to the log's."""

    sd: float
    step: float
    every: int = 1

    @property
    def variance(self) -> float:
        """Of one sample, rounding included: a uniform error of width `step`."""
        return self.sd**2 + self.step**2 / 12.0


Suite = Mapping[str, Quality]


@dataclass(frozen=True, eq=False)
class Effect:
    """An error of a sensor. The methods' defaults are a sensor that has none.

    Parameters
    ----------
    id, sensors
        Name as the report has it, and the sensors that it touches.
    truth
        Its parameters, in the report's units and forward sign.
    """

    id: str
    sensors: tuple[str, ...]
    truth: Mapping[str, float] = field(default_factory=dict, kw_only=True)
    order: Order = field(default=Order.OFFSET, kw_only=True)

    def mean(self, world: World, sensor: str, x: Array) -> Array:
        """The noise-free signal on the fine grid after this stage."""
        return x

    def noise(self, world: World, sensor: str, noise: Array, quality: Quality, rng: Rng) -> Array:
        """The noise at the log's samples after this stage."""
        return noise

    def finish(self, world: World, sensor: str, x: Array, rng: Rng) -> Array:
        """The samples as logged, before rounding."""
        return x

    def step(self, sensor: str, quality: Quality) -> float:
        """Rounding step."""
        return quality.step

    def information(self, world: World, sensor: str, quality: Quality) -> float:
        """Twice the Kullback-Leibler divergence that its random part adds; 0 where it has none."""
        return 0.0


def draw_suite(rng: Rng) -> dict[str, Quality]:
    """Consumer inertial sensors and magnetometers: datasheet densities over the log's band, 16 bit steps."""

    def log_uniform(low: float, high: float) -> float:
        return math.exp(rng.uniform(math.log(low), math.log(high)))

    return {
        "accel": Quality(log_uniform(0.015, 0.06), 9.80665 / 2048.0 * rng.choice([0.5, 1.0])),
        "gyro": Quality(log_uniform(0.0015, 0.006), math.radians(1.0 / 16.4) * rng.choice([0.5, 1.0])),
        "mag": Quality(log_uniform(0.25, 0.9), rng.choice([0.0, 0.15, 0.1]), int(rng.choice([1, 2, 4]))),
    }


def at_samples(x: Array, quality: Quality) -> Array:
    """The fine grid at the sensor's own samples."""
    return x[:: OVERSAMPLING * quality.every]


def mean_signal(world: World, sensor: str, effects: Sequence[Effect]) -> Array:
    """Noise-free signal at the fine grid with all effects, in nature's order."""
    x = world.truth(sensor)
    for effect in sorted(effects, key=lambda e: e.order):
        if sensor in effect.sensors:
            x = effect.mean(world, sensor, x)
    return x


def read_sensor(world: World, sensor: str, quality: Quality, effects: Sequence[Effect], rng: Rng) -> Array:
    """What the sensor logs, at its own samples."""
    own = [e for e in sorted(effects, key=lambda e: e.order) if sensor in e.sensors]
    x = at_samples(mean_signal(world, sensor, own), quality)
    noise = quality.sd * rng.standard_normal(x.shape)
    for effect in own:
        noise = effect.noise(world, sensor, noise, quality, rng)
    x = x + noise
    for effect in own:
        x = effect.finish(world, sensor, x, rng)
    step = max((effect.step(sensor, quality) for effect in own), default=quality.step)
    return rounded(x, step)


def rounded(x: Array, step: float) -> Array:
    """To the nearest multiple of `step`; 0 leaves it."""
    return x if step == 0.0 else step * np.round(x / step)
