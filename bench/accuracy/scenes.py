"""Truths, movements and what a MAVLink stream does to the numbers."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# A magnetometer in mgauss: a field of 490, soft iron of 3 to 10 % with cross terms, an offset of half the field.
SHAPE = 490.0 * np.array([[1.06, 0.045, -0.03], [0.045, 0.94, 0.035], [-0.03, 0.035, 1.0]])
OFFSET = np.array([120.0, -85.0, 210.0])
DIP = math.radians(66.0)


def everywhere(rng: np.random.Generator, count: int) -> Array:
    """Directions (count, 3), evenly over the sphere."""
    u = rng.normal(size=(count, 3))
    u /= np.sqrt(np.einsum("ij,ij->i", u, u))[:, None]
    return u


def tilted(rng: np.random.Generator, count: int, limit_deg: float, dip: float = DIP) -> Array:
    """Directions (count, 3) of the field in a vehicle at every heading, roll and pitch within `limit_deg`."""
    field, _ = tilted_with_down(rng, count, limit_deg, dip)
    return field


def tilted_with_down(rng: np.random.Generator, count: int, limit_deg: float, dip: float) -> tuple[Array, Array]:
    """Field and vertical (count, 3) in the body, roll and pitch within `limit_deg`, every heading."""
    yaw = rng.uniform(-math.pi, math.pi, count)
    pitch, roll = np.radians(rng.uniform(-limit_deg, limit_deg, (2, count)))
    return seen_from(yaw, pitch, roll, dip)


def seen_from(yaw: Array, pitch: Array, roll: Array, dip: float) -> tuple[Array, Array]:
    """Field and vertical (N, 3) in a body of these angles, rad."""
    north, down = math.cos(dip), math.sin(dip)
    # R_nb^T applied to (north, 0, down) and to (0, 0, 1): yaw, then pitch, then roll.
    x1, y1 = north * np.cos(yaw), -north * np.sin(yaw)
    field = _rolled(roll, x1 * np.cos(pitch) - down * np.sin(pitch), y1, x1 * np.sin(pitch) + down * np.cos(pitch))
    return field, _rolled(roll, -np.sin(pitch), np.zeros(len(yaw)), np.cos(pitch))


def _rolled(roll: Array, x: Array, y: Array, z: Array) -> Array:
    return np.column_stack([x, y * np.cos(roll) + z * np.sin(roll), -y * np.sin(roll) + z * np.cos(roll)])


def magnetometer(rng: np.random.Generator, directions: Array, sd: float, quantum: float) -> Array:
    """Samples (N, 3) of the magnetometer above, rounded to `quantum` (0: not)."""
    samples = directions @ SHAPE
    samples += OFFSET
    samples += sd * rng.normal(size=samples.shape)
    return np.rint(samples / quantum) * quantum if quantum else samples


def with_outliers(rng: np.random.Generator, samples: Array, share: float, size: float, quantum: float) -> Array:
    """`samples` with `share` of them moved by up to `size` on each axis."""
    off = rng.random(len(samples)) < share
    moved = samples.copy()
    moved[off] += np.rint(rng.uniform(-size, size, (int(np.count_nonzero(off)), 3)) / quantum) * quantum
    return moved


def random_walk(rng: np.random.Generator, count: int, sd: float) -> Array:
    """A walk (count,) that has wandered by `sd` at its end."""
    return np.cumsum(rng.normal(size=count)) * (sd / math.sqrt(count))
