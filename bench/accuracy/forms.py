"""Plain scipy and numpy forms of the usual magnetometer fits, as anyone would write them; nothing of calib in them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Fitted = tuple[Array, Array]


def _start(samples: Array) -> tuple[Array, float]:
    offset = samples.mean(axis=0)
    return offset, float(np.sqrt(np.mean(np.sum((samples - offset) ** 2, axis=1))))


def _matrix(six: Array) -> Array:
    return np.array([[six[0], six[3], six[4]], [six[3], six[1], six[5]], [six[4], six[5], six[2]]])


def algebraic(samples: Array) -> Fitted:
    """Smallest eigenvector of the centred and scaled ten terms (MATLAB magcal 'sym', NXP AN5019)."""
    centre, scale = _start(samples)
    x, y, z = ((samples - centre) / scale).T
    rows = np.column_stack([x * x, y * y, z * z, x * y, x * z, y * z, x, y, z, np.ones_like(x)])
    theta = np.linalg.eigh(rows.T @ rows)[1][:, 0]
    Q = np.array(
        [
            [theta[0], theta[3] / 2, theta[4] / 2],
            [theta[3] / 2, theta[1], theta[5] / 2],
            [theta[4] / 2, theta[5] / 2, theta[2]],
        ]
    )
    b = -0.5 * np.linalg.solve(Q, theta[6:9])
    values, vectors = np.linalg.eigh(Q / (b @ Q @ b - theta[9]))
    if values.min() <= 0.0:
        raise ValueError("no ellipsoid")
    return centre + scale * b, scale * (vectors / np.sqrt(values)) @ vectors.T


def calibrated_space(samples: Array) -> Fitted:
    """scipy LM of ``|W (y - b)| - 1``: what ArduPilot, pymavlink, imu_tk and most scripts minimise."""
    centre, scale = _start(samples)
    y = (samples - centre) / scale

    def residuals(p: Array) -> Array:
        corrected = (y - p[:3]) @ _matrix(p[3:])
        return np.sqrt(np.einsum("ij,ij->i", corrected, corrected)) - 1.0

    found = least_squares(residuals, np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]), method="lm").x
    values, vectors = np.linalg.eigh(_matrix(found[3:]) @ _matrix(found[3:]))
    return centre + scale * found[:3], scale * (vectors / np.sqrt(values)) @ vectors.T


def orthogonal(samples: Array) -> Fitted:
    """scipy LM of the orthogonal distance, from the algebraic fit: maximum likelihood, bias of curvature left in."""
    b, shape = algebraic(samples)
    scale = float(np.cbrt(np.linalg.det(shape)))
    y = (samples - b) / scale

    def residuals(p: Array) -> Array:
        axes, frame = np.linalg.eigh(_matrix(p[3:]))
        points = (y - p[:3]) @ frame
        squares = axes**2
        t = (np.sqrt(((points / axes) ** 2).sum(axis=1)) - 1.0) * squares.mean()
        for _ in range(6):
            inverse = 1.0 / (t[:, None] + squares)
            terms = (axes * points * inverse) ** 2
            g = terms.sum(axis=1)
            t = t + g * (np.sqrt(g) - 1.0) / (terms * inverse).sum(axis=1)
        return t * np.sqrt(((points / (t[:, None] + squares)) ** 2).sum(axis=1))

    start = np.concatenate([np.zeros(3), (shape / scale)[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]])
    found = least_squares(residuals, start, method="lm").x
    return b + scale * found[:3], scale * _matrix(found[3:])


def rotated(shape: Array, offset: Array, samples: Array, downs: Array) -> Array:
    """``S Q`` with the rotation Q that makes the angle between field and vertical the steadiest: a second stage."""
    field = np.linalg.solve(shape, (samples - offset).T).T
    field /= np.linalg.norm(field, axis=1)[:, None]
    level = downs / np.linalg.norm(downs, axis=1)[:, None]

    def residuals(p: Array) -> Array:
        body = field @ Rotation.from_rotvec(p[:3]).as_matrix()
        return (body * level).sum(axis=1) - p[3]

    found = least_squares(residuals, np.array([0.0, 0.0, 0.0, 0.8]), method="lm").x
    return shape @ Rotation.from_rotvec(found[:3]).as_matrix()
