"""Ellipsoid averaged over the size of the soft iron, from the data and a prior.

To choose between sphere, three radii and the full matrix, and to forget the others, is wrong twice. Next to the
threshold the stated uncertainty is too small. Where the movement was small, "no soft iron seen" is no evidence of "no
soft iron". So the soft iron has a prior, ``S/r - I ~ N(0, sd^2)``, with one scale for its diagonal and one for its
cross terms. The answers over all sizes of both scales are averaged by their marginal likelihood (Laplace; all scales
alike beforehand). Where the data determine the soft iron the priors say nothing; where they do not, the answer goes
over to that of a sphere smoothly. The model that is named beside it is the one with the least information criterion
(BIC).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from mavcal.calib.mag.distance import Distances, gauss_newton, shape_prior
from mavcal.calib.mag.ellipsoid_result import ShapeFit
from mavcal.calib.mag.robust import Start
from mavcal.calib.mag.samples import Cloud
from mavcal.calib.mag.shape import Ellipsoid, MagModel, six_numbers, symmetric
from mavcal.calib.mag.shape_fit import Asked, ShapeSolution, minimum, with_uncertainty

Array = NDArray[np.float64]

SOFT_IRON_SD = 0.1
"""Prior of each relative term of soft iron, believed of any compass: a vehicle with 20 % is two sd out."""

_SCALES = (1.0, 10**-0.5, 0.1, 10**-1.5, 0.01)  # of that; a thousandth of the field is a compass without soft iron
_ROUNDS = 2  # the likelihood is quadratic about the likeliest scale, not about the first one


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
