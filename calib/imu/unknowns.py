"""The 21 unknowns of the joint problem: order, prior, and free directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

UNKNOWNS = 21
"""b (3), C in the order of PAIRS (6), G by rows (9), bg (3)."""
ACCEL, GYRO = slice(0, 9), slice(9, 21)
DIAGONAL = np.array([9, 13, 17])
"""The gyroscope's own scales among the unknowns."""


def cross(v: Array) -> Array:
    """``[v]x`` (K, 3, 3)."""
    out = np.zeros((len(v), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[:, i, j], out[:, j, i] = -v[:, k], v[:, k]
    return out


@dataclass(frozen=True, eq=False)
class ImuPrior:
    """What is known of the unknowns beforehand: `centre` (21,) and `information` (21,), independent of each other."""

    centre: Array
    information: Array


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Directions in which the unknowns may move: all but the `held`; a `rigid` G stays a rotation."""

    held: NDArray[np.intp]
    rigid: bool = False

    def tangents(self, x: Array) -> Array:
        """The directions (21, p) at `x`."""
        basis = np.eye(UNKNOWNS)
        if self.rigid:  # dG = [omega]x G
            turned = np.zeros((UNKNOWNS, 3))
            turned[9:18] = (cross(np.eye(3)) @ x[9:18].reshape(3, 3)).reshape(3, 9).T
            basis = np.hstack([basis[:, ACCEL], turned, basis[:, 18:]])
        return np.delete(basis, self.held, axis=1)

    def moved(self, x: Array, change: Array) -> Array:
        """`x` after the `change` (p,); a rigid G is projected back onto the rotations."""
        new = x + self.tangents(x) @ change
        if self.rigid:
            U, _, Vt = np.linalg.svd(new[9:18].reshape(3, 3))
            new[9:18] = (U @ Vt).ravel()
        return np.asarray(new, dtype=np.float64)


NO_PRIOR = ImuPrior(np.zeros(UNKNOWNS), np.zeros(UNKNOWNS))
FREE = Coordinates(np.zeros(0, dtype=np.intp))
