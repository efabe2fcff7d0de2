"""Quaternions (w x y z, body to NED) of the sensor source, its own: two readings of the same facts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FACES: Final[Mapping[str, tuple[float, float, float]]] = MappingProxyType(
    {
        "level": (0.0, 0.0, 0.0),
        "left": (-90.0, 0.0, 0.0),
        "right": (90.0, 0.0, 0.0),
        "nose_down": (0.0, -90.0, 0.0),
        "nose_up": (0.0, 90.0, 0.0),
        "back": (180.0, 0.0, 0.0),
    }
)
"""Roll, pitch and yaw (deg) in which a vehicle lies on each of its faces."""


def multiplied(a: Array, b: Array) -> Array:
    """The product, of length 1."""
    w = a[0] * b[0] - a[1:] @ b[1:]
    v = a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    q = np.concatenate([[w], v])
    return np.asarray(q / np.linalg.norm(q))


def about(axis: Array, angle: float) -> Array:
    """A turn by `angle` (rad) about a unit vector."""
    return np.concatenate([[math.cos(angle / 2)], math.sin(angle / 2) * axis])


def from_euler(roll: float, pitch: float, yaw: float) -> Array:
    """Yaw, then pitch, then roll (rad)."""
    x, y, z = np.eye(3)
    return multiplied(multiplied(about(z, yaw), about(y, pitch)), about(x, roll))


def rotation_between(now: Array, target: Array) -> tuple[Array, float]:
    """Body axis and angle (rad, 0 to pi) that take `now` to `target`."""
    error = multiplied(now * np.array([1, -1, -1, -1]), target)
    error = error if error[0] >= 0 else -error
    length = float(np.linalg.norm(error[1:]))
    axis = error[1:] / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    return axis, 2.0 * math.atan2(length, float(error[0]))


def to_body(q: Array, vector: Array) -> Array:
    """A vector of the world (NED) in the body frame."""
    w, v = q[0], -q[1:]
    t = 2.0 * np.cross(v, vector)
    return np.asarray(vector + w * t + np.cross(v, t))
