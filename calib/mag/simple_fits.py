"""Extremes, sphere and ellipsoid along the axes: fits without iteration, and starting values (METHODS S1, S5).

The middle and half of the range of every axis have no residual. The sphere has offset and radius by one linear system.

The ellipsoid along the axes comes from normal equations and their Cholesky factor,
``[x^2 y^2 z^2 x y z] . (a b c d e f) = 1``: offsets ``-d/2a, -e/2b, -f/2c``, radii ``sqrt(k/a) ...`` with
``k = 1 + sum a_i o_i^2``. The form "= 1" is not invariant to a shift: it cannot hold an ellipsoid through the origin.
Samples are therefore centred on their mean and scaled first. That also takes the condition of the normal equations from
1e6 to about 4. Cross terms are left in.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Unpack

import numpy as np
import scipy
from numpy.typing import ArrayLike

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.fit import FitResult
from mavcal.calib.mag.ellipsoid_result import ShapeFit, ellipsoid_result
from mavcal.calib.mag.result import MagContext, MagFacts, refusal
from mavcal.calib.mag.samples import LEAST_VARIANCE, Array, check_not_flat, check_samples
from mavcal.calib.mag.serial import weakened_information, white_variance, widened_scatter
from mavcal.calib.mag.shape import N_PARAMETERS, Ellipsoid
from mavcal.calib.stats.residuals import student_variance

MINMAX = "mag-minmax"
SPHERE = "mag-sphere"
ALONG_AXES = "mag-ellipsoid-axis"


def _fitted(
    method: str, least: int, samples: ArrayLike, facts: MagFacts, solve: Callable[[Array], ShapeFit]
) -> FitResult:
    """The verdict on the result of `solve`; refused with fewer than `least` samples, or if they determine nothing."""
    context = MagContext(**facts)
    array = np.asarray(samples, dtype=np.float64)
    try:
        array = check_samples(array, least)
        fit = solve(array)
    except UndeterminedError as error:
        return refusal(method, error, len(array), context)
    return ellipsoid_result(fit, array, context)


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
        Known facts of sensor and field, as in :class:`calib.mag.result.MagContext`.

    Raises
    ------
    InvalidInputError
        If the samples have another shape or are not finite.

    Notes
    -----
    The standard deviation of an extreme is the residual s of the corrected length, which includes soft iron and missing
    directions. Half a range is also too long by up to ``s_w sqrt(2 ln N)`` for white noise s_w, since the extremes
    include noise.
    """
    return _fitted(MINMAX, 4, samples, facts, _from_extremes)


def _from_extremes(array: Array) -> ShapeFit:
    offset, half = half_range(array)
    if not (half > 0.0).all():
        raise UndeterminedError(
            f"axis {'xyz'[int(np.argmin(half))]} of the magnetometer never changes",
            remedy="turn the vehicle so that every side points up and down once; if it stays, the sensor is broken",
        )
    check_not_flat(np.cov(array.T / half.max()))
    scaled = (array - offset) / half
    residuals = (np.linalg.norm(scaled, axis=1) - 1.0) * float(np.cbrt(np.prod(half)))
    middle = 0.5 * float(np.mean(residuals**2))
    stretched = white_variance(residuals) * 2.0 * math.log(len(array))
    covariance = np.zeros((N_PARAMETERS, N_PARAMETERS))
    np.fill_diagonal(covariance[:6, :6], [middle] * 3 + [middle + stretched] * 3)
    return ShapeFit(
        method=MINMAX,
        ellipsoid=Ellipsoid(offset, np.diag(half)),
        covariance=covariance,
        residuals=residuals,
        dof=max(len(array) - 6, 1),
        condition_number=1.0,
        form="ellipsoid along the sensor's axes",
        native={"offset": offset.tolist(), "half_range": half.tolist()},
        warnings=("extremes only: one spike moves this by half its size; a starting value, not a calibration",),
    )


