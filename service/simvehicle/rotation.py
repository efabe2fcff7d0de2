"""Quaternions (w x y z, body to NED) and fixed mounting rotations, vectorised over the first axis.

Written on numpy alone: importing scipy would triple the start time of the process.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcal.service.simvehicle.errors import ConfigurationError

Array = NDArray[np.floating[Any]]

# Mounting rotations common to ArduPilot (AP_Math/rotations.h) and PX4 (conversion/rotation.h):
# enum value -> roll, pitch, yaw in degrees.
MOUNTING_EULER_DEG: dict[int, tuple[float, float, float]] = {
    **{k: (0.0, 0.0, 45.0 * k) for k in range(8)},
    8: (180, 0, 0),
    9: (180, 0, 45),
    10: (180, 0, 90),
    11: (180, 0, 135),
    12: (0, 180, 0),
    13: (180, 0, 225),
    14: (180, 0, 270),
    15: (180, 0, 315),
    16: (90, 0, 0),
    17: (90, 0, 45),
    18: (90, 0, 90),
    19: (90, 0, 135),
    20: (270, 0, 0),
    21: (270, 0, 45),
    22: (270, 0, 90),
    23: (270, 0, 135),
    24: (0, 90, 0),
    25: (0, 270, 0),
    26: (0, 180, 90),
    27: (0, 180, 270),
    28: (90, 90, 0),
    29: (180, 90, 0),
    30: (270, 90, 0),
    31: (90, 180, 0),
    32: (270, 180, 0),
    33: (90, 270, 0),
    34: (180, 270, 0),
    35: (270, 270, 0),
    36: (90, 180, 90),
    37: (90, 0, 270),
    38: (90, 68.8, 293.3),
    39: (0, 315, 0),
    40: (90, 315, 0),
}


def quaternion_from_euler(roll: float, pitch: float, yaw: float) -> Array:
    """Quaternion body to NED of the aerospace sequence yaw, pitch, roll (radians)."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def multiply(p: ArrayLike, q: ArrayLike) -> Array:
    """Hamilton product p ⊗ q over the last axis; either may be one quaternion or many."""
    p, q = np.asarray(p, dtype=np.float64), np.asarray(q, dtype=np.float64)
    pw, px, py, pz = p[..., 0], p[..., 1], p[..., 2], p[..., 3]
    qw, qx, qy, qz = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    product = np.empty(np.broadcast_shapes(p.shape, q.shape))
    product[..., 0] = pw * qw - px * qx - py * qy - pz * qz
    product[..., 1] = pw * qx + px * qw + py * qz - pz * qy
    product[..., 2] = pw * qy - px * qz + py * qw + pz * qx
    product[..., 3] = pw * qz + px * qy - py * qx + pz * qw
    return product


def conjugate(q: ArrayLike) -> Array:
    """The inverse rotation of unit quaternions."""
    return np.asarray(np.asarray(q, dtype=np.float64) * np.array([1.0, -1.0, -1.0, -1.0]))


def quaternion_from_vector(v: ArrayLike) -> Array:
    """Quaternion of rotation vectors v (rad), shape (..., 3) to (..., 4)."""
    v = np.asarray(v, dtype=np.float64)
    angle = np.sqrt(np.sum(v * v, axis=-1, keepdims=True))
    # np.sinc is sin(πx)/(πx): exact at zero, so no branch for small angles is needed.
    return np.concatenate([np.cos(angle / 2), 0.5 * v * np.sinc(angle / (2 * np.pi))], axis=-1)


def vector_from_quaternion(q: Array) -> Array:
    """Rotation vector (rad, length at most π) of one quaternion."""
    w, v = (q[0], q[1:]) if q[0] >= 0 else (-q[0], -q[1:])
    length = float(np.linalg.norm(v))
    if length < 1e-15:
        return np.zeros(3)
    return np.asarray(v / length * 2.0 * math.atan2(length, w))


def matrices_from_quaternions(q: ArrayLike) -> Array:
    """Rotation matrices R_nb (body to NED) of quaternions, shape (..., 4) to (..., 3, 3)."""
    q = np.asarray(q, dtype=np.float64)
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    xx, yy, zz = 2 * x * x, 2 * y * y, 2 * z * z
    xy, xz, yz = 2 * x * y, 2 * x * z, 2 * y * z
    wx, wy, wz = 2 * w * x, 2 * w * y, 2 * w * z
    m = np.empty((*q.shape[:-1], 3, 3))
    m[..., 0, 0], m[..., 0, 1], m[..., 0, 2] = 1 - yy - zz, xy - wz, xz + wy
    m[..., 1, 0], m[..., 1, 1], m[..., 1, 2] = xy + wz, 1 - xx - zz, yz - wx
    m[..., 2, 0], m[..., 2, 1], m[..., 2, 2] = xz - wy, yz + wx, 1 - xx - yy
    return m


def body_from_ned(q: Array, vector: ArrayLike) -> Array:
    """A fixed NED vector seen in the body frames q, shape (N, 4) to (N, 3)."""
    # v·R for each row: the transpose of R_nb applied to v.
    return np.asarray(np.asarray(vector, dtype=np.float64) @ matrices_from_quaternions(q))


def euler_from_quaternions(q: Array) -> Array:
    """Roll, pitch, yaw in radians, shape (N, 4) to (N, 3)."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)


def shortest_rotation(a: Array, b: Array) -> Array:
    """Quaternion of the smallest rotation that takes direction a to direction b, shapes (N, 3) to (N, 4)."""
    a = a / np.linalg.norm(a, axis=-1, keepdims=True)
    b = b / np.linalg.norm(b, axis=-1, keepdims=True)
    q = np.concatenate([1.0 + np.sum(a * b, axis=-1, keepdims=True), np.cross(a, b)], axis=-1)
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))


def matrix_from_degrees(roll: float, pitch: float, yaw: float) -> Array:
    """R of roll, pitch, yaw in degrees, turned in the order yaw, pitch, roll."""
    return matrices_from_quaternions(quaternion_from_euler(*map(math.radians, (roll, pitch, yaw))))


def mounting_matrix(orientation: int) -> Array:
    """R body_from_sensor of a mounting enum value. Raises ConfigurationError for one that is not modelled."""
    if orientation not in MOUNTING_EULER_DEG:
        raise ConfigurationError(f"mounting rotation {orientation} is not modelled: use 0..40")
    return matrix_from_degrees(*MOUNTING_EULER_DEG[orientation])
