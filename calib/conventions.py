"""The same correction as other programs write it down: MATLAB, imu_tk, Kalibr.

Ours is ``corrected = C (m - b)`` with vectors as columns (:class:`calib.triad.TriadModel`).

==========  ===========================================================================================================
magcal      ``(D - b) A`` by rows, det A = 1, on a sphere of radius `expmfs`
accelcal    ``U A + b`` by rows
imu_tk      ``T K (m - B)``, K a diagonal of scales and T with a diagonal of ones (imu_tk ``calibration.h``)
kalibr      forward: ``m = M C_i truth + A C_i accel + b``, M lower triangular, C_i a rotation, A a gyroscope's
            sensitivity to acceleration (kalibr ``IccSensors.py``, model scale-misalignment)
==========  ===========================================================================================================

The parameters of autopilots are in :mod:`calib.converted`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.triad import Array, TriadModel


@dataclass(frozen=True, eq=False)
class Magcal:
    """``corrected = (D - b) A`` by rows, det A = 1; `expmfs` is the length of the corrected rows."""

    A: Array
    b: Array
    expmfs: float


def magcal_from_model(model: TriadModel, strength: float) -> Magcal:
    """MATLAB's form of a `model` whose corrected vectors are `strength` long.

    >>> radii = np.array([30.0, 20.0, 50.0])
    >>> form = magcal_from_model(TriadModel([-50.0, 20.0, 100.0], np.diag(1.0 / radii)), 1.0)
    >>> round(form.expmfs, 4), np.diag(form.A).round(4)
    (31.0723, array([1.0357, 1.5536, 0.6214]))
    """
    factor = float(np.cbrt(np.linalg.det(model.matrix)))
    return Magcal(model.matrix.T / factor, model.offset, strength / factor)


def accelcal_from_model(model: TriadModel) -> tuple[Array, Array]:
    """A (3, 3) and b (3,) of ``C = U A + b`` by rows."""
    return model.matrix.T, -model.matrix @ model.offset


def imu_tk_from_model(model: TriadModel) -> tuple[Array, Array, Array]:
    """T (3, 3) with ones on its diagonal, K (3, 3) diagonal, B (3,): ``T K (m - B)``.

    Raises
    ------
    InvalidInputError
        If the matrix has a zero on its diagonal.
    """
    scale = np.diag(model.matrix)
    if not np.all(scale):
        raise InvalidInputError("imu_tk scales every axis by itself: a matrix with a zero on its diagonal has no form")
    return model.matrix / scale, np.diag(scale), model.offset


def kalibr_from_model(model: TriadModel) -> tuple[Array, Array, Array]:
    """M (3, 3) lower triangular with a positive diagonal, the rotation C_i (3, 3) and b (3,): ``m = M C_i truth + b``.

    ``M C_i`` is the LQ decomposition of the sensitivity ``C^-1``. Kalibr has no C_i for an accelerometer, so its M is
    complete only if C_i is the identity.
    """
    orthogonal, triangle = np.linalg.qr(np.linalg.inv(model.matrix).T)
    signs = np.sign(np.diag(triangle))
    return (triangle * signs[:, None]).T, (orthogonal * signs).T, model.offset
