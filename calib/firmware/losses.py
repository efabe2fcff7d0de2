"""Parts of a fitted model that a firmware cannot store, with their cost.

A fit corrects by ``C (m - b)``. Firmwares store a symmetric matrix at most (magnetometers), a diagonal one
(accelerometers) or none (gyroscopes). Hence ``C = Q S`` is split by polar decomposition: ``S`` symmetric, ``Q`` a
rotation (FLIGHT_CONTROLLERS 2.3). After the write ``D (m - b)`` is in force. It turns a true vector ``x`` into ``D S^-1
x``. Leaving the rest out costs ``|(D - S) S^-1 x|``, at most the 2-norm of ``(D - S) S^-1`` times ``|x|``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.fit import FitResult

Array = NDArray[np.float64]

OFFSETS = slice(0, 3)
MATRIX = slice(3, 12)
POLYNOMIAL = 12

_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


@dataclass(frozen=True, eq=False)
class Parts:
    """The matrix of a fit as ``C = rotation symmetric``, with the covariance of offset and symmetric part."""

    offset: Array
    rotation: Array
    symmetric: Array
    covariance: Array
    """(9, 9) over offset x y z, S_xx S_yy S_zz S_xy S_xz S_yz."""

    def rotated(self, body_from_sensor: Array) -> Parts:
        """The same model of a sensor whose axes were turned: ``R S R^T`` and ``R b``."""
        jacobian = np.zeros((9, 9))
        jacobian[:3, :3] = body_from_sensor
        for column, (i, j) in enumerate(_PAIRS):
            unit = np.zeros((3, 3))
            unit[i, j] = unit[j, i] = 1.0
            turned = body_from_sensor @ unit @ body_from_sensor.T
            jacobian[3:, 3 + column] = [turned[p] for p in _PAIRS]
        return Parts(
            body_from_sensor @ self.offset,
            self.rotation @ body_from_sensor.T,
            body_from_sensor @ self.symmetric @ body_from_sensor.T,
            jacobian @ self.covariance @ jacobian.T,
        )

    @property
    def diagonal(self) -> Array:
        """``diag(S)``, shape (3,)."""
        return np.diag(self.symmetric).copy()

    @property
    def cross(self) -> Array:
        """``S_xy, S_xz, S_yz``, shape (3,)."""
        return self.symmetric[[0, 0, 1], [1, 2, 2]]

    @property
    def sd(self) -> Array:
        """Standard deviations in the order of the covariance."""
        return np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))


def split(fit: FitResult) -> Parts:
    """Split a fit's matrix into rotation and symmetric part, with the covariance of offset and symmetric part.

    ``S^2 = C^T C`` gives ``S dS + dS S = dC^T C + C^T dC``, solved in the eigenframe of S.
    """
    model = fit.model
    symmetric = model.symmetric().matrix
    values, vectors = np.linalg.eigh(symmetric)
    jacobian = np.zeros((9, 12))
    jacobian[:3, OFFSETS] = np.eye(3)
    for k in range(9):
        change = np.zeros((3, 3))
        change.flat[k] = 1.0
        right = vectors.T @ (change.T @ model.matrix + model.matrix.T @ change) @ vectors
        moved = vectors @ (right / (values[:, None] + values[None, :])) @ vectors.T
        jacobian[3:, 3 + k] = [moved[p] for p in _PAIRS]
    covariance = jacobian @ fit.covariance[:12, :12] @ jacobian.T
    return Parts(model.offset.copy(), model.rotation, symmetric, covariance)


def largest_error(stored: Array, fitted: Array, magnitude: float) -> float:
    """Largest ``|(stored - fitted) fitted^-1 x|`` over all directions of a true vector of length `magnitude`."""
    return float(np.linalg.norm((stored - fitted) @ np.linalg.inv(fitted), 2) * magnitude)


def largest_sd(parts: Parts, stored: Array) -> float:
    """Standard deviation of :func:`largest_error` for scales `stored` (3,) and a true vector of length 1.

    A scale that is stored as fitted is not lost and adds nothing.

    To first order the error is the largest eigenvalue of ``S - D``, whose derivative is ``v v^T``.
    """
    values, vectors = np.linalg.eigh(parts.symmetric - np.diag(stored))
    v = vectors[:, int(np.abs(values).argmax())]
    row = np.array([v[i] * v[j] * (1.0 if i == j else 2.0) for i, j in _PAIRS])
    row[:3] *= np.abs(parts.diagonal - stored) > 1e-6
    return float(np.sqrt(max(row @ parts.covariance[3:, 3:] @ row, 0.0)))
