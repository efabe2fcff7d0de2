"""A kind of error: where it can be seen, how large it may be, and how one is drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.blind.missions import ALL, MissionKind, Rng, World
from mavcal.calib.blind.sensors import Effect, Quality, Suite
from mavcal.calib.blind.severity import divergence

Array = NDArray[np.float64]
Make = Callable[[float], Effect]
"""From a size in the effect's own unit to the effect."""

XYZ = "xyz"


@dataclass(frozen=True)
class Kind:
    """One entry of the generator.

    Parameters
    ----------
    id
        ``<sensor>_<kind>`` as the report has it; of what no catalogue has, ``unknown_<name>``.
    sensor
        That it sits on; ``all`` where it touches every one.
    missions
        That excite it.
    df
        Number of its parameters, for the limit of a likelihood-ratio test; 0 where that limit is not defined.
    bounds
        Smallest and largest physical size.
    draw
        ``draw(rng, world, suite, sensor)``: everything but the size.
    foreseen
        Of an unknown type: the method's text names it.
    predictable
        Whether held-out data can be predicted; false for what is random.
    """

    id: str
    sensor: str
    draw: Callable[[Rng, World, Suite, str], Make]
    bounds: tuple[float, float]
    df: int = 3
    missions: tuple[MissionKind, ...] = ALL
    foreseen: bool = False
    predictable: bool = True


@dataclass(frozen=True, eq=False)
class Added(Effect):
    """Something is added to the signal: `delta`, sensor -> (N, 3) on the fine grid."""

    delta: Mapping[str, Array]

    def mean(self, world: World, sensor: str, x: Array) -> Array:
        """Signal plus addition."""
        return x + self.delta[sensor]


@dataclass(frozen=True, eq=False)
class Matrix(Effect):
    """``x -> M x``."""

    matrix: Array

    def mean(self, world: World, sensor: str, x: Array) -> Array:
        """The mixed axes."""
        return x @ self.matrix.T


@dataclass(frozen=True, eq=False)
class Mapped(Effect):
    """``x -> form(x)``."""

    form: Callable[[Array], Array]

    def mean(self, world: World, sensor: str, x: Array) -> Array:
        """The mapped signal."""
        return self.form(x)


@dataclass(frozen=True, eq=False)
class Louder(Effect):
    """Extra independent noise of variance `extra` times that of the sensor; (n,) or (n, 3) at the fine grid or 1."""

    extra: Array

    def _at(self, quality: Quality, n: int) -> Array:
        extra = self.extra if len(self.extra) == 1 else self.extra[:: 8 * quality.every][:n]
        return np.broadcast_to(extra, (n, 3))

    def noise(self, world: World, sensor: str, noise: Array, quality: Quality, rng: Rng) -> Array:
        """Noise plus the extra one."""
        sd = np.sqrt(self._at(quality, len(noise)) * quality.variance)
        return np.asarray(noise + sd * rng.standard_normal(noise.shape))

    def information(self, world: World, sensor: str, quality: Quality) -> float:
        """Divergence of the larger variances."""
        n = len(range(0, len(world.t), 8 * quality.every))
        return divergence(1.0 + self._at(quality, n))


def direction(rng: Rng) -> Array:
    """Along one axis, or anywhere."""
    if rng.random() < 0.4:
        return np.asarray(np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0]))
    v = rng.standard_normal(3)
    return np.asarray(v / np.linalg.norm(v))


def named(name: str, v: Array) -> dict[str, float]:
    """``name.x``, ``name.y``, ``name.z``."""
    return {f"{name}.{axis}": float(value) for axis, value in zip(XYZ, v, strict=True)}


def calibration_temperature(rng: Rng, world: World) -> float:
    """Where the sensor was calibrated and its thermal error is none: within the mission's span."""
    return float(rng.uniform(world.temperature.min(), world.temperature.max()))
