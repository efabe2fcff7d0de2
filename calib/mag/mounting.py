"""The rotation that is in a matrix: how a magnetometer is mounted against the axes that its field was compared with."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.triad import TriadModel

Array = NDArray[np.float64]


def rotation_covariance(model: TriadModel, covariance: Array) -> Array:
    """Covariance (3, 3) in rad^2 of small rotations of the corrected vectors about x, y, z.

    ``C = Q S`` by polar decomposition and ``dC = [phi] C + Q dS``: the skew part of ``G = Q^T dC`` is
    ``(tr S - S) Q^T phi``. `covariance` is (12, 12), in the order of :func:`calib.fit.parameter_names`.
    """
    rotation, symmetric = model.rotation, model.symmetric().matrix
    inverse = np.linalg.inv(np.trace(symmetric) * np.eye(3) - symmetric)
    turn = np.zeros((3, 9))
    for k in range(9):
        change = np.zeros((3, 3))
        change.flat[k] = 1.0
        G = rotation.T @ change
        turn[:, k] = rotation @ inverse @ np.array([G[2, 1] - G[1, 2], G[0, 2] - G[2, 0], G[1, 0] - G[0, 1]])
    return np.asarray(turn @ covariance[3:12, 3:12] @ turn.T, dtype=np.float64)


def mounting_of(model: TriadModel, covariance: Array) -> dict[str, float]:
    """Angle of the rotation in the matrix of `model`, and its standard deviation about the worst axis, degrees."""
    rotation = model.rotation
    skew = rotation - rotation.T
    sine = 0.5 * math.hypot(skew[2, 1], skew[0, 2], skew[1, 0])
    worst = float(np.linalg.eigvalsh(rotation_covariance(model, covariance))[-1])
    return {
        "mounting_deg": math.degrees(math.atan2(sine, 0.5 * (float(np.trace(rotation)) - 1.0))),
        "mounting_sd_deg": math.degrees(math.sqrt(max(worst, 0.0))),
    }
