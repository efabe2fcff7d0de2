"""Full ellipsoid: offset and symmetric matrix by orthogonal distance, with a covariance that holds.

Adjusted least squares give the start in one pass, a debiased Gauss-Newton finishes (METHODS 3.1); outliers are weighed
down by Tukey's bisquare, and a prior on the soft iron can stand in for movements that were not made.
"""

from __future__ import annotations

from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import InvalidInputError, UndeterminedError
from calib.fit import FitResult
from calib.mag.distance import ALL_SIDES, Distances, Solution, bisquare, gauss_newton, score_rows
from calib.mag.moments import Moments
from calib.mag.result import MagContext, MagFacts, ShapeFit, magnetometer_result, refusal, student_variance
from calib.mag.robust import MOST_OUTLIERS, Start, find_start, robust_sd
from calib.mag.samples import LEAST_VARIANCE, NEARLY_PLANAR, check_not_flat, check_samples
from calib.mag.serial import LONGEST, weakened_information
from calib.mag.shape import N_PARAMETERS

Array = NDArray[np.float64]

METHOD = "mag-ellipsoid"

FEWEST = N_PARAMETERS + 1
"""Samples below which there is no residual, hence no uncertainty."""

_SCALE_ROUNDS = 4
_SINGULAR = 1e-13  # smallest over largest information that is more than rounding
_MEASURED_NOISE = 30  # degrees of freedom from which on residuals know the noise better than a data sheet


