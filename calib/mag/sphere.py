"""Sphere: offset and radius by one linear system (METHODS S1)."""

from __future__ import annotations

from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.fit import FitResult
from mavcal.calib.mag.context import MagContext, MagFacts
from mavcal.calib.mag.ellipsoid_result import ShapeFit, ellipsoid_result
from mavcal.calib.mag.result import refusal
from mavcal.calib.mag.samples import LEAST_VARIANCE, check_not_flat, check_samples
from mavcal.calib.mag.serial import weakened_information
from mavcal.calib.mag.shape import N_PARAMETERS, Ellipsoid
from mavcal.calib.stats.residuals import student_variance

Array = NDArray[np.float64]

METHOD = "mag-sphere"


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
    """Fit offset and radius; soft iron is left in (3 to 9 % of it cost that much of the field).

    Parameters
    ----------
    samples : shape (N, 3)
        N >= 5.
    **facts
        What is known of sensor and field: :class:`calib.mag.context.MagContext`.

    Raises
    ------
    InvalidInputError
        If the samples have another shape or are not finite.

    Notes
    -----
    The algebraic residual is ``2 R d`` with d the distance from the sphere. To first order, least squares on it has the
    covariance ``s^2 (J^T J)^-1`` with ``J = [n 1]``.
    """
    context = MagContext(**facts)
    array = np.asarray(samples, dtype=np.float64)
    try:
        array = check_samples(array, 5)
        mean = array.mean(axis=0)
        scale = float(np.sqrt(((array - mean) ** 2).sum(axis=1).mean()))
        scaled = (array - mean) / scale
        check_not_flat(scaled.T @ scaled / len(scaled))
        offset, radius = solve_sphere(scaled)
    except UndeterminedError as error:
        return refusal(METHOD, error, len(array), context)
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
        method=METHOD,
        ellipsoid=Ellipsoid(offset, radius * np.eye(3)),
        covariance=expand @ np.linalg.inv(information) @ expand.T,
        residuals=residuals,
        dof=dof,
        condition_number=float(np.linalg.cond(information)),
        form="sphere",
        native={"offset": (mean + scale * offset).tolist(), "radius": radius * scale},
        variance_inflation=inflation,
    )
    return ellipsoid_result(fit.moved(mean, scale), array, context)
