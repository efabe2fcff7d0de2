"""What an effect is worth beside its price: the marginal likelihood of its amplitudes under a prior of their own size.

A penalty of ``log N`` an amplitude asks the same of a direction that the movement excites and of one that it does not,
and more of a long recording than of a short one. Here the amplitudes of one unit share a prior ``N(0, s^2)``, and s is
the size that explains the data best (empirical Bayes; Clyde & George 2000): an amplitude that is seen well costs about
the logarithm of its own evidence, one that is not seen costs nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from calib.gap.effects.noise import DRIFTS
from calib.gap.effects.reference_attitude import REFERENCE
from calib.gap.normal import eigh
from calib.gap.shape_ids import family_of, is_part, is_shape

Array = NDArray[np.float64]

_SIZES = np.geomspace(1.0, 1e8, 33)
"""Prior variances that are tried, in units of the best-seen direction's error."""
_FINE = 100
"""Values of a grid from which on its search is paid value by value: moments, frequencies."""
_LAST = 16.0
"""Price of what fits anything of its kind: a named cause that fits nearly as well is believed first."""
_SHAPES = {"driven": 8.0, "own": 12.0, "approach": 16.0, "linear": 14.0, "product": 16.0, "line": 16.0, "time": 32.0}
"""Price of a shape by its family: the fewer things it could stand for, the less."""
_ONE_OF_MANY = 4.0
"""Added to it for a part of a shape: the one of many that fits best."""
_DOUBT = 8.0
"""Price of blaming the reference for what a sensor may have done."""
_NUMBER = 0.5
"""Price of an amplitude that the data do not tell."""
_COARSE = 4.0
"""What the search over a coarse grid counts as."""


def evidence(gram: Array, right: Array, groups: NDArray[np.intp]) -> float:
    """Twice the log marginal likelihood ratio of amplitudes against none, at the best size of the prior.

    Parameters
    ----------
    gram, right : shape (p, p), (p,)
        Normal equations beside everything else in the model.
    groups : shape (p,)
        Amplitudes of one unit have the same number; between groups sizes are relative to their mean information.
    """
    return weighed(gram, right, groups)[0]


def weighed(gram: Array, right: Array, groups: NDArray[np.intp]) -> tuple[float, float]:
    """The :func:`evidence`, and of how many amplitudes the data tell at that size of the prior: from 0 to p."""
    _, values, size, worth = _prior(gram, right, groups)
    return worth, float((size * values / (1.0 + size * values)).sum())


def prior_sd(gram: Array, right: Array, groups: NDArray[np.intp]) -> Array:
    """Standard deviations (p,) of the prior at its best size; zero where the data would rather have no amplitudes."""
    scale, _, size, worth = _prior(gram, right, groups)
    return scale * math.sqrt(size) if worth > 0.0 else np.zeros(len(gram))


def _prior(gram: Array, right: Array, groups: NDArray[np.intp]) -> tuple[Array, Array, float, float]:
    """Scale and information (p,) of standardised amplitudes, the variance of them that explains the data best, and
    twice the log evidence there; both are zero where there is no information.
    """
    scale = _scale(gram, groups)
    values, vectors = eigh(gram * np.outer(scale, scale))
    values = np.maximum(values, 0.0)  # below zero only by rounding
    if not values.any():
        return scale, values, 0.0, 0.0
    square = (vectors.T @ (right * scale)) ** 2
    sizes = _SIZES[:, None] / values[-1]
    worth = (square * sizes / (1.0 + sizes * values) - np.log1p(sizes * values)).sum(axis=1)
    best = int(worth.argmax())
    return scale, values, float(sizes[best, 0]), float(worth[best])


def _scale(gram: Array, groups: NDArray[np.intp]) -> Array:
    """One over the root of the mean information of each amplitude's group; zero where there is none."""
    information = np.diag(gram)
    scale = np.ones(len(gram))
    for g in np.unique(groups):
        own = groups == g
        mean = float(information[own].mean())
        scale[own] = 1.0 / math.sqrt(mean) if mean > 0.0 else 0.0
    return scale


def price_of_numbers(idle: float) -> float:
    """Price of amplitudes that the data do not tell: of causes that explain the same the one with fewer is believed.

    Beside the evidence, in which a direction that the movement does not excite costs nothing: at rest the nine numbers
    of a sensitivity to force are an offset of three.
    """
    return _NUMBER * idle


def price_of_fixed(gain: float) -> float:
    """Price of the shape of an effect that has nothing else, to either side."""
    return math.log1p(max(gain, 0.0)) + 2.0 * math.log(2.0)


def price_of_search(grid: int, gain: float) -> float:
    """Price of a shape that was sought over `grid` values; none for one value.

    No more values can be told apart than the evidence has to offer: a jump of evidence g is known to N/g samples.
    """
    if grid <= 1:
        return 0.0
    return 2.0 * math.log(min(grid, max(gain, _COARSE)) if grid > _FINE else _COARSE)


def price_of_noise(amplitudes: Array, information: Array) -> float:
    """Price of amplitudes (p,) of noise, in twice the log-likelihood, under a prior of their own size.

    `information`: of each beside all others. A sensor's axes are alike: one on which such noise is excluded costs.
    """
    size = float(np.mean(np.maximum(amplitudes, 0.0) ** 2)) if len(amplitudes) else 0.0
    return float(np.log1p(size * information).sum())


def price_of_kind(effect_id: str) -> float:
    """By kind: noise that wanders fits any slow change, and so does a line over time; a shape may fit anything."""
    if is_shape(effect_id):
        return _SHAPES[family_of(effect_id)] + _ONE_OF_MANY * is_part(effect_id)
    if effect_id == REFERENCE:
        return _DOUBT
    return _LAST if effect_id.endswith(DRIFTS) else 0.0
