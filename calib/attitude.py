"""What the uncertainty of an inertial sensor's model does to the attitude."""

from __future__ import annotations

import math

import numpy as np

from mavcal.calib.triad import Array, TriadModel


def tilt_sd_deg(model: TriadModel, covariance: Array, gravity: float) -> float:
    """Standard deviation of the level that an accelerometer's `model` gives, degrees, in the worst direction.

    ``da = dC C^-1 a - C db`` with ``a = (0, 0, -g)``: its horizontal part over g is the tilt. A rotation of the whole
    sensor against the vehicle is not in it: no pose shows it.

    Parameters
    ----------
    model
        Offset and matrix; no thermal part.
    covariance : shape (12, 12) or more
        Covariance of offset and matrix, in the order of :func:`calib.fit.parameter_names`.
    gravity
        Length of the corrected vector.
    """
    level = np.linalg.solve(model.matrix, np.array([0.0, 0.0, -gravity]))
    rows = np.hstack([-model.matrix, np.kron(np.eye(3), level)])[:2]
    variance = rows @ covariance[:12, :12] @ rows.T
    return math.degrees(math.sqrt(max(float(np.linalg.eigvalsh(variance)[-1]), 0.0)) / gravity)


def drift_sd_deg_per_min(model: TriadModel, covariance: Array) -> float:
    """Standard deviation of the angle that a gyroscope's offset makes in a minute, degrees, about the worst axis.

    `covariance` (12, 12) or more is that of offset and matrix, the matrix in rad/s per unit of the sensor.
    """
    rate = model.matrix @ covariance[:3, :3] @ model.matrix.T
    return math.degrees(60.0 * math.sqrt(max(float(np.linalg.eigvalsh(rate)[-1]), 0.0)))