def _scaled(samples: Array) -> tuple[Array, Array, float]:
    """Samples centred on their mean and scaled, that mean (3,), and the scale. Raises UndeterminedError if flat."""
    mean = samples.mean(axis=0)
    scale = float(np.sqrt(((samples - mean) ** 2).sum(axis=1).mean()))
    scaled = (samples - mean) / scale
    check_not_flat(scaled.T @ scaled / len(scaled))
    return scaled, mean, scale


def solve_sphere(samples: Array) -> tuple[Array, float]:
    """Offset (3,) and radius from rows ``[m_x m_y m_z -1][a b c d] = -m.m``.

    ``offset = -(a, b, c)/2`` and ``R^2 = d + |offset|^2``.

    Raises
    ------
    UndeterminedError
        If the samples lie in a plane.
    """
    rows = np.column_stack([samples, -np.ones(len(samples))])
    coefficients, _, rank, _ = np.linalg.lstsq(rows, -np.einsum("ij,ij->i", samples, samples), rcond=None)
    offset = -0.5 * coefficients[:3]
    square = float(coefficients[3] + offset @ offset)
    if rank < 4 or square <= 0.0:
        raise UndeterminedError(
            "the magnetometer samples lie on no sphere", remedy="turn the vehicle through circles about two axes"
        )
    return offset, float(np.sqrt(square))


def fit_sphere(samples: ArrayLike, **facts: Unpack[MagFacts]) -> FitResult:
    """Fit offset and radius, neglecting soft iron (3 to 9 % of the field).

    Parameters and errors are those of :func:`fit_minmax`, with N >= 5.

    Notes
    -----
    The algebraic residual is ``2 R d`` with d the distance from the sphere. To first order, least squares on it has the
    covariance ``s^2 (J^T J)^-1`` with ``J = [n 1]``.
    """
    return _fitted(SPHERE, 5, samples, facts, _of_sphere)


def _of_sphere(array: Array) -> ShapeFit:
    scaled, mean, scale = _scaled(array)
    offset, radius = solve_sphere(scaled)
    from_centre = scaled - offset
    length = np.linalg.norm(from_centre, axis=1)
    residuals = length - radius
    rows = np.vstack([from_centre.T / np.maximum(length, 1e-12), np.ones(len(scaled))])
    dof = len(scaled) - 4
    variance = max(float(residuals @ residuals) / dof * student_variance(dof), LEAST_VARIANCE)
    information, inflation = weakened_information(rows @ rows.T / variance, rows, residuals)
    expand = np.zeros((N_PARAMETERS, 4))
    expand[:3, :3] = np.eye(3)
    expand[3:6, 3] = 1.0
    fit = ShapeFit(
        method=SPHERE,
        ellipsoid=Ellipsoid(offset, radius * np.eye(3)),
        covariance=expand @ np.linalg.inv(information) @ expand.T,
        residuals=residuals,
        dof=dof,
        condition_number=float(np.linalg.cond(information)),
        form="sphere",
        native={"offset": (mean + scale * offset).tolist(), "radius": radius * scale},
        variance_inflation=inflation,
    )
    return fit.moved(mean, scale)


def normal_equations(samples: Array) -> tuple[Array, Array]:
    """``N = M^T M`` (6, 6) and ``M^T 1`` (6,), rows of M being ``x^2 y^2 z^2 x y z``."""
    rows = np.column_stack([samples**2, samples])
    return rows.T @ rows, rows.sum(axis=0)


def solve_coefficients(normal: Array, right: Array) -> Array:
    """``(a b c d e f)`` from ``N = L L^T``: forward ``L z = M^T 1``, back ``L^T x = z``.

    Raises
    ------
    UndeterminedError
        If N is not positive definite.
    """
    try:
        lower = np.linalg.cholesky(normal)
    except np.linalg.LinAlgError as error:
        raise _undetermined() from error
    forward = scipy.linalg.solve_triangular(lower, right, lower=True)
    return np.asarray(scipy.linalg.solve_triangular(lower.T, forward, lower=False))


