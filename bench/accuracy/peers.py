"""Installable programs behind one signature; what is not installed says so by name.

Each answers (offset, shape) of ``y = S u + b``. From a correction ``|A (y - b)| = R`` that is
``S = R (A^T A)^(-1/2)``: this symmetric form is the same for any rotation of A.
"""

from __future__ import annotations

import importlib
import importlib.metadata
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Fitted = tuple[Array, Array]

FIELD = 490.0
"""Strength that is told to the programs that want it."""


def shape_of(correction: Array, radius: float = 1.0) -> Array:
    """``R (A^T A)^(-1/2)``."""
    values, vectors = np.linalg.eigh(np.asarray(correction, dtype=np.float64).T @ correction)
    return radius * (vectors / np.sqrt(values)) @ vectors.T


def magcal(samples: Array) -> Fitted:
    module = importlib.import_module("magcal.core")
    found = module.MagnetometerCalibrator().ellipsoid_fit(samples)
    return found["center"], shape_of(found["transform_matrix"])


def magcc_lse(samples: Array) -> Fitted:
    offset, matrix, _, _ = importlib.import_module("magcc.magcc").calibrate_lse(samples, FIELD)
    return offset, shape_of(matrix, FIELD)


def magcc_lm(samples: Array) -> Fitted:
    offset, matrix, _, _ = importlib.import_module("magcc.magcc").calibrate_lm(samples, FIELD)
    return offset, shape_of(matrix, FIELD)


def circuitpython(samples: Array) -> Fitted:
    sensor = importlib.import_module("mag_cal.sensor").Sensor()
    sensor.fit_ellipsoid(samples)
    return np.asarray(sensor.centre).ravel(), shape_of(sensor.transform)


MAGNETOMETER: dict[str, tuple[str, Callable[[Array], Fitted]]] = {
    "magcal ellipsoid": ("magcal", magcal),
    "magcc lse": ("magcc", magcc_lse),
    "magcc lm": ("magcc", magcc_lm),
    "circuitpython-mag-cal": ("circuitpython-mag-cal", circuitpython),
}
"""Name in the tables -> distribution, function."""


def version_of(distribution: str) -> str | None:
    """The installed version; None: it is not there."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def usable(distribution: str, fit: Callable[[Any], Any], sample: Any) -> str:
    """Why `fit` cannot be measured, from one try on `sample`; empty: it can."""
    if version_of(distribution) is None:
        return "not installed"
    try:
        fit(sample)
    except Exception as error:  # noqa: BLE001 - foreign code; whatever stops it is the answer
        return f"does not run here: {type(error).__name__}: {str(error)[:80]}"
    return ""


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
