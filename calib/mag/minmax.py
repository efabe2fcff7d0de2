"""Middle and half of the range of every axis (METHODS S5): a starting value that checks nothing."""

from __future__ import annotations

import math
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.fit import FitResult
from mavcal.calib.mag.context import MagContext, MagFacts
from mavcal.calib.mag.ellipsoid_result import ShapeFit, ellipsoid_result
from mavcal.calib.mag.result import refusal
from mavcal.calib.mag.samples import check_not_flat, check_samples
from mavcal.calib.mag.serial import white_variance
from mavcal.calib.mag.shape import N_PARAMETERS, Ellipsoid

Array = NDArray[np.float64]

METHOD = "mag-minmax"


def half_range(samples: Array) -> tuple[Array, Array]:
    """``b = (min + max)/2`` and ``(max - min)/2`` of every axis.

    >>> half_range(np.array([[300, -120, 60], [-180, 310, 40], [60, 80, -400], [40, 100, 420]]))
    (array([60., 95., 10.]), array([240., 215., 410.]))
    """
    low, high = samples.min(axis=0), samples.max(axis=0)
    return 0.5 * (low + high), 0.5 * (high - low)


def fit_minmax(samples: ArrayLike, **facts: Unpack[MagFacts]) -> FitResult:
    """Offset and scale from the extremes of every axis.

    Parameters
    ----------
    samples : shape (N, 3)
        N >= 4.
    **facts
        What is known of sensor and field: :class:`calib.mag.context.MagContext`.

    Raises
    ------
    InvalidInputError
        If the samples have another shape or are not finite.

    Notes
    -----
    Taken as the standard deviation of an extreme: the residual s of the corrected length, with all the soft iron and
    missing directions that are in it. Half a range is too long besides, by up to ``s_w sqrt(2 ln N)`` with the white
    noise s_w: the extremes are those of the noise.
    """
    context = MagContext(**facts)
    array = np.asarray(samples, dtype=np.float64)
    try:
        array = check_samples(array, 4)
        offset, half = half_range(array)
        if not (half > 0.0).all():
            raise UndeterminedError(
                f"axis {'xyz'[int(np.argmin(half))]} of the magnetometer never changes",
                remedy="turn the vehicle so that every side points up and down once; if it stays, the sensor is broken",
            )
        check_not_flat(np.cov(array.T / half.max()))
    except UndeterminedError as error:
        return refusal(METHOD, error, len(array), context)
    scaled = (array - offset) / half
    residuals = (np.linalg.norm(scaled, axis=1) - 1.0) * float(np.cbrt(np.prod(half)))
    middle = 0.5 * float(np.mean(residuals**2))
    stretched = white_variance(residuals) * 2.0 * math.log(len(array))
    covariance = np.zeros((N_PARAMETERS, N_PARAMETERS))
    np.fill_diagonal(covariance[:6, :6], [middle] * 3 + [middle + stretched] * 3)
    fit = ShapeFit(
        method=METHOD,
        ellipsoid=Ellipsoid(offset, np.diag(half)),
        covariance=covariance,
        residuals=residuals,
        dof=max(len(array) - 6, 1),
        condition_number=1.0,
        form="ellipsoid along the sensor's axes",
        native={"offset": offset.tolist(), "half_range": half.tolist()},
        warnings=("extremes only: one spike moves this by half its size; a starting value, not a calibration",),
    )
    return ellipsoid_result(fit, array, context)
