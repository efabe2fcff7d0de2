"""Rotors shake the frame: imbalance, its harmonics, what sampling folds, what a sensor rectifies."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from mavcal.calib.blind.effects.kind import Added, Kind, Louder, Make, direction
from mavcal.calib.blind.missions import ALL, FLOWN, OVERSAMPLING, TRAVELLED, Rng, World
from mavcal.calib.blind.sensors import Order, Suite

Array = NDArray[np.float64]
NORMAL_HZ = 75.0
INERTIAL = {"accel": (1e-4, 60.0), "gyro": (1e-5, 6.0)}


def shake(rng: Rng, world: World, harmonic: int) -> Array:
    """Imbalance: a force that turns with each shaft and grows with its speed squared; largest at one rotor."""
    shares = rng.dirichlet(np.full(world.rotor_hz.shape[1], 0.6))
    along, across = direction(rng), direction(rng)
    total = np.zeros_like(world.force)
    for k, share in enumerate(shares):
        angle = harmonic * world.rotor_angle[:, k] + rng.uniform(0.0, 2.0 * np.pi)
        size = share * (world.rotor_hz[:, k] / NORMAL_HZ) ** 2
        total += np.outer(size * np.cos(angle), along) + np.outer(size * np.sin(angle), across)
    return total


def _vibration(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    delta = shake(rng, world, 1)
    return lambda size: Added(f"{sensor}_vibration", (sensor,), {sensor: size * delta}, order=Order.PLACE)


def _aliasing(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """A harmonic above half the log's rate, which nothing filters before it is sampled."""
    delta = shake(rng, world, int(rng.choice([2, 3, 4])))
    return lambda size: Added(f"{sensor}_aliasing", (sensor,), {sensor: size * delta}, order=Order.PLACE)


def _rectification(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """A second-order sensor under vibration that its filter removes: what stays is the mean of the square.

    The vibration is that of the blades, many harmonics up; the mechanical filter stands before the log, the curvature
    before the filter.
    """
    v = shake(rng, world, int(rng.choice([5, 6, 7])))
    low = butter(4, 0.3 / OVERSAMPLING, output="sos")
    square = sosfiltfilt(low, (v**2).sum(axis=1))
    axis = direction(rng)
    return lambda size: Added(f"{sensor}_vibration_rectification", (sensor,), {sensor: np.outer(square, size * axis)})


def _rotor_noise(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Broadband: turbulence at the blades, whose force grows with the speed squared."""
    power = (world.rotor_hz.mean(axis=1) / NORMAL_HZ) ** 4
    axes = np.ones(3) if rng.random() < 0.5 else rng.uniform(0.2, 1.0, 3)
    return lambda size: Louder(f"{sensor}_rotor_noise", (sensor,), size * np.outer(power, axes))


def _tone(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Something that turns or switches at its own pace: a gimbal, a supply, the mains."""
    f = math.exp(rng.uniform(math.log(3.0), math.log(0.45 * 200.0 / suite[sensor].every)))
    angle = 2.0 * np.pi * f * world.t + rng.uniform(0.0, 2.0 * np.pi)
    delta = np.outer(np.sin(angle), direction(rng))
    return lambda size: Added(
        f"{sensor}_tone", (sensor,), {sensor: size * delta}, truth={"frequency_hz": f}, order=Order.PLACE
    )


KINDS = (
    *(Kind(f"{s}_vibration", s, _vibration, b, 2, FLOWN) for s, b in INERTIAL.items()),
    *(Kind(f"{s}_aliasing", s, _aliasing, b, 2, FLOWN) for s, b in INERTIAL.items()),
    *(Kind(f"{s}_vibration_rectification", s, _rectification, b, 3, TRAVELLED) for s, b in INERTIAL.items()),
    *(Kind(f"{s}_rotor_noise", s, _rotor_noise, (1e-4, 50.0), 1, FLOWN, predictable=False) for s in INERTIAL),
    Kind("accel_tone", "accel", _tone, (1e-4, 60.0), 6, ALL),
    Kind("gyro_tone", "gyro", _tone, (1e-5, 6.0), 6, ALL),
    Kind("mag_tone", "mag", _tone, (1e-3, 60.0), 6, ALL),
)
