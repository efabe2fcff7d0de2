"""Evidence of an effect: the marginal likelihood of its amplitudes under a prior of their own size.

A penalty of ``log N`` per amplitude would not depend on whether the movement excites it, and would grow with the length
of the recording. Here the amplitudes of one unit share a prior ``N(0, s^2)``, and s is the size that explains the data
best (empirical Bayes; Clyde & George 2000). A well-observed amplitude costs about the logarithm of its own evidence, an
unobserved one nothing.

Amplitudes may differ in size, so two other priors are tried, each at the price of the choice. In one, all amplitudes
change the readings equally (Zellner 1986), as do those of a polynomial, whose terms cancel. In the other, only one
amplitude is not zero, as for a fault on one axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.base import CatalogueEffect
from mavcal.calib.gap.effects.reference_attitude import REFERENCE
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.model.normal_equations import eigh
from mavcal.calib.gap.search import prices

Array = NDArray[np.float64]

_SEEN = 1e-9
"""Information relative to the largest, below which a direction is only rounding. Source: rounding of an information
matrix, 1e-16, with a margin."""


def evidence(gram: Array, right: Array, groups: NDArray[np.intp]) -> float:
    """Twice the log marginal likelihood ratio of amplitudes against none, at the best size of the prior.

    Parameters
    ----------
    gram, right : shape (p, p), (p,)
        Normal equations beside everything else in the model.
    groups : shape (p,)
        Amplitudes of one unit have the same number; between groups sizes are relative to their mean information.
    """
    seen = _Directions.of(gram, right, groups)
    _, worth = seen.with_common_variance()
    return max(worth, seen.with_g_prior(), _single_amplitude_evidence(gram, right))


def prior_sd(gram: Array, right: Array, groups: NDArray[np.intp]) -> Array:
    """Standard deviations (p,) of the prior at its best size; zero if the data favour zero amplitudes."""
    seen = _Directions.of(gram, right, groups)
    size, worth = seen.with_common_variance()
    return seen.scale * math.sqrt(size) if worth > 0.0 else np.zeros(len(gram))


@dataclass(frozen=True, eq=False)
class _Directions:
    """Amplitudes in units of `scale` (p,): information `values` (p,) along independent directions, in rising order, and
    the `square` (p,) of the right side there.
    """

    scale: Array
    values: Array
    square: Array

    @classmethod
    def of(cls, gram: Array, right: Array, groups: NDArray[np.intp]) -> _Directions:
        scale = _scale(gram, groups)
        values, vectors = eigh(gram * np.outer(scale, scale))
        return cls(scale, np.maximum(values, 0.0), (vectors.T @ (right * scale)) ** 2)  # below zero by rounding only

    def with_common_variance(self) -> tuple[float, float]:
        """The variance of the amplitudes that explains the data best, and twice the log evidence at it."""
        if not self.values.any():
            return 0.0, 0.0
        sizes = prices.PRIOR_VARIANCES[:, None] / self.values[-1]
        ratio = sizes * self.values
        worth = (self.square * sizes / (1.0 + ratio) - np.log1p(ratio)).sum(axis=1)
        best = int(worth.argmax())
        return float(sizes[best, 0]), float(worth[best])

    def with_g_prior(self) -> float:
        """Evidence if every observed direction changes the readings equally."""
        if not self.values.any():
            return -math.inf
        seen = self.values > _SEEN * self.values[-1]
        return (
            _at_best_size(float((self.square[seen] / self.values[seen]).sum()), int(seen.sum()))
            - prices.SECOND_PRIOR_PRICE
        )


def _single_amplitude_evidence(gram: Array, right: Array) -> float:
    """Evidence if only the best amplitude is not zero."""
    information = np.diag(gram)
    seen = information > 0.0
    if not seen.any():
        return -math.inf
    return _at_best_size(float((right[seen] ** 2 / information[seen]).max()), 1) - _single_amplitude_price(len(right))


def _single_amplitude_price(count: int) -> float:
    """Price of choosing one amplitude among `count`."""
    return 2.0 * math.log(2.0 * count)


def _at_best_size(gain: float, rank: int) -> float:
    """Twice the log evidence ``g - r - r log(g / r)`` of r directions with the common gain g."""
    return gain - rank - rank * math.log(gain / rank) if gain > rank else -math.inf


def _scale(gram: Array, groups: NDArray[np.intp]) -> Array:
    """One over the root of the mean information of each amplitude's group; zero without information."""
    information = np.diag(gram)
    scale = np.ones(len(gram))
    for g in np.unique(groups):
        own = groups == g
        mean = float(information[own].mean())
        scale[own] = 1.0 / math.sqrt(mean) if mean > 0.0 else 0.0
    return scale


def price_of_fixed(gain: float) -> float:
    """Price of the shape of an effect without other parameters, searched to either side."""
    return math.log1p(max(gain, 0.0)) + 2.0 * math.log(2.0)


def price_of_search(grid: int, gain: float) -> float:
    """Price of a shape that was searched for over `grid` values; zero for one value.

    The evidence limits how many values can be told apart: the moment of a jump of evidence g is known to N/g samples.
    """
    if grid <= 1:
        return 0.0
    return 2.0 * math.log(min(grid, max(gain, 1.0)))


def price_of_noise(amplitudes: Array, information: Array) -> float:
    """Price of amplitudes (p,) of noise, in twice the log-likelihood, under a prior of their own size.

    `information` is that of each beside all others. Either the axes of a sensor are equal, and an axis without the
    noise is penalised. Or the noise is on one axis, and the gain on the others is lost.
    """
    square = np.maximum(amplitudes, 0.0) ** 2
    if not len(square):
        return 0.0
    together = float(np.log1p(square.mean() * information).sum())
    lost = float((square * information).sum()) - square * information
    alone = np.log1p(square * information) + lost + _single_amplitude_price(len(square))
    return min(together, float(alone.min()))


def price_of_repetition(again: int) -> float:
    """Price of a further event of the same kind: enough events approximate any drift by a staircase."""
    return prices.REPEATED_JUMP_PRICE if again else 0.0


def price_of_kind(effect: CatalogueEffect) -> float:
    """Price of the kind of an effect.

    Drift noise and lines over time fit any slow change, and unnamed shapes fit almost anything. A thermal effect is
    often present at every temperature.
    """
    if effect.nameless:
        return prices.SHAPE_PRICES[effect.family] + prices.SHAPE_PART_PRICE * effect.part
    if effect.id == REFERENCE:
        return prices.REFERENCE_PRICE
    if Trait.THERMAL in effect.traits:
        return prices.THERMAL_PRICE
    return prices.DRIFT_PRICE if effect.drifts else 0.0
