"""Least-squares ellipsoid of a cloud of samples, plain or robust, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.mag.context import MagContext
from mavcal.calib.mag.distance import ALL_SIDES, Distances, ShapeTerms, Solution, bisquare, gauss_newton
from mavcal.calib.mag.ellipsoid_result import ShapeFit
from mavcal.calib.mag.robust import MOST_OUTLIERS, Start, robust_sd
from mavcal.calib.mag.samples import LEAST_VARIANCE, Cloud
from mavcal.calib.mag.serial import LONGEST, weakened_information
from mavcal.calib.mag.shape import N_PARAMETERS, MagModel
from mavcal.calib.stats.residuals import student_variance

Array = NDArray[np.float64]

METHOD = "mag-ellipsoid"

_SCALE_ROUNDS = 4
_SINGULAR = 1e-13  # smallest over largest information that is more than rounding
_MEASURED_NOISE = 30  # degrees of freedom from which on residuals know the noise better than a data sheet


@dataclass(frozen=True, eq=False)
class Asked:
    """How to fit an ellipsoid."""

    context: MagContext
    robust: bool | None = None
    prior_sd: float | None = None
    cross_sd: float | None = None
    """Prior of the three cross terms; None: as `prior_sd`."""
    model: MagModel = MagModel.SYMMETRIC
    precision: Array | None = None
    """Precision of the samples, as :class:`calib.mag.samples.Cloud` has it."""
    least_variance: float = 0.0
    """Lower limit of the residuals' variance, in squared units of the samples."""

    @property
    def terms(self) -> ShapeTerms:
        """Free parameters and prior for the minimisation."""
        return ShapeTerms(self.model, self.prior_sd, self.cross_sd)


@dataclass(frozen=True, eq=False)
class ShapeSolution:
    """A solution in the scale of its cloud, with the weights of the samples."""

    solution: Solution
    tukey_scale: float | None
    """Scale of the bisquare weights; None: they are all one."""

    def weights(self) -> Array | None:
        """Weight of every sample (N,); None: one."""
        return None if self.tukey_scale is None else bisquare(self.solution.last.residuals, self.tukey_scale)[0]


def minimum(cloud: Cloud, start: Start, asked: Asked) -> ShapeSolution:
    """The minimum from `start`; bisquare weights where outliers are suspected, the noise re-estimated within 1 %."""
    distances = Distances(cloud)
    if not (start.outliers if asked.robust is None else asked.robust):
        plain = gauss_newton(
            distances,
            start.ellipsoid,
            start.noise_sd**2,
            terms=asked.terms,
            first=start.first,
        )
        return ShapeSolution(plain, None)
    smallest = np.sqrt(asked.least_variance) / cloud.scale
    ellipsoid, sd = start.ellipsoid, start.noise_sd
    for _ in range(_SCALE_ROUNDS):
        solution = gauss_newton(
            distances,
            ellipsoid,
            sd**2,
            terms=asked.terms,
            tukey_scale=sd,
        )
        ellipsoid, previous = solution.ellipsoid, sd
        sd = robust_sd(solution.last.residuals, max(0.01 * sd, smallest))
        if abs(sd - previous) <= 0.01 * sd:
            break
    return ShapeSolution(solution, previous)


def with_uncertainty(found: ShapeSolution, cloud: Cloud, asked: Asked) -> ShapeFit:
    """The ellipsoid `found` with its covariance, in the scale of `cloud`.

    Raises
    ------
    UndeterminedError
        Too many outliers, too few samples without them, or a parameter that is open.
    """
    solution, model = found.solution, asked.model
    residuals, weights = solution.last.residuals, found.weights()
    kept = residuals if weights is None else residuals[weights > 0.0]
    dof = _degrees_of_freedom(len(residuals), len(kept), model.size)
    variance = estimate_variance(residuals, weights, model.size)
    known = asked.context.noise_variance
    if known is not None and dof < _MEASURED_NOISE:
        variance = max(variance, known / cloud.scale**2)
    else:
        variance *= student_variance(dof)
    variance = max(variance, asked.least_variance / cloud.scale**2)
    free = model.basis
    information, inflation = weakened_information(
        free.T @ solution.last.information @ free / max(variance, LEAST_VARIANCE),
        free.T @ Distances(cloud).scores(solution.ellipsoid, LONGEST),
        residuals[:LONGEST] if weights is None else residuals[:LONGEST] * weights[:LONGEST],
    )
    normal = information + free.T @ solution.prior @ free
    spread = np.linalg.eigvalsh(normal)
    if not spread[0] > _SINGULAR * spread[-1]:
        raise UndeterminedError("the magnetometer samples leave a parameter of the ellipsoid open", remedy=ALL_SIDES)
    return ShapeFit(
        method=METHOD,
        ellipsoid=solution.ellipsoid,
        covariance=free @ np.linalg.inv(normal) @ free.T,
        residuals=kept,
        dof=dof,
        condition_number=float(spread[-1] / spread[0]),
        n_outliers=len(residuals) - len(kept),
        variance_inflation=inflation,
        native={"model": str(model)},
    )


def _degrees_of_freedom(count: int, kept: int, size: int) -> float:
    if count - kept > MOST_OUTLIERS * count:
        raise UndeterminedError(
            f"{1.0 - kept / count:.0%} of the magnetometer samples lie off the ellipsoid of the others",
            remedy="find what disturbs the field (motors, steel, a phone nearby) and repeat",
        )
    if kept <= size:
        raise UndeterminedError("too few magnetometer samples remain without the outliers", remedy="record longer")
    return float(kept - size)


def estimate_variance(residuals: Array, weights: Array | None, size: int = N_PARAMETERS) -> float:
    """The v with which ``v (sum w J^T J)^-1`` is the covariance of `size` parameters; weights None: all are one.

    ``Cov = [sum psi^2/(N - p)] / [mean psi']^2 (sum J^T J)^-1`` (Huber 1981, 7.6), ``psi = w r``; for the bisquare with
    ``w = (1 - z^2)^2``, ``psi' = (1 - z^2)(1 - 5 z^2)``.
    """
    degrees = max(len(residuals) - size, 1)
    if weights is None:
        return float(residuals @ residuals) / degrees
    psi = weights * residuals
    root = np.sqrt(weights)
    slope = root * (5.0 * root - 4.0)
    return float(psi @ psi) / degrees / float(slope.mean()) ** 2 * float(weights.mean())
