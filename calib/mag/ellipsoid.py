"""Full ellipsoid: offset and symmetric matrix by orthogonal distance, with a covariance that holds.

Adjusted least squares give the start in one pass, a debiased Gauss-Newton finishes (METHODS 3.1); outliers are weighed
down by Tukey's bisquare, and a prior on the soft iron can stand in for movements that were not made.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcal.calib.errors import InvalidInputError, NotConvergedError, UndeterminedError
from mavcal.calib.fit import FitResult
from mavcal.calib.mag.auto import averaged_shape
from mavcal.calib.mag.context import MagContext, MagFacts
from mavcal.calib.mag.fallback import sphere_instead
from mavcal.calib.mag.result import ShapeFit, magnetometer_result, refusal
from mavcal.calib.mag.samples import real_array
from mavcal.calib.mag.shape import N_PARAMETERS, MagModel
from mavcal.calib.mag.shape_fit import METHOD, Asked, shape_of

AUTO = "auto"

FEWEST = N_PARAMETERS + 1
"""Samples below which there is no residual of nine parameters, hence no uncertainty."""


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
        the three of them, weighed by their likelihood (:mod:`calib.mag.auto`).
    robust
        True: Tukey's bisquare; False: least squares; None: bisquare if a sample is off by more than six standard
        deviations of the others.
    prior_sd
        Standard deviation of each relative soft-iron term (``S/r - I``) about zero, for movements that cover little:
        0.05 is a clean vehicle. None: the data alone (for ``auto``: 0.1).
    **facts
        What is known of sensor and field: :class:`calib.mag.result.MagContext`.

    Returns
    -------
    FitResult
        Refused, with the movement that is missing, where the data leave a parameter open. The covariance holds with
        1.96 sd at any N: noise that is known from few residuals only has widened it (Student's t).

    Raises
    ------
    InvalidInputError
        If the samples have another shape or are not finite, or `prior_sd` is not positive.
    """
    context = MagContext(**facts)
    array = real_array(samples)
    try:
        fit = ellipsoid_shape(array, context, model=model, robust=robust, prior_sd=prior_sd)
    except UndeterminedError as error:
        return refusal(METHOD, error, len(array), context)
    return magnetometer_result(fit, array, context)


def ellipsoid_shape(
    samples: NDArray[Any],
    context: MagContext,
    *,
    model: str = MagModel.SYMMETRIC,
    robust: bool | None = None,
    prior_sd: float | None = None,
    precision: NDArray[np.float64] | None = None,
    least_variance: float = 0.0,
    fall_back: bool = True,
) -> ShapeFit:
    """The ellipsoid alone, before the verdict; parameters as for :func:`fit_ellipsoid`.

    `precision` and `least_variance` are those of :class:`calib.mag.shape_fit.Asked`. With `fall_back` an ellipsoid that
    does not converge is answered by the sphere (:mod:`calib.mag.fallback`).

    Raises
    ------
    InvalidInputError
        As :func:`fit_ellipsoid`.
    UndeterminedError
        If the samples leave a parameter open.
    """
    if prior_sd is not None and not prior_sd > 0.0:
        raise InvalidInputError(f"the prior on soft iron must have a positive standard deviation, not {prior_sd}")
    asked = Asked(context, robust, prior_sd, precision=precision, least_variance=least_variance)
    wanted = None if model == AUTO else _model_named(model)
    try:
        if wanted is None:
            return averaged_shape(samples, asked)
        return shape_of(samples, dataclasses.replace(asked, model=wanted))
    except NotConvergedError as error:
        if wanted is MagModel.OFFSET or not fall_back:
            raise
        return sphere_instead(samples, asked, error)


def _model_named(name: str) -> MagModel:
    try:
        return MagModel(name)
    except ValueError as error:
        known = ", ".join([*MagModel, AUTO])
        raise InvalidInputError(f"a magnetometer model is one of {known}, not {name!r}") from error
