"""The ellipsoid of a magnetometer and the parameters that describe it: ``y = S u + b`` with u on the unit sphere.

S is symmetric (the rotation of a sensor cannot be seen in the length of a vector, METHODS 0) and holds the field
strength. The nine parameters are ordered ``b_x b_y b_z S_xx S_yy S_zz S_xy S_xz S_yz``.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np

from mavcal.calib.triad import Array, TriadModel

N_PARAMETERS = 9

ROWS = (0, 1, 2, 0, 0, 1)
COLUMNS = (0, 1, 2, 1, 2, 2)


def _symmetric_basis() -> Array:
    basis = np.zeros((6, 3, 3))
    for k, (i, j) in enumerate(zip(ROWS, COLUMNS, strict=True)):
        basis[k, i, j] = basis[k, j, i] = 1.0
    return basis


SYMMETRIC_BASIS = _symmetric_basis()
"""(6, 3, 3): the derivative of S with respect to its six numbers."""


def symmetric(six: Array) -> Array:
    """The symmetric (3, 3) matrix of ``xx yy zz xy xz yz``."""
    return np.tensordot(six, SYMMETRIC_BASIS, axes=1)


def six_numbers(matrix: Array) -> Array:
    """``xx yy zz xy xz yz`` of a symmetric (3, 3) matrix."""
    return matrix[ROWS, COLUMNS]


class MagModel(StrEnum):
    """Which parameters of an ellipsoid are fitted."""

    OFFSET = "offset"  # a sphere: offset and one radius
    DIAGONAL = "diagonal"  # three radii along the sensor's axes
    SYMMETRIC = "symmetric"  # soft iron between the axes as well

    @property
    def basis(self) -> Array:
        """The nine parameters as linear combinations (9, k), orthonormal, of the k that are free."""
        if self is MagModel.SYMMETRIC:
            return np.eye(N_PARAMETERS)
        if self is MagModel.DIAGONAL:
            return np.eye(N_PARAMETERS)[:, :6]
        radius = np.zeros((N_PARAMETERS, 1))
        radius[3:6] = 3.0**-0.5
        return np.hstack([np.eye(N_PARAMETERS)[:, :3], radius])

    @property
    def size(self) -> int:
        """Number of free parameters."""
        return {MagModel.OFFSET: 4, MagModel.DIAGONAL: 6, MagModel.SYMMETRIC: 9}[self]


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """Centre `offset` (3,) and symmetric positive definite `shape` (3, 3), in the unit of the samples."""

    offset: Array
    shape: Array

    @cached_property
    def radii(self) -> Array:
        """Lengths of the three half axes, ascending."""
        return np.asarray(np.linalg.eigvalsh(self.shape), dtype=np.float64)

    @cached_property
    def mean_radius(self) -> float:
        """Radius of the sphere of the same volume."""
        return float(np.cbrt(np.prod(self.radii)))

    def moved(self, offset: Array, scale: float) -> Ellipsoid:
        """The ellipsoid of ``offset + scale * y``."""
        return Ellipsoid(offset + scale * self.offset, scale * self.shape)

    def stepped(self, step: Array) -> Ellipsoid:
        """The ellipsoid whose nine parameters are larger by `step`."""
        return Ellipsoid(self.offset + step[:3], self.shape + symmetric(step[3:]))


def correction(ellipsoid: Ellipsoid, strength: float | None) -> TriadModel:
    """The model that maps the ellipsoid to a sphere of radius `strength`; None: the mean radius (``det C = 1``)."""
    radius = ellipsoid.mean_radius if strength is None else strength
    inverse = np.linalg.inv(ellipsoid.shape)
    return TriadModel(ellipsoid.offset, radius * 0.5 * (inverse + inverse.T))


def correction_covariance(ellipsoid: Ellipsoid, covariance: Array, strength: float | None, strength_sd: float) -> Array:
    """Covariance (12, 12) of offset and correction matrix from the (9, 9) one of the ellipsoid.

    With ``C = F S^-1``: ``dC = -C dS S^-1 + C dF / F``, dF being the error of the known field strength; with the mean
    radius instead of F, ``dF / F = tr(S^-1 dS) / 3``.
    """
    model = correction(ellipsoid, strength)
    inverse = np.linalg.inv(ellipsoid.shape)
    jacobian = np.zeros((12, N_PARAMETERS))
    jacobian[:3, :3] = np.eye(3)
    for k, direction in enumerate(SYMMETRIC_BASIS):
        change = -model.matrix @ direction @ inverse
        if strength is None:
            change = change + model.matrix * np.trace(inverse @ direction) / 3.0
        jacobian[3:, 3 + k] = change.ravel()
    result = jacobian @ covariance @ jacobian.T
    if strength is not None and strength_sd > 0.0:
        scale = np.concatenate([np.zeros(3), model.matrix.ravel()]) * (strength_sd / strength)
        result = result + np.outer(scale, scale)
    return np.asarray(0.5 * (result + result.T))
