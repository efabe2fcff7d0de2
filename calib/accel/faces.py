"""Faces of a fixture: readings, the axis that was down, and local gravity (METHODS S4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import require_positive
from mavcal.calib.fit import AXES

Array = NDArray[np.float64]

ACCELCAL_GRAVITY = 9.81

Convention = Literal["specific-force", "accelcal"]
CONVENTIONS: tuple[Convention, ...] = ("specific-force", "accelcal")

_SQUARE = np.cos(np.radians(30.0))  # a row farther than this from an axis is no face

_DOWN_AXES = {  # which body axis points down, and with which sign
    "level": (2, 1.0),
    "back": (2, -1.0),
    "left": (1, -1.0),
    "right": (1, 1.0),
    "nose_down": (0, 1.0),
    "nose_up": (0, -1.0),
}
"""Body axis that points down, and its sign, by pose of MAVLink's ``ACCELCAL_VEHICLE_POS``."""


@dataclass(frozen=True, eq=False)
class Face:
    """The mean reading of one face.

    `covariance` (3, 3) of the mean is None where only one reading is known. `down` is the unit vector (3,) that points
    down in the sensor's axes; None: recognised from the reading.
    """

    mean: Array
    covariance: Array | None = None
    down: Array | None = None
    n: int = 1


def down_of(label: str) -> Array | None:
    """The direction that is down for a label: a MAVLink pose, or an axis such as ``xup``, ``z_down``, ``+y`` (up).

    None if the label says nothing of the kind.
    """
    name = (
        label.strip().lower().replace("-", "_").replace(" ", "_") if len(label.strip()) > 2 else label.strip().lower()
    )
    if name in _DOWN_AXES:
        axis, sign = _DOWN_AXES[name]
        return np.asarray(sign * np.eye(3)[axis], dtype=np.float64)
    bare = name.replace("_", "")
    for axis, letter in enumerate(AXES):
        if bare in {f"{letter}up", f"+{letter}"}:
            return np.asarray(-np.eye(3)[axis], dtype=np.float64)
        if bare in {f"{letter}down", f"-{letter}"}:
            return np.asarray(np.eye(3)[axis], dtype=np.float64)
    return None


def directions_of(faces: Sequence[Face], U: Array, sign: float) -> tuple[Array, str]:
    """Unit vectors (K, 3) that point down, and what is wrong with them; empty if nothing is."""
    centred = U - 0.5 * (U.max(axis=0) + U.min(axis=0))
    directions = np.zeros_like(U)
    for k, face in enumerate(faces):
        axis = int(np.argmax(np.abs(centred[k])))
        seen = np.sign(centred[k, axis]) * np.eye(3)[axis] * sign
        if abs(centred[k, axis]) < _SQUARE * np.linalg.norm(centred[k]):
            return directions, f"reading {k + 1} ({_listed(U[k])}) lies between the axes: hold every face square"
        if face.down is not None and not np.array_equal(face.down, seen):
            if np.array_equal(face.down, -seen):
                return directions, (
                    f"reading {k + 1} has the sign of the other convention: one of {' and '.join(CONVENTIONS)} "
                    "must be stated rightly"
                )
            return directions, f"reading {k + 1} ({_listed(U[k])}) is not the face that its label says"
        directions[k] = seen
    missing = [
        f"{AXES[axis]} {'down' if side > 0 else 'up'}"
        for axis in range(3)
        for side in (-1.0, 1.0)
        if not (directions[:, axis] == side).any()
    ]
    return directions, f"no face with {', '.join(missing)}: turn it there" if missing else ""


def recognised_gravity(U: Array, gravity: float | None, convention: Convention) -> float | None:
    """`gravity` if stated, else 1 or that of the convention, whichever is nearer; None: the readings fit neither.

    Raises
    ------
    InvalidInputError
        If `gravity` is stated and not positive.
    """
    if gravity is not None:
        require_positive(gravity)
        return gravity
    size = float(np.linalg.norm(U, axis=1).mean())
    standard = ACCELCAL_GRAVITY if convention == "accelcal" else STANDARD_GRAVITY
    nearest = min((standard, 1.0), key=lambda g: abs(size - g))
    return nearest if 0.5 * nearest < size < 2.0 * nearest else None


def _listed(values: Array) -> str:
    return ", ".join(f"{value:.4g}" for value in values)
