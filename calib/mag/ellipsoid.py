"""Full ellipsoid: offset and symmetric matrix by orthogonal distance, with covariance.

Adjusted least squares give the start in one pass, and a debiased Gauss-Newton finishes (METHODS 3.1). Tukey's bisquare
reduces the weight of outliers, and a prior on the soft iron can replace missing movements.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcal.calib.errors import InvalidInputError, NotConvergedError, UndeterminedError
from mavcal.calib.fit import AXES, OFFSETS, FitResult
from mavcal.calib.mag.coverage import visited
from mavcal.calib.mag.distance import ALL_SIDES, score_rows
from mavcal.calib.mag.ellipsoid_result import ShapeFit, ellipsoid_result
from mavcal.calib.mag.moments import Moments
from mavcal.calib.mag.result import UNDETERMINED_SD, MagContext, MagFacts, plausible_field, refusal
from mavcal.calib.mag.robust import find_start
from mavcal.calib.mag.samples import NEARLY_PLANAR, Array, Cloud, check_not_flat, check_real_samples, real_array
from mavcal.calib.mag.serial import white_variance
from mavcal.calib.mag.shape import N_PARAMETERS, Ellipsoid, MagModel, correction
from mavcal.calib.mag.shape_fit import METHOD, Asked, averaged_shape, minimum, with_uncertainty

AUTO = "auto"

FEWEST = N_PARAMETERS + 1
"""Least number of samples: nine parameters need a residual for their uncertainty."""

SPHERE_SOFT_IRON_SD = 0.05
"""Standard deviation of each relative soft-iron term that a sphere neglects: that of a clean vehicle."""

_MANY = 20_000  # samples that are enough to say what soft iron would do
_CHANGED = 2.0  # times the noise: residuals of a sphere, whose soft iron would have been found
_FULL = 0.3  # of the directions of the field: with more it is no matter of coverage


def fit_ellipsoid(
    samples: ArrayLike,
    *,
    model: str = MagModel.SYMMETRIC,
    robust: bool | None = None,
    prior_sd: float | None = None,
    **facts: Unpack[MagFacts],
) -> FitResult:
    """Fit ``y = S u + b`` with S symmetric, ``|u| = 1``; the model's matrix is ``F S^-1``, F the true field strength.

    Minimises ``sum rho(d_k - s^2 H_k)`` over the free numbers of b and S. The orthogonal distance of a sample is d, the
    mean curvature at its foot point H. Without a `field`, F is the mean radius of the ellipsoid (``det C = 1``).

    Parameters
    ----------
    samples : shape (N, 3)
        N >= 10 (7 for `diagonal`, 5 for `offset`), in order of time (serially correlated residuals widen the
        uncertainty). Integers are not copied.
    model
        :class:`~calib.mag.shape.MagModel`: ``offset`` (sphere), ``diagonal`` (three radii), ``symmetric``; or ``auto``:
        the three of them, weighed by their likelihood (:mod:`calib.mag.shape_fit`).
    robust
        True: Tukey's bisquare; False: least squares; None: bisquare if a sample is off by more than six standard
        deviations of the others.
    prior_sd
        Standard deviation of each relative soft-iron term (``S/r - I``) about zero, for movements that cover little:
        0.05 is a clean vehicle. None: the data alone (for ``auto``: 0.1).
    **facts
        Known facts of sensor and field, as in :class:`calib.mag.result.MagContext`.

    Returns
    -------
    FitResult
        Refused, with the missing movement, where a parameter is undetermined. The covariance is valid at 1.96 sd for
        any N: it is widened where few residuals determine the noise (Student's t).

    Raises
    ------
    InvalidInputError
        If the samples have another shape or are not finite, or `prior_sd` is not positive.
    """
    context = MagContext(**facts)
    array = real_array(samples)
    try:
        fit = ellipsoid_shape(array, model, Asked(context, robust, prior_sd))
    except UndeterminedError as error:
        return refusal(METHOD, error, len(array), context)
    return ellipsoid_result(fit, array, context)


def ellipsoid_shape(samples: NDArray[Any], model: str, asked: Asked, *, fall_back: bool = True) -> ShapeFit:
    """The ellipsoid of `samples` (N, 3) before the verdict, free as `model` says (:func:`fit_ellipsoid`).

    With `fall_back` a sphere replaces an ellipsoid that does not converge.

    Raises
    ------
    InvalidInputError
        As :func:`fit_ellipsoid`.
    UndeterminedError
        If the samples are too few or flat, lie on no ellipsoid, or hold too many outliers.
    """
    if asked.prior_sd is not None and not asked.prior_sd > 0.0:
        raise InvalidInputError(f"the prior on soft iron must have a positive standard deviation, not {asked.prior_sd}")
    if model not in {*MagModel, AUTO}:
        raise InvalidInputError(f"a magnetometer model is one of {', '.join([*MagModel, AUTO])}, not {model!r}")
    free = MagModel.SYMMETRIC if model == AUTO else MagModel(model)
    asked = dataclasses.replace(asked, model=free)
    check_real_samples(samples, free.size + 1)
    cloud = Cloud.of(samples, asked.precision)
    moments = Moments.of(cloud)
    check_not_flat(moments.scatter())
    smallest = max(asked.context.quantum / np.sqrt(12.0), np.sqrt(asked.least_variance)) / cloud.scale
    try:
        try:
            start = find_start(cloud, moments, smallest, free)
            if model == AUTO:
                return averaged_shape(cloud, start, asked).moved(cloud.centre, cloud.scale)
            found = minimum(cloud, start, asked)
        except UndeterminedError:
            check_not_flat(moments.scatter(), NEARLY_PLANAR)
            raise
        return with_uncertainty(found, cloud, asked).moved(cloud.centre, cloud.scale)
    except NotConvergedError as error:
        if model == MagModel.OFFSET or not fall_back:
            raise
        return _sphere_instead(samples, asked, error)


def _sphere_instead(samples: NDArray[Any], asked: Asked, error: NotConvergedError) -> ShapeFit:
    """The sphere of `samples` (N, 3), whose ellipsoid ended in `error`.

    Its covariance includes the effect of 5 % of soft iron. Its matrix is undetermined, and so is an offset that this
    leaves unknown along some axes.

    Raises
    ------
    UndeterminedError
        `error`, where the samples lie on no sphere either.
    """
    try:
        fit = ellipsoid_shape(samples, MagModel.OFFSET, dataclasses.replace(asked, prior_sd=None), fall_back=False)
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
        undetermined=dict.fromkeys([*names, *(f"matrix_{a}{b}" for a in AXES for b in AXES)], ALL_SIDES),
        fallback_reason=f"the ellipsoid did not converge: {_why(thinned, fit)}",
        warnings=(
            f"a sphere takes the place of the ellipsoid: the sd of its offset includes soft iron of "
            f"{100.0 * SPHERE_SOFT_IRON_SD:.0f} %, the matrix stays as it is",
        ),
    )


def _by_soft_iron(samples: Array, sphere: Ellipsoid) -> Array:
    """Covariance (9, 9) that neglected soft iron ``S/r - I ~ N(0, sd^2)`` adds to a sphere."""
    rows = score_rows(samples, sphere)
    free = MagModel.OFFSET.basis
    ours = free.T @ rows
    moved = np.vstack([np.zeros((3, 6)), np.eye(6)]) - free @ np.linalg.solve(ours @ ours.T, ours @ rows[3:].T)
    spread = np.eye(6)
    spread[:3, :3] -= 1.0 / 3.0
    return np.asarray(moved @ ((SPHERE_SOFT_IRON_SD * sphere.mean_radius) ** 2 * spread) @ moved.T)


def _why(samples: Array, fit: ShapeFit) -> str:
    """Reason why the ellipsoid did not converge, from the residuals of the sphere."""
    rms = math.sqrt(float(np.mean(fit.residuals**2)))
    noise = math.sqrt(white_variance(fit.residuals))
    seen = float(visited((samples - fit.ellipsoid.offset) @ correction(fit.ellipsoid, None).matrix.T).mean())
    covered = f"the samples show {100.0 * seen:.0f} % of the directions of the field"
    if noise > 0.0 and rms > _CHANGED * noise:
        changed = f"the field changed while turning (residuals are {rms / noise:.1f} times the noise)"
        return changed if seen > _FULL else f"{covered}, and {changed}"
    return covered if seen <= _FULL else f"residuals of {rms:.3g} do not tell an ellipsoid from a sphere"