def fit_ellipsoid(
    samples: ArrayLike,
    *,
    robust: bool | None = None,
    prior_sd: float | None = None,
    **facts: Unpack[MagFacts],
) -> FitResult:
    """Fit ``y = S u + b`` with S symmetric, ``|u| = 1``; the model's matrix is ``F S^-1``, F the true field strength.

    Minimises ``sum rho(d_k - s^2 H_k)`` over the nine numbers of b and S, d the orthogonal distance of a sample and H
    the mean curvature at its foot point. Without a `field`, F is the mean radius of the ellipsoid (``det C = 1``).

    Parameters
    ----------
    samples : shape (N, 3)
        N >= 10, in order of time (serially correlated residuals widen the uncertainty).
    robust
        True: Tukey's bisquare; False: least squares; None: bisquare if a sample is off by more than six standard
        deviations of the others.
    prior_sd
        Standard deviation of each relative soft-iron term (``S/r - I``) about zero, for movements that cover little:
        0.05 is a clean vehicle. None: the data alone.
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
    if prior_sd is not None and not prior_sd > 0.0:
        raise InvalidInputError(f"the prior on soft iron must have a positive standard deviation, not {prior_sd}")
    array = np.asarray(samples, dtype=np.float64)
    try:
        fit = shape_of(check_samples(array, FEWEST), context, robust=robust, prior_sd=prior_sd)
    except UndeterminedError as error:
        return refusal(METHOD, error, len(array), context)
    return magnetometer_result(fit, array, context)


def shape_of(samples: Array, context: MagContext, *, robust: bool | None, prior_sd: float | None) -> ShapeFit:
    """The ellipsoid of checked `samples` (N, 3) and its covariance.

    Raises
    ------
    UndeterminedError
        If the samples are flat, lie on no ellipsoid, or hold too many outliers.
    """
    centre = samples.mean(axis=0)
    scaled = samples - centre
    scale = float(np.sqrt(np.vdot(scaled, scaled) / len(scaled)))
    scaled /= scale
    moments = Moments.empty(np.zeros(3), 1.0).added(scaled)
    check_not_flat(moments.scatter())
    try:
        solution, tukey_scale = _solved(scaled, moments, context.quantum / scale, robust, prior_sd)
    except UndeterminedError:
        check_not_flat(moments.scatter(), NEARLY_PLANAR)
        raise
    return _with_uncertainty(solution, tukey_scale, scaled, context, scale).moved(centre, scale)


def _solved(
    scaled: Array, moments: Moments, quantum: float, robust: bool | None, prior_sd: float | None
) -> tuple[Solution, float | None]:
    """The minimum, and the scale of its bisquare weights; None: they are all one."""
    start = find_start(scaled, moments, quantum / np.sqrt(12.0))
    if start.outliers if robust is None else robust:
        return _robust_solution(Distances(scaled), start, prior_sd)
    plain = gauss_newton(Distances(scaled), start.ellipsoid, start.noise_sd**2, prior_sd=prior_sd, first=start.first)
    return plain, None


def _robust_solution(distances: Distances, start: Start, prior_sd: float | None) -> tuple[Solution, float]:
    """Gauss-Newton with bisquare weights, the noise re-estimated from the inliers until it stays within 1 %."""
    ellipsoid, sd = start.ellipsoid, start.noise_sd
    for _ in range(_SCALE_ROUNDS):
        solution = gauss_newton(distances, ellipsoid, sd**2, tukey_scale=sd, prior_sd=prior_sd)
        ellipsoid, previous = solution.ellipsoid, sd
        sd = robust_sd(solution.last.residuals, 0.01 * sd)
        if abs(sd - previous) <= 0.01 * sd:
            break
    return solution, previous


def _with_uncertainty(
    solution: Solution, tukey_scale: float | None, scaled: Array, context: MagContext, scale: float
) -> ShapeFit:
    residuals = solution.last.residuals
    weights = np.ones(len(residuals)) if tukey_scale is None else bisquare(residuals, tukey_scale)[0]
    kept = weights > 0.0
    if np.mean(~kept) > MOST_OUTLIERS:
        raise UndeterminedError(
            f"{np.mean(~kept):.0%} of the magnetometer samples lie off the ellipsoid of the others",
            remedy="find what disturbs the field (motors, steel, a phone nearby) and repeat",
        )
    dof = float(np.count_nonzero(kept) - N_PARAMETERS)
    if dof < 1.0:
        raise UndeterminedError("too few magnetometer samples remain without the outliers", remedy="record longer")
    variance = estimate_variance(residuals, weights) * student_variance(dof)
    if context.noise_variance is not None and dof < _MEASURED_NOISE:
        variance = max(estimate_variance(residuals, weights), context.noise_variance / scale**2)
    information, inflation = weakened_information(
        solution.last.information / max(variance, LEAST_VARIANCE),
        score_rows(scaled[:LONGEST], solution.ellipsoid),
        residuals * weights,
    )
    normal = information + solution.prior
    spread = np.linalg.eigvalsh(normal)
    if not spread[0] > _SINGULAR * spread[-1]:
        raise UndeterminedError("the magnetometer samples leave a parameter of the ellipsoid open", remedy=ALL_SIDES)
    return ShapeFit(
        method=METHOD,
        ellipsoid=solution.ellipsoid,
        covariance=np.asarray(np.linalg.inv(normal)),
        residuals=residuals[kept],
        dof=dof,
        condition_number=float(spread[-1] / spread[0]),
        n_outliers=int(np.count_nonzero(~kept)),
        variance_inflation=inflation,
    )


def estimate_variance(residuals: Array, weights: Array) -> float:
    """The v with which ``v (sum w J^T J)^-1`` is the covariance, for bisquare and plain weights (1).

    ``Cov = [sum psi^2/(N - p)] / [mean psi']^2 (sum J^T J)^-1`` (Huber 1981, 7.6), ``psi = w r``; for the bisquare with
    ``w = (1 - z^2)^2``, ``psi' = (1 - z^2)(1 - 5 z^2)``.
    """
    psi = weights * residuals
    root = np.sqrt(weights)
    slope = root * (5.0 * root - 4.0)
    spread = float(psi @ psi) / max(len(residuals) - N_PARAMETERS, 1)
    return spread / float(slope.mean()) ** 2 * float(weights.mean())