def offset_and_radii(coefficients: Array) -> tuple[Array, Array]:
    """Offset (3,) and radii (3,) of ``(a b c d e f)``.

    If a, b and c are all negative, it is an ellipsoid that does not enclose the origin.

    Raises
    ------
    UndeterminedError
        If the coefficients describe no ellipsoid.
    """
    quadratic, linear = coefficients[:3], coefficients[3:]
    if not (np.all(quadratic > 0.0) or np.all(quadratic < 0.0)):
        raise _undetermined()
    offset = -linear / (2.0 * quadratic)
    squares = (1.0 + float(quadratic @ offset**2)) / quadratic
    if not np.all(squares > 0.0):
        raise _undetermined()
    return offset, np.sqrt(squares)


def fit_ellipsoid_axis(samples: ArrayLike, **facts: Unpack[MagFacts]) -> FitResult:
    """Fit offset and three radii.

    Parameters and errors are those of :func:`fit_minmax`, with N >= 7.

    Notes
    -----
    The uncertainty is propagated. The residual ``r = 1 - M x`` moves by ``|grad| d`` with the distance d of a sample.
    Hence ``Cov x = N^-1 (sum s^2 |grad|^2 M^T M) N^-1``.
    """
    return _fitted(ALONG_AXES, 7, samples, facts, _of_ellipsoid)


def _of_ellipsoid(array: Array) -> ShapeFit:
    scaled, mean, scale = _scaled(array)
    normal, right = normal_equations(scaled)
    coefficients = solve_coefficients(normal, right)
    offset, radii = offset_and_radii(coefficients)
    residuals, covariance, inflation = _uncertainty(scaled, normal, coefficients, offset, radii)
    fit = ShapeFit(
        method=ALONG_AXES,
        ellipsoid=Ellipsoid(offset, np.diag(radii)),
        covariance=covariance,
        residuals=residuals,
        dof=len(scaled) - 6,
        condition_number=float(np.linalg.cond(normal)),
        form="ellipsoid along the sensor's axes",
        native={
            "offset": (mean + scale * offset).tolist(),
            "axis_radii": (scale * radii).tolist(),
            "sensitivities": (radii[0] / radii).tolist(),
        },
        warnings=("cross terms are not part of this method: whatever soft iron couples the axes stays in",),
        variance_inflation=inflation,
    )
    return fit.moved(mean, scale)


def _uncertainty(
    scaled: Array, normal: Array, coefficients: Array, offset: Array, radii: Array
) -> tuple[Array, Array, float]:
    """Distances (N,) to first order, the (9, 9) covariance with cross terms fixed, and its inflation."""
    quadratic = coefficients[:3]
    rows = np.column_stack([scaled**2, scaled])
    gradient = np.linalg.norm(2.0 * quadratic * (scaled - offset), axis=1)
    residuals = np.sign(quadratic[0]) * (rows @ coefficients - 1.0) / np.maximum(gradient, 1e-12)
    dof = len(scaled) - 6
    variance = max(float(residuals @ residuals) / dof * student_variance(dof), LEAST_VARIANCE)
    inverse = np.linalg.inv(normal)
    weighted = rows * gradient[:, None]
    scatter, inflation = widened_scatter(weighted.T @ weighted, weighted.T, residuals)
    cov6 = variance * inverse @ scatter @ inverse
    # o = -l/2q, r^2 = (1 + sum q o^2)/q: derivatives by q (3) and l (3), with d(sum q o^2) = -o^2 dq - o dl.
    by_offset = np.hstack([-np.diag(offset / quadratic), -np.diag(0.5 / quadratic)])
    common = np.concatenate([-(offset**2), -offset])
    by_square = (common[None, :] - np.hstack([np.diag(radii**2), np.zeros((3, 3))])) / quadratic[:, None]
    jacobian = np.zeros((N_PARAMETERS, 6))
    jacobian[:3] = by_offset
    jacobian[3:6] = by_square / (2.0 * radii[:, None])
    return residuals, jacobian @ cov6 @ jacobian.T, inflation


def _undetermined() -> UndeterminedError:
    return UndeterminedError(
        "the magnetometer samples lie on no ellipsoid along the sensor's axes",
        remedy="turn the vehicle so that every side points up and down once; or fit the full ellipsoid",
    )
