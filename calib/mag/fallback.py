"""The sphere in place of an ellipsoid that does not converge, with what its lack of soft iron may cost."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import NotConvergedError, UndeterminedError
from mavcal.calib.fit import AXES, OFFSETS
from mavcal.calib.mag.distance import ALL_SIDES, score_rows
from mavcal.calib.mag.earthly import plausible_field
from mavcal.calib.mag.result import UNDETERMINED_SD, ShapeFit
from mavcal.calib.mag.sections import visited
from mavcal.calib.mag.serial import white_variance
from mavcal.calib.mag.shape import Ellipsoid, MagModel, correction
from mavcal.calib.mag.shape_fit import Asked, shape_of

Array = NDArray[np.float64]

SOFT_IRON_SD = 0.05
"""Standard deviation of each relative term of the soft iron that a sphere leaves out: that of a clean vehicle."""
_MANY = 20_000  # samples that are enough to say what soft iron would do
_CHANGED = 2.0  # times the noise: residuals of a sphere, whose soft iron would have been found
_FULL = 0.3  # of the directions of the field: with more it is no matter of coverage


def sphere_instead(samples: Array, asked: Asked, error: NotConvergedError) -> ShapeFit:
    """The sphere of `samples` (N, 3), whose ellipsoid ended in `error`.

    Its covariance has what soft iron of 5 % would move it by. Its matrix is left open, and an offset that this leaves
    unknown along some axes.

    Raises
    ------
    UndeterminedError
        `error`, where the samples lie on no sphere either.
    """
    try:
        fit = shape_of(samples, dataclasses.replace(asked, model=MagModel.OFFSET, prior_sd=None, cross_sd=None))
    except UndeterminedError:
        raise error from None
    if asked.context.unit == "uT" and not plausible_field(fit.ellipsoid.mean_radius):
        raise error  # a compass that was hardly turned makes a ball of its noise
    thinned = np.asarray(samples[:: max(1, len(samples) // _MANY)], dtype=np.float64)
    covariance = fit.covariance + _by_soft_iron(thinned, fit.ellipsoid)
    unknown = np.sqrt(np.diag(covariance)[:3]) > UNDETERMINED_SD * fit.ellipsoid.mean_radius
    names = [n for n, far in zip(OFFSETS, unknown, strict=True) if far and not unknown.all()]
    return dataclasses.replace(
        fit,
        covariance=covariance,
        form="sphere",
        left_open=dict.fromkeys([*names, *(f"matrix_{a}{b}" for a in AXES for b in AXES)], ALL_SIDES),
        because=f"the ellipsoid did not converge: {_why(thinned, fit)}",
        warnings=(
            f"a sphere takes the place of the ellipsoid: the sd of its offset includes soft iron of "
            f"{100.0 * SOFT_IRON_SD:.0f} %, the matrix stays as it is",
        ),
    )


def _by_soft_iron(samples: Array, sphere: Ellipsoid) -> Array:
    """Covariance (9, 9) that soft iron ``S/r - I ~ N(0, sd^2)`` adds to a sphere that was fitted without it."""
    rows = score_rows(samples, sphere)
    free = MagModel.OFFSET.basis
    ours = free.T @ rows
    moved = np.vstack([np.zeros((3, 6)), np.eye(6)]) - free @ np.linalg.solve(ours @ ours.T, ours @ rows[3:].T)
    spread = np.eye(6)
    spread[:3, :3] -= 1.0 / 3.0
    return np.asarray(moved @ ((SOFT_IRON_SD * sphere.mean_radius) ** 2 * spread) @ moved.T)


def _why(samples: Array, fit: ShapeFit) -> str:
    """What kept the ellipsoid from converging, by what the sphere leaves."""
    rms = math.sqrt(float(np.mean(fit.residuals**2)))
    noise = math.sqrt(white_variance(fit.residuals))
    seen = float(visited((samples - fit.ellipsoid.offset) @ correction(fit.ellipsoid, None).matrix.T).mean())
    covered = f"the samples show {100.0 * seen:.0f} % of the directions of the field"
    if noise > 0.0 and rms > _CHANGED * noise:
        changed = f"the field changed while turning (residuals are {rms / noise:.1f} times the noise)"
        return changed if seen > _FULL else f"{covered}, and {changed}"
    return covered if seen <= _FULL else f"residuals of {rms:.3g} do not tell an ellipsoid from a sphere"
