"""The air of a day: steady wind, Dryden turbulence and single gusts, where the vehicle is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import bilinear, lfilter

Array = NDArray[np.float64]
Rng = np.random.Generator

LOW_LEVEL_FT = 30.0
"""Height at which the scales of turbulence are taken. Chosen, not measured: 9 m, the middle of a mission."""
FOOT = 0.3048
LEAST_PASSING = 3.0
"""m/s. Turbulence is carried past by the wind and crossed by the vehicle; this is the vehicle's part. Chosen, not
measured: about the mean speed of a mission."""


@dataclass(frozen=True)
class Gust:
    """One discrete gust of the form 1 - cosine (MIL-F-8785C 3.7.3): begins at `t`, lasts `length` s, peaks at `peak`.

    `peak` is north, east, down in m/s.
    """

    t: float
    length: float
    peak: tuple[float, float, float]


@dataclass(frozen=True)
class Weather:
    """Where the air moves to, m/s north and east; standard deviation of horizontal turbulence, m/s; gusts."""

    north: float
    east: float
    turbulence: float
    gusts: tuple[Gust, ...] = ()

    @property
    def speed(self) -> float:
        """m/s."""
        return math.hypot(self.north, self.east)


def air_over_time(weather: Weather, t: Array, rng: Rng) -> Array:
    """Velocity of the air at the vehicle, north east down, (N, 3) at evenly spaced `t`."""
    along = np.array([weather.north, weather.east, 0.0])
    direction = along / weather.speed if weather.speed > 0.0 else np.array([1.0, 0.0, 0.0])
    across = np.array([-direction[1], direction[0], 0.0])
    u, v, w = dryden(weather, len(t), float(t[1] - t[0]), rng).T
    out: Array = along + u[:, None] * direction + v[:, None] * across
    out[:, 2] += w
    for gust in weather.gusts:
        phase = np.clip((t - gust.t) / gust.length, 0.0, 1.0)
        out += 0.5 * (1.0 - np.cos(2.0 * np.pi * phase))[:, None] * np.array(gust.peak)
    return out


def scales(height_ft: float = LOW_LEVEL_FT) -> tuple[float, float, float]:
    """Of turbulence below 1000 ft (MIL-F-8785C 3.7.2.1): horizontal and vertical length, m, and ratio of deviations.

    The ratio is vertical over horizontal.
    """
    base = 0.177 + 0.000823 * height_ft
    return height_ft / base**1.2 * FOOT, height_ft * FOOT, base**0.4


def dryden(weather: Weather, count: int, dt: float, rng: Rng) -> Array:
    """Turbulence along the wind, across it and down, (count, 3): white noise through Dryden's forming filters.

    The vehicle's own speed changes the passing frequency only by its mean, so that the filters are constant.
    """
    if weather.turbulence == 0.0:
        return np.zeros((count, 3))
    # Twice as long, so that what is kept of it is stationary.
    noise = rng.standard_normal((2 * count, 3)) / math.sqrt(dt)
    speed = math.hypot(weather.speed, LEAST_PASSING)
    horizontal, vertical, ratio = scales()
    sigma = weather.turbulence
    along = _passed(noise[:, 0], *_longitudinal(sigma, horizontal / speed), dt)
    across = _passed(noise[:, 1], *_transverse(sigma, horizontal / speed), dt)
    down = _passed(noise[:, 2], *_transverse(ratio * sigma, vertical / speed), dt)
    return np.column_stack([along, across, down])[count:]


def _longitudinal(sigma: float, tau: float) -> tuple[list[float], list[float]]:
    """Numerator and denominator in s for unit white noise: variance `sigma` squared."""
    return [sigma * math.sqrt(2.0 * tau)], [tau, 1.0]


def _transverse(sigma: float, tau: float) -> tuple[list[float], list[float]]:
    gain = sigma * math.sqrt(tau)
    return [gain * math.sqrt(3.0) * tau, gain], [tau * tau, 2.0 * tau, 1.0]


def _passed(noise: Array, numerator: list[float], denominator: list[float], dt: float) -> Array:
    b, a = bilinear(numerator, denominator, 1.0 / dt)
    out: Array = lfilter(b, a, noise)
    return out
