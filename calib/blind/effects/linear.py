"""Offset, gain, orthogonality and mounting: the affine part of a 3-axis sensor's equation (IEEE Std 1293, 952)."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from mavcal.calib.blind.effects.kind import Added, Kind, Make, Mapped, Matrix, direction, named
from mavcal.calib.blind.missions import ALL, TURNED, MissionKind, Rng, World
from mavcal.calib.blind.sensors import Order, Suite

MOVED = (MissionKind.TUMBLE, MissionKind.FLIGHT, MissionKind.FULL)


def _bias(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    v = direction(rng)
    name, parameter = ("hard_iron", "hard_iron") if sensor == "mag" else ("bias", "bias")
    shape = np.tile(v, (len(world.t), 1))
    return lambda size: Added(
        f"{sensor}_{name}", (sensor,), {sensor: size * shape}, truth=named(parameter, size * v), order=Order.OFFSET
    )


def _scale(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    v = direction(rng)
    return lambda size: Matrix(
        f"{sensor}_scale", (sensor,), np.diag(1.0 + size * v), truth=named("scale", size * v), order=Order.GAIN
    )


def _misalignment(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Sensing axes that are not square to each other.

    y leans by an angle in the x-y plane, and z by two angles: exact unit vectors, not first order.
    """
    v = rng.standard_normal(3)
    v /= np.linalg.norm(v)

    def make(size: float) -> Matrix:
        xy, xz, yz = size * v
        y = np.array([-np.sin(xy), np.cos(xy), 0.0])
        z = np.array([np.sin(xz), -np.sin(yz) * np.cos(xz), np.cos(yz) * np.cos(xz)])
        return Matrix(f"{sensor}_misalignment", (sensor,), np.array([[1.0, 0.0, 0.0], y, z]), order=Order.AXES)

    return make


def _rotation(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    v = direction(rng)
    return lambda size: Matrix(
        f"{sensor}_rotation", (sensor,), Rotation.from_rotvec(size * v).as_matrix().T, order=Order.AXES
    )


def _soft_iron(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Induced magnetisation is linear and reciprocal: a symmetric matrix."""
    s = rng.standard_normal((3, 3))
    s = s + s.T
    s /= np.linalg.norm(s)
    return lambda size: Matrix("mag_soft_iron", (sensor,), np.eye(3) + size * s, order=Order.GAIN)


def _g_sensitivity(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """A Coriolis mass that is pulled by the specific force: rad/s per m/s2, any axis to any axis."""
    g = rng.standard_normal((3, 3)) * (rng.random((3, 3)) < 0.7) + np.diag(rng.standard_normal(3))
    g /= np.linalg.norm(g)
    return lambda size: Added("gyro_g_sensitivity", (sensor,), {sensor: world.force @ (size * g).T})


def _saturated(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """The converter's range ends: `size` is its distance below the largest reading, relative."""
    top = float(np.abs(world.truth(sensor)).max())
    return lambda size: Mapped(
        f"{sensor}_saturation",
        (sensor,),
        lambda x: np.clip(x, -top * (1.0 - size), top * (1.0 - size)),
        order=Order.LIMIT,
    )


def _dead_band(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Small inputs read zero."""
    return lambda size: Mapped(
        f"{sensor}_dead_band", (sensor,), lambda x: np.where(np.abs(x) < size, 0.0, x), order=Order.LIMIT
    )


KINDS = (
    Kind("accel_bias", "accel", _bias, (1e-5, 5.0), 3, ALL),
    Kind("gyro_bias", "gyro", _bias, (1e-6, 0.5), 3, ALL),
    Kind("mag_hard_iron", "mag", _bias, (1e-3, 80.0), 3, MOVED),
    Kind("accel_scale", "accel", _scale, (1e-6, 0.2), 3, MOVED),
    Kind("gyro_scale", "gyro", _scale, (1e-6, 0.3), 3, MOVED),
    Kind("accel_misalignment", "accel", _misalignment, (1e-6, 0.2), 3, MOVED),
    Kind("gyro_misalignment", "gyro", _misalignment, (1e-6, 0.2), 3, MOVED),
    Kind("accel_rotation", "accel", _rotation, (1e-6, 0.3), 3, MOVED),
    Kind("gyro_rotation", "gyro", _rotation, (1e-6, 0.3), 3, MOVED),
    Kind("mag_rotation", "mag", _rotation, (1e-6, 0.3), 3, MOVED),
    Kind("mag_soft_iron", "mag", _soft_iron, (1e-6, 0.4), 6, TURNED),
    Kind("gyro_g_sensitivity", "gyro", _g_sensitivity, (1e-8, 0.02), 9, MOVED),
    Kind("accel_saturation", "accel", _saturated, (1e-5, 0.6), 1, MOVED),
    Kind("gyro_saturation", "gyro", _saturated, (1e-5, 0.7), 1, MOVED),
    Kind("mag_saturation", "mag", _saturated, (1e-5, 0.5), 1, TURNED),
    Kind("gyro_dead_band", "gyro", _dead_band, (1e-4, 0.2), 1, ALL),
    Kind("accel_dead_band", "accel", _dead_band, (1e-3, 2.0), 1, ALL),
)
