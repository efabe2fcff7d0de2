"""Mounting rotation by any angles, and the mirror image, that fit a magnetometer to the vertical.

Whatever the heading, ``g . R m = sin(dip)`` for the true rotation R (:mod:`calib.mag.orientation`). That is linear in
the nine elements of R. Its mean square is therefore a quadratic form, which is minimised over the rotations without the
samples. The matrix of a sensor with a reversed axis is ``-R`` with a rotation R, and ``g . (-R) m = sin(dip)`` is the
same search for the opposite sine. If the dip is unknown or zero, the two cannot be told apart.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

APART = math.radians(15.0)
"""Angle above which two rotations are different solutions, rad."""
_STEPS = 40
_HALVINGS = 8
_CONVERGED = 1e-7
_DAMPING = 1e-9
"""Damping of the normal equations, relative to their trace: an undetermined rotation keeps its start value."""
_GENERATORS = np.array(
    [
        [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
        [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]],
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
    ]
)


@dataclass(frozen=True, eq=False)
class Euler:
    """``R = Rz(yaw) Ry(pitch) Rx(roll)`` in degrees, and the standard deviation of each; None: not known."""

    roll: float
    pitch: float
    yaw: float
    sd: tuple[float, float, float] | None = None

    @property
    def angles(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw."""
        return self.roll, self.pitch, self.yaw

    def __str__(self) -> str:
        sds = self.sd or (None, None, None)
        parts = [
            f"{name} {round(angle, 1) + 0.0:.1f}" + ("" if sd is None else f" ± {sd:.1f}")
            for name, angle, sd in zip(("roll", "pitch", "yaw"), self.angles, sds, strict=True)
        ]
        return ", ".join(parts) + " deg"


def turn(vector: Array) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) in rad."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    cross = np.einsum("...k,kij->...ij", vector, _GENERATORS)
    once, twice = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    return np.asarray(np.eye(3) + once * cross + twice * cross @ cross)


def angle_between(a: Array, b: Array) -> float:
    """Angle, rad, between two rotations (3, 3)."""
    R = a.T @ b
    sine = 0.5 * math.hypot(R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])
    return math.atan2(sine, 0.5 * (float(np.trace(R)) - 1.0))


def euler_angles(rotation: Array, covariance: Array | None = None) -> Euler:
    """Angles of `rotation` (3, 3); `covariance` (3, 3) in rad^2 is that of small turns of the body about x, y, z.

    With the nose straight up or down roll and yaw turn about one axis: roll is then set to 0, and there is no sd.
    """
    sine = float(np.clip(-rotation[2, 0], -1.0, 1.0))
    pitch = math.asin(sine)
    upright = abs(sine) > 1.0 - 1e-9
    if upright:
        roll, yaw = 0.0, math.atan2(-rotation[0, 1], rotation[1, 1])
    else:
        roll = math.atan2(rotation[2, 1], rotation[2, 2])
        yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    sd = None
    if covariance is not None and not upright:
        cosine, heading = math.cos(pitch), np.array([math.cos(yaw), math.sin(yaw), 0.0])
        axes = np.column_stack([cosine * heading + [0.0, 0.0, -sine], [-heading[1], heading[0], 0.0], [0.0, 0.0, 1.0]])
        change = np.linalg.solve(axes, np.linalg.solve(axes, covariance).T)
        roll_sd, pitch_sd, yaw_sd = np.degrees(np.sqrt(np.clip(np.diag(change), 0.0, None))).tolist()
        sd = roll_sd, pitch_sd, yaw_sd
    return Euler(math.degrees(roll), math.degrees(pitch), math.degrees(yaw), sd)


def best_rotations(down: Array, field: Array, sine: float | None, starts: Array) -> list[Array]:
    """Rotations (3, 3) at the distinct minima of the mean square of ``g . R m - sine``, best first.

    Parameters
    ----------
    down, field : shape (N, 3)
        Unit vectors in the body, and in what is taken for the body.
    sine
        Sine of the dip; None: it is estimated beside the rotation.
    starts : shape (K, 3, 3)
        Where the search begins.
    """
    products = np.einsum("ni,nj->nij", down, field).reshape(-1, 9)
    mean = products.mean(axis=0)
    square = products.T @ products / len(products)
    if sine is None:
        square, linear = square - np.outer(mean, mean), np.zeros(9)
    else:
        linear = sine * mean
    found = np.asarray(starts, dtype=np.float64)
    for _ in range(_STEPS):
        before, found = found, _stepped(found, square, linear)
        if np.abs(found - before).max() < _CONVERGED:
            break
    flat = found.reshape(-1, 9)
    costs = _costs(flat, square, linear)
    kept: list[Array] = []
    for k in np.argsort(costs, kind="stable"):
        if all(angle_between(found[k], other) > APART for other in kept):
            kept.append(found[k])
    return kept


def best_mirrors(down: Array, field: Array, sine: float | None, starts: Array) -> list[Array]:
    """The same for reflections (determinant -1); none if the dip is unknown."""
    if sine is None:
        return []
    return [-rotation for rotation in best_rotations(down, field, -sine, starts)]


def mirror_words(mirror: Array) -> str:
    """How a matrix (3, 3) of determinant -1, true from read axes of the sensor, mirrors the axes, in words.

    >>> mirror_words(np.diag([1.0, 1.0, -1.0]))
    'its z axis reads with the wrong sign'
    """
    nearest = np.rint(mirror)
    simple = np.linalg.det(nearest) < -0.5 and angle_between(-nearest, -mirror) < APART
    if simple and not (nearest - np.diag(np.diag(nearest))).any():
        wrong = [axis for axis, sign in zip("xyz", np.diag(nearest), strict=True) if sign < 0.0]
        return f"its {wrong[0]} axis reads with the wrong sign" if len(wrong) == 1 else "all its axes read reversed"
    if simple and (nearest >= 0.0).all():
        first, second = (axis for axis, kept in zip("xyz", np.diag(nearest), strict=True) if not kept)
        return f"its {first} and {second} axes are exchanged"
    return "its axes are mirrored"


def _stepped(found: Array, square: Array, linear: Array) -> Array:
    """One Gauss-Newton step of every start (K, 3, 3); a step that leads uphill is halved until it does not."""
    flat = found.reshape(-1, 9)
    moves = np.einsum("aij,kjl->kail", _GENERATORS, found).reshape(len(found), 3, 9)
    slope = np.einsum("kai,ki->ka", moves, flat @ square - linear)
    normal = np.einsum("kai,ij,kbj->kab", moves, square, moves)
    damping = _DAMPING + _DAMPING * np.trace(normal, axis1=1, axis2=2)
    step = -np.linalg.solve(normal + damping[:, None, None] * np.eye(3), slope[:, :, None])[:, :, 0]
    step *= np.minimum(1.0, 0.5 / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-12))
    costs, open_ = _costs(flat, square, linear), np.ones(len(found), dtype=bool)
    for _ in range(_HALVINGS):
        tried = turn(step) @ found
        better = open_ & (_costs(tried.reshape(-1, 9), square, linear) < costs)
        found = np.where(better[:, None, None], tried, found)
        open_ &= ~better
        if not open_.any():
            break
        step = 0.5 * step
    return found


def _costs(flat: Array, square: Array, linear: Array) -> Array:
    return np.asarray(np.einsum("ki,ij,kj->k", flat, square, flat) - 2.0 * flat @ linear)
