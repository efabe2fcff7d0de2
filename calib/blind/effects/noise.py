"""Random errors by their Allan and spectral forms (IEEE Std 952): white, random walk of the rate, bias instability."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.blind.effects.kind import Kind, Louder, Make
from mavcal.calib.blind.missions import LOG_RATE, Rng, World
from mavcal.calib.blind.sensors import SENSORS, Effect, Quality, Suite
from mavcal.calib.blind.severity import divergence

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Drift(Effect):
    """A stationary or wandering addition of given spectrum on each axis.

    ``size`` is in units of the sensor's own noise: the spectrum is ``size^2 variance shape(w)``.
    """

    size: float
    axes: Array  # weight of each axis
    flicker: bool

    def _shape(self, n: int) -> Array:
        """Spectrum at the bins w = pi k / n, k = 1 .. n-1, per sample."""
        w = np.pi * np.arange(1, n) / n
        return np.asarray(1.0 / w if self.flicker else 1.0 / (4.0 * np.sin(0.5 * w) ** 2))

    def noise(self, world: World, sensor: str, noise: Array, quality: Quality, rng: Rng) -> Array:
        """Noise plus drift."""
        n = len(noise)
        sd = self.size * math.sqrt(quality.variance)
        if not self.flicker:
            return np.asarray(noise + sd * self.axes * np.cumsum(rng.standard_normal((n, 3)), axis=0))
        # Twice as long and cut, so that the record is no period of itself.
        w = 2.0 * np.pi * np.arange(1, n + 1) / (2 * n)
        spectrum = (rng.standard_normal((n, 3)) + 1j * rng.standard_normal((n, 3))) / np.sqrt(2.0 * w)[:, None]
        drift = np.fft.irfft(np.vstack([np.zeros((1, 3)), spectrum]), n=2 * n, axis=0)[:n] * math.sqrt(2 * n)
        return np.asarray(noise + sd * self.axes * drift)

    def information(self, world: World, sensor: str, quality: Quality) -> float:
        """Divergence by Whittle's spectrum."""
        shape = self._shape(len(range(0, len(world.t), 8 * quality.every)))
        return sum(divergence(1.0 + (self.size * a) ** 2 * shape) for a in self.axes)


def _axes(rng: Rng) -> Array:
    """All alike, one only, or each its own."""
    choice = rng.random()
    if choice < 0.4:
        return np.ones(3)
    return np.asarray(np.eye(3)[rng.integers(3)] if choice < 0.6 else rng.uniform(0.3, 1.0, 3))


def _white(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    axes = _axes(rng)
    return lambda size: Louder(f"{sensor}_noise", (sensor,), size * axes[None, :])


def _walk(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    axes = _axes(rng)
    root_rate = math.sqrt(LOG_RATE / suite[sensor].every)
    sd = math.sqrt(suite[sensor].variance)
    return lambda size: Drift(
        f"{sensor}_random_walk", (sensor,), size, axes, flicker=False, truth={"per_root_s": size * sd * root_rate}
    )


def _flicker(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    axes = _axes(rng)
    return lambda size: Drift(f"{sensor}_flicker", (sensor,), size, axes, flicker=True)


KINDS = tuple(
    Kind(f"{s}_{name}", s, draw, bounds, 3, predictable=False)
    for s in SENSORS
    for name, draw, bounds in (
        ("noise", _white, (1e-4, 20.0)),
        ("random_walk", _walk, (1e-6, 5.0)),
        ("flicker", _flicker, (1e-4, 20.0)),
    )
)
