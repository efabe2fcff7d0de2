"""Where the sensor sits, and what is near it: lever arm, motor currents, the field of the place, the reference."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from mavcal.calib.blind.effects.kind import Added, Kind, Make, direction, named
from mavcal.calib.blind.missions import TRAVELLED, TURNED, Rng, World
from mavcal.calib.blind.sensors import Effect, Order, Suite

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ReferenceTilt(Effect):
    """The reference's attitude is wrong by a slow rotation: what an ideal sensor would read there is turned."""

    error: Array  # rotation vectors on the fine grid, rad

    def mean(self, world: World, sensor: str, x: Array) -> Array:
        """The ideal sensor's reading in the wrong attitude."""
        return np.asarray(Rotation.from_rotvec(self.error).apply(x))


def _lever_arm(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """A rigid body's point at r: f + dw/dt x r + w x (w x r)."""
    v = direction(rng)
    turning = np.gradient(world.rate, world.dt, axis=0)
    delta = np.cross(turning, v) + np.cross(world.rate, np.cross(world.rate, v))
    return lambda size: Added(
        "accel_lever_arm", (sensor,), {sensor: size * delta}, truth=named("lever_arm", size * v), order=Order.PLACE
    )


def _motor_current(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Biot and Savart: the field of the supply leads, proportional to the current."""
    v = direction(rng)
    return lambda size: Added(
        "mag_motor_current",
        (sensor,),
        {sensor: np.outer(world.current, size * v)},
        truth=named("per_ampere", size * v),
    )


def _earth_field(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """The field of the place is not the one that was assumed: a constant vector in the world."""
    v = direction(rng)
    delta = world.attitude.inv().apply(np.tile(v, (len(world.t), 1)))
    return lambda size: Added("mag_earth_field", (sensor,), {sensor: size * delta}, order=Order.PLACE)


def _field_gradient(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Iron in the ground: outside its sources a static field has no curl and no divergence."""
    g = rng.standard_normal((3, 3))
    g = g + g.T
    g -= np.eye(3) * np.trace(g) / 3.0
    g /= np.linalg.norm(g)
    delta = world.attitude.inv().apply(world.place @ g.T)
    return lambda size: Added("mag_field_gradient", (sensor,), {sensor: size * delta}, order=Order.PLACE)


def reference_tilt(rng: Rng, world: World, size: float) -> ReferenceTilt:
    """Of `size` rad rms an axis, over some ten seconds to minutes, with a constant part."""
    return ReferenceTilt("reference_attitude", ("accel", "mag"), size * _slow(rng, world), order=Order.PLACE)


def _slow(rng: Rng, world: World) -> Array:
    """What an attitude filter's error does: noise behind two lags of seconds, about a constant; unit rms."""
    coarse = world.t[::160]
    tau = rng.uniform(3.0, 12.0)
    error = rng.standard_normal((len(coarse) + 600, 3))
    for lag in (tau, 0.3 * tau):
        alpha = 1.0 - math.exp(-160.0 * world.dt / lag)
        error = lfilter([alpha], [1.0, alpha - 1.0], error, axis=0)
    error = error[600:] / error.std(axis=0) + 0.5 * rng.standard_normal(3)
    path = CubicSpline(coarse, error)(world.t)
    return np.asarray(path / np.sqrt((path**2).mean()))


def _reference(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    error = _slow(rng, world)
    return lambda size: ReferenceTilt("reference_attitude", ("accel", "mag"), size * error, order=Order.PLACE)


KINDS = (
    Kind("accel_lever_arm", "accel", _lever_arm, (1e-5, 1.0), 3, TURNED),
    Kind("mag_motor_current", "mag", _motor_current, (1e-4, 5.0), 3, TRAVELLED),
    Kind("mag_earth_field", "mag", _earth_field, (1e-3, 40.0), 3, TURNED),
    Kind("mag_field_gradient", "mag", _field_gradient, (1e-4, 20.0), 8, TRAVELLED),
    Kind("reference_attitude", "all", _reference, (1e-6, 0.2), 0, TURNED),
)
