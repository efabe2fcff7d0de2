"""Which ring is which: the axis of the body that pointed down, stated or seen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.fit import AXES

Array = NDArray[np.float64]

LABELS = "x-down, x-up, y-down, y-up, z-down, z-up"

_CLEAR = np.cos(np.radians(35.0))  # a centre farther than this from an axis could belong to two faces


def faces_of(centres: Array, stated: Sequence[Array | None]) -> Array:
    """Signed unit vectors (K, 3) along the axis that pointed down in each ring.

    Parameters
    ----------
    centres : shape (K, 3)
        Of the rings, roughly.
    stated
        The vector that a label says; all of them or none count. None: the side of the middle on which the centre lies.
        That holds where the field points down and the sensor's axes are nearly those of the body.

    Raises
    ------
    UndeterminedError
        If labels are missing and the centres do not tell, or a face is missing.
    """
    known = [direction for direction in stated if direction is not None]
    faces = np.array(known) if len(known) == len(stated) else _seen(centres)
    missing = [
        f"{AXES[axis]}-{'down' if side > 0.0 else 'up'}"
        for axis in range(3)
        for side in (1.0, -1.0)
        if not (faces[:, axis] == side).any()
    ]
    if missing:
        raise UndeterminedError(
            f"{len(faces)} rings, and none of them is {', '.join(missing)}",
            remedy="turn the vehicle once around with every axis down and up in turn, and label the rings "
            f"(column segment: {LABELS})",
        )
    return faces


def _seen(centres: Array) -> Array:
    from_middle = centres - 0.5 * (centres.max(axis=0) + centres.min(axis=0))
    length = np.linalg.norm(from_middle, axis=1)
    axis = np.abs(from_middle).argmax(axis=1)
    along = from_middle[np.arange(len(axis)), axis]
    clear = np.abs(along) > _CLEAR * length
    if not clear.all():
        ring = int(np.flatnonzero(~clear)[0])
        raise UndeterminedError(
            f"ring {ring + 1} of {len(centres)} could belong to two faces: its centre lies between the axes",
            remedy=f"label the rings (column segment: {LABELS}), or state their order",
        )
    faces = np.zeros_like(centres)
    faces[np.arange(len(axis)), axis] = np.sign(along)
    return faces
