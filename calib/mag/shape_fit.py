"""Least-squares ellipsoid of a cloud of samples, plain or robust, with its covariance; or averaged over its soft iron.

Choosing between sphere, three radii and the full matrix, and ignoring the others, is wrong for two reasons. Near the
threshold the stated uncertainty is too small. After a small movement, "no soft iron seen" is not evidence of "no soft
iron". So the soft iron has a prior, ``S/r - I ~ N(0, sd^2)``, with one scale for its diagonal and one for its cross
terms. The results for all sizes of both scales are averaged by their marginal likelihood (Laplace; flat over the
scales). If the data determine the soft iron, the priors have no effect; otherwise the result approaches that of a
sphere smoothly. The model that is named beside it is the one with the least information criterion (BIC).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import dataclass

import numpy as np
import scipy

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.mag.distance import ALL_SIDES, Distances, ShapeTerms, Solution, bisquare, gauss_newton, shape_prior
from mavcal.calib.mag.ellipsoid_result import ShapeFit
from mavcal.calib.mag.result import MagContext
from mavcal.calib.mag.robust import MOST_OUTLIERS, Start, robust_sd
from mavcal.calib.mag.samples import LEAST_VARIANCE, Array, Cloud
from mavcal.calib.mag.serial import LONGEST, weakened_information
from mavcal.calib.mag.shape import N_PARAMETERS, Ellipsoid, MagModel, six_numbers, symmetric
from mavcal.calib.stats.residuals import student_variance

METHOD = "mag-ellipsoid"

_SCALE_ROUNDS = 4
_SINGULAR = 1e-13  # smallest over largest information that is more than rounding
_MEASURED_NOISE = 30  # degrees of freedom from which on residuals know the noise better than a data sheet
SOFT_IRON_SD = 0.1
"""Prior sd of each relative soft-iron term of any compass: a vehicle with 20 % is at two sd."""

_SCALES = (1.0, 10**-0.5, 0.1, 10**-1.5, 0.01)  # of that; a thousandth of the field is a compass without soft iron
_ROUNDS = 2  # the likelihood is quadratic about the likeliest scale, not about the first one


@dataclass(frozen=True, eq=False)
class Asked:
    """Options of an ellipsoid fit."""

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


@dataclass(frozen=True, eq=False)
class _Likelihood:
    """Logarithm of the likelihood of the nine numbers about a minimum: ``c + pull.x - x^T information x / 2``."""

    information: Array
    pull: Array
    ellipsoid: Ellipsoid

    @classmethod
    def about(cls, fit: ShapeFit, prior: Array) -> _Likelihood:
        """From the `fit` with that `prior`, both in the scale of the cloud."""
        state = np.concatenate([fit.ellipsoid.offset, six_numbers(fit.ellipsoid.shape)])
        information = np.linalg.inv(fit.covariance) - prior
        # At the minimum the pull of the samples and that of the prior cancel.
        return cls(information, information @ state + prior @ state, fit.ellipsoid)

    def with_prior(self, sd: float, cross_sd: float) -> tuple[Array, Array, float]:
        """State (9,), covariance (9, 9) and logarithm of the evidence with the prior of these scales."""
        prior = shape_prior(self.ellipsoid, sd, cross_sd)
        covariance = np.asarray(np.linalg.inv(self.information + prior))
        state = covariance @ self.pull
        known = float(np.log(np.linalg.eigvalsh(prior)[4:]).sum())  # offset and radius have no prior
        evidence = 0.5 * (float(self.pull @ state) + known + float(np.linalg.slogdet(covariance)[1]))
        return state, covariance, evidence

    def loss(self, model: MagModel) -> float:
        """Increase of chi2 with only `model` free."""
        free = model.basis
        best = [p @ np.linalg.pinv(p.T @ self.information @ p) @ p.T @ self.pull for p in (np.eye(9), free)]
        return float(self.pull @ (best[0] - best[1]))


def averaged_shape(cloud: Cloud, start: Start, asked: Asked) -> ShapeFit:
    """The ellipsoid of `cloud` averaged over the sizes of soft iron, with its covariance, in the scale of the cloud.

    ``native`` holds the `model` of the least `bic` and the likely `soft_iron_scale`. For each smaller model it holds
    its `bic` less the full one's and the test by `likelihood_ratio`: the chance of so large a misfit if that model were
    true.

    Raises
    ------
    UndeterminedError
        As :func:`calib.mag.shape_fit.with_uncertainty`.
    """
    largest = asked.prior_sd or SOFT_IRON_SD
    asked = dataclasses.replace(asked, prior_sd=largest, cross_sd=largest)
    scales = [(largest * one, largest * two) for one, two in itertools.product(_SCALES, repeat=2)]
    found = minimum(cloud, start, asked)
    for _ in range(_ROUNDS):
        fit = with_uncertainty(found, cloud, asked)
        likelihood = _Likelihood.about(fit, found.solution.prior)
        answers = [likelihood.with_prior(*pair) for pair in scales]
        prior_sd, cross_sd = scales[int(np.argmax([evidence for _, _, evidence in answers]))]
        asked = dataclasses.replace(asked, prior_sd=prior_sd, cross_sd=cross_sd)
        found = _with_prior(found, cloud, asked)
    fit = with_uncertainty(found, cloud, asked)
    likelihood = _Likelihood.about(fit, found.solution.prior)
    return _average(likelihood, scales, found, fit, cloud)


def _with_prior(found: ShapeSolution, cloud: Cloud, asked: Asked) -> ShapeSolution:
    """The minimum `found` moved to the prior of `asked`, with the same weights of the samples."""
    solution = gauss_newton(
        Distances(cloud),
        found.solution.ellipsoid,
        found.solution.noise_variance,
        terms=asked.terms,
        tukey_scale=found.tukey_scale,
    )
    return ShapeSolution(solution, found.tukey_scale)


def _average(
    likelihood: _Likelihood, scales: list[tuple[float, float]], found: ShapeSolution, fit: ShapeFit, cloud: Cloud
) -> ShapeFit:
    answers = [likelihood.with_prior(*pair) for pair in scales]
    evidence = np.array([e for _, _, e in answers])
    weights = np.exp(evidence - evidence.max())
    weights /= weights.sum()
    state = np.asarray(sum(w * s for w, (s, _, _) in zip(weights, answers, strict=True)))
    covariance = np.zeros((len(state), len(state)))
    for weight, (other, own, _) in zip(weights, answers, strict=True):
        covariance += weight * (own + np.outer(other - state, other - state))
    ellipsoid = Ellipsoid(state[:3], symmetric(state[3:]))
    residuals = Distances(cloud).at(ellipsoid, found.solution.noise_variance, None).residuals
    kept = found.weights()
    return dataclasses.replace(
        fit,
        ellipsoid=ellipsoid,
        covariance=covariance,
        residuals=residuals if kept is None else residuals[kept > 0.0],
        native=_native(weights, scales, likelihood, fit),
    )


def _native(
    weights: Array, scales: list[tuple[float, float]], likelihood: _Likelihood, fit: ShapeFit
) -> dict[str, object]:
    tests, criteria = {}, {str(MagModel.SYMMETRIC): 0.0}
    for model in (MagModel.OFFSET, MagModel.DIAGONAL):
        loss, dropped = likelihood.loss(model), MagModel.SYMMETRIC.size - model.size
        tests[str(model)] = float(scipy.special.chdtrc(dropped, max(loss, 0.0)))
        criteria[str(model)] = loss - dropped * math.log(len(fit.residuals))
    likely = np.exp(weights @ np.log(np.array(scales)))
    return {
        "model": min(criteria, key=lambda name: criteria[name]),
        "bic": criteria,
        "likelihood_ratio": tests,
        "soft_iron_scale": {"diagonal": float(likely[0]), "cross": float(likely[1])},
    }
