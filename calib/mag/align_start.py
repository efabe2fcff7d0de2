"""Where an alignment begins: by one linear system, or by an ellipsoid and the rotation that it leaves open."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.fit import FitStatus, parameter_names
from mavcal.calib.mag.align_solve import N_UNKNOWNS
from mavcal.calib.mag.ellipsoid import fit_ellipsoid
from mavcal.calib.mag.orientation import RIGHT_ANGLES

Array = NDArray[np.float64]

STEEPEST = 0.05
"""Cosine of the dip below which the field shows no rotation about itself."""

_DROWNED = 3.0  # noises below which the horizontal field is not seen
_ROUNDS = 8


def check_dip(sine: float, noise: float) -> float:
    """The cosine of the dip, if a rotation about the vertical can be seen with `noise` (of the field, and rad).

    Raises
    ------
    UndeterminedError
        Naming the place.
    """
    cosine = math.sqrt(max(1.0 - sine**2, 0.0))
    if cosine < max(STEEPEST, _DROWNED * noise):
        raise UndeterminedError(
            f"the field is within {math.degrees(math.asin(cosine)):.1f} deg of the vertical here: a rotation about it "
            "does not show",
            missing=parameter_names()[3:],
            remedy="calibrate farther from the magnetic pole; mag-ellipsoid finds offset and soft iron anywhere",
        )
    return cosine


def linear_start(field: Array, down: Array) -> Array:
    """Unknowns (13,) from the second condition alone, which is linear in ``B, B b, sin(dip)`` but for their scale.

    Raises
    ------
    UndeterminedError
        If it leaves more than the scale open.
    """
    rows = np.empty((len(field), N_UNKNOWNS))
    rows[:, :9] = (down[:, :, None] * field[:, None, :]).reshape(-1, 9)
    rows[:, 9:12], rows[:, 12] = -down, -1.0
    vectors = np.linalg.eigh(rows.T @ rows)[1]
    solution = vectors[:, 0]
    B = solution[:9].reshape(3, 3)
    if not np.linalg.cond(B) < 50.0:
        raise UndeterminedError("the vertical does not determine the magnetometer's matrix")
    b = np.linalg.solve(B, solution[9:12])
    size = float(np.linalg.norm((field - b) @ B.T, axis=1).mean()) * float(np.sign(np.linalg.det(B)))
    return np.concatenate([(B / size).ravel(), b, solution[12:] / size])


def two_stage_start(field: Array, down: Array, scale: float) -> Array:
    """Unknowns (13,) from the ellipsoid of `field`, outliers withstood, and the rotation that fits `down` to it.

    `scale` is the unit of `field` in that of the samples: what is said of them is said in their own.

    Raises
    ------
    UndeterminedError
        If the movement does not determine the ellipsoid, or the field is vertical.
    """
    ellipsoid = fit_ellipsoid(scale * field)
    if ellipsoid.status == FitStatus.REFUSED:
        raise UndeterminedError(ellipsoid.message, missing=ellipsoid.undetermined)
    b, radius = ellipsoid.model.offset / scale, float(ellipsoid.native["expmfs"])
    shape = ellipsoid.model.matrix * scale / radius
    w = (field - b) @ shape.T
    noise = ellipsoid.residual_rms / radius
    fits = [_median_misfit(down, w @ turn.matrix.T) for turn in RIGHT_ANGLES]
    Q = RIGHT_ANGLES[int(np.argmin([misfit for misfit, _ in fits]))].matrix
    misfit, sine = min(fits)
    check_dip(min(abs(sine) + misfit, 1.0), noise)
    for _ in range(_ROUNDS):
        turned = w @ Q.T
        along = (down * turned).sum(axis=1)
        right = sine - along
        close = np.abs(right) <= 4.0 * np.median(np.abs(right)) + 1e-9
        rows = np.column_stack([np.cross(turned, down), -np.ones(len(w))])[close]
        step = np.linalg.lstsq(rows, right[close], rcond=1e-6)[0]
        Q, sine = Rotation.from_rotvec(step[:3]).as_matrix() @ Q, sine + float(step[3])
    check_dip(min(abs(sine), 1.0), noise)
    return np.concatenate([(Q @ shape).ravel(), b, [sine]])


def _median_misfit(down: Array, field: Array) -> tuple[float, float]:
    """How much ``g . m`` wanders, and about what."""
    along = (down * field).sum(axis=1)
    sine = float(np.median(along))
    return float(np.median(np.abs(along - sine))), sine
