"""Temperature: offsets and gains that follow it, and a die that is not as warm as the thermometer beside it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from mavcal.calib.blind.effects.kind import Added, Kind, Make, Mapped, calibration_temperature, direction, named
from mavcal.calib.blind.missions import Rng, World
from mavcal.calib.blind.sensors import Order, Suite

Array = NDArray[np.float64]
BOUNDS = {"accel": (1e-5, 0.5), "gyro": (1e-6, 0.05), "mag": (1e-4, 5.0)}


def lagged(x: Array, dt: float, tau: float) -> Array:
    """A first-order thermal mass that starts in equilibrium."""
    alpha = 1.0 - math.exp(-dt / tau)
    return np.asarray(lfilter([alpha], [1.0, alpha - 1.0], x, zi=[(1.0 - alpha) * x[0]])[0])


def _linear(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    v = direction(rng)
    d = world.temperature - calibration_temperature(rng, world)
    return lambda size: Added(
        f"{sensor}_temp_linear", (sensor,), {sensor: np.outer(d, size * v)}, truth=named("per_degree", size * v)
    )


def _polynomial(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Second and third order, with some first, each of like size at the ends of the span."""
    d = world.temperature - calibration_temperature(rng, world)
    u = d / np.abs(d).max()
    weights = rng.uniform(-0.5, 0.5), rng.choice([-1, 1]) * rng.uniform(0.7, 1.3), rng.uniform(-1.0, 1.0)
    curve = weights[0] * u + weights[1] * u**2 + weights[2] * u**3
    v = direction(rng) * np.abs(d).max()
    return lambda size: Added(f"{sensor}_temp_poly", (sensor,), {sensor: np.outer(curve, size * v)})


def _gain(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    v = direction(rng)
    d = world.temperature - calibration_temperature(rng, world)
    return lambda size: Mapped(
        f"{sensor}_temp_scale",
        (sensor,),
        lambda x: x * (1.0 + np.outer(d, size * v)),
        truth=named("per_degree", size * v),
        order=Order.GAIN,
    )


def _lag(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """The bias follows the die, which is behind package and board: two thermal masses in a row."""
    tau = rng.uniform(5.0, 20.0)
    die = lagged(lagged(world.temperature, world.dt, tau), world.dt, 0.15 * tau)
    v = direction(rng)
    d = die - calibration_temperature(rng, world)
    return lambda size: Added(f"{sensor}_thermal_lag", (sensor,), {sensor: np.outer(d, size * v)})


KINDS = tuple(
    Kind(f"{sensor}_{name}", sensor, draw, bounds, df)
    for sensor, bounds in BOUNDS.items()
    for name, draw, df in (("temp_linear", _linear, 3), ("temp_poly", _polynomial, 9), ("thermal_lag", _lag, 4))
) + tuple(Kind(f"{sensor}_temp_scale", sensor, _gain, (1e-7, 0.02), 3) for sensor in ("accel", "gyro"))
