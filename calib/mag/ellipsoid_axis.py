"""Ellipsoid with axes along those of the sensor, by normal equations and their Cholesky factor (METHODS S1).

``[x^2 y^2 z^2 x y z] . (a b c d e f) = 1``: offsets ``-d/2a, -e/2b, -f/2c``, radii ``sqrt(k/a) ...`` with
``k = 1 + sum a_i o_i^2``. The form "= 1" is not invariant to a shift: it cannot hold an ellipsoid through the origin.
Samples are therefore centred on their mean and scaled first. That also takes the condition of the normal equations from
1e6 to about 4. Cross terms are left in.
"""

from __future__ import annotations

from typing import Unpack

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.fit import FitResult
from mavcal.calib.mag.context import MagContext, MagFacts
from mavcal.calib.mag.ellipsoid_result import ShapeFit, ellipsoid_result
from mavcal.calib.mag.result import refusal
from mavcal.calib.mag.samples import LEAST_VARIANCE, check_not_flat, check_samples
from mavcal.calib.mag.serial import widened_scatter
from mavcal.calib.mag.shape import N_PARAMETERS, Ellipsoid
from mavcal.calib.stats.residuals import student_variance

Array = NDArray[np.float64]

METHOD = "mag-ellipsoid-axis"


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

    All of a, b, c negative is an ellipsoid too, one whose inside does not hold the origin.

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

    Parameters
    ----------
    samples : shape (N, 3)
        N >= 7.
    **facts
        What is known of sensor and field: :class:`calib.mag.context.MagContext`.

    Raises
    ------
    InvalidInputError
        If the samples have another shape or are not finite.

    Notes
    -----
    The uncertainty is propagated. The residual ``r = 1 - M x`` moves by ``|grad| d`` with the distance d of a sample.
    Hence ``Cov x = N^-1 (sum s^2 |grad|^2 M^T M) N^-1``.
    """
    context = MagContext(**facts)
    array = np.asarray(samples, dtype=np.float64)
    try:
        array = check_samples(array, 7)
        mean = array.mean(axis=0)
        scale = float(np.sqrt(((array - mean) ** 2).sum(axis=1).mean()))
        scaled = (array - mean) / scale
        check_not_flat(scaled.T @ scaled / len(scaled))
        normal, right = normal_equations(scaled)
        coefficients = solve_coefficients(normal, right)
        offset, radii = offset_and_radii(coefficients)
    except UndeterminedError as error:
        return refusal(METHOD, error, len(array), context)
    residuals, covariance, inflation = _uncertainty(scaled, normal, coefficients, offset, radii)
    fit = ShapeFit(
        method=METHOD,
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
    return ellipsoid_result(fit.moved(mean, scale), array, context)


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
