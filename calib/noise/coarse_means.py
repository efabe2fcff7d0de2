"""Means of several parts of one quantised channel, with a common noise.

If the noise is below half a bin, the distance of a mean from the edge of its bin follows from the noise and from the
frequency of the next bin. One part alone hardly determines the noise: on six faces its means then err by up to three
times the bound. Here the likelihood of all parts is integrated over their common noise and over each mean, with flat
priors. This is not asymptotic: it is valid for a few samples in a second bin.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.quantisation import COARSE, QuantisedMean, half_widths, mean_of

_LEAST, _MOST = 0.02, 1.5  # quanta of noise that are believed of a sensor in coarse bins
_NOISES, _PLACES = 48, 161  # points of the grids
_REACH = 8.0  # standard deviations of the mean alone, to either side
_FARTHEST = 1.0  # quanta, to either side
_ROUNDS = 3  # a wide grid of the noise, then where its weight lies


@dataclass(frozen=True, eq=False)
class PartMean:
    """Mean (k,) of one part of n samples, with its covariance (k, k)."""

    mean: Array
    covariance: Array
    n: int


def means_together(parts: Sequence[Channel]) -> list[PartMean]:
    """Mean of each of `parts`, of one sensor and with equal rounding; parts in fine bins are independent.

    Raises
    ------
    InvalidInputError
        If one has fewer than two samples, or a sample is not finite.
    """
    alone = [mean_of(part) for part in parts]
    found = [PartMean(m.mean.copy(), m.covariance.copy(), m.n) for m in alone]
    for axis in range(len(found[0].mean) if found else 0):
        if len(parts) > 1 and _coarse(alone, axis, parts[0].quantum):
            _replace(found, parts, alone, axis)
    return found


def _coarse(alone: Sequence[QuantisedMean], axis: int, quantum: float) -> bool:
    return quantum > 0.0 and any(m.constant[axis] or m.sd[axis] < COARSE * quantum for m in alone)


def _replace(found: list[PartMean], parts: Sequence[Channel], alone: Sequence[QuantisedMean], axis: int) -> None:
    """Replace the means of `axis` by those with one noise for all parts."""
    quantum = parts[0].quantum
    counted = [_Counted.of(part, one, axis) for part, one in zip(parts, alone, strict=True)]
    noises = quantum * np.geomspace(_LEAST, _MOST, _NOISES)
    for _ in range(_ROUNDS):
        logs, means, variances = (
            np.array(column) for column in zip(*(c.posteriors(noises) for c in counted), strict=True)
        )
        evidence = logs.sum(axis=0)
        weights = np.exp(evidence - evidence.max()) * np.gradient(noises)
        weights /= weights.sum()
        middle = float(weights @ noises)
        spacing = float(np.interp(middle, noises, np.gradient(noises)))  # below it the grid is blind
        spread = max(float(np.sqrt(weights @ (noises - middle) ** 2)), 0.5 * spacing)
        used, noises = weights, np.linspace(max(_LEAST * quantum, middle - 5 * spread), middle + 5 * spread, _NOISES)
    for k, part in enumerate(found):
        mean = float(used @ means[k])
        part.mean[axis] = mean
        part.covariance[axis, :] = part.covariance[:, axis] = 0.0
        part.covariance[axis, axis] = float(used @ (variances[k] + (means[k] - mean) ** 2))


@dataclass(frozen=True, eq=False)
class _Counted:
    """One axis of a part: the edges of its bins (B,), the effective number of samples in each, and the search range."""

    lower: Array
    upper: Array
    worth: Array
    places: Array

    @classmethod
    def of(cls, part: Channel, alone: QuantisedMean, axis: int) -> _Counted:
        pairs = np.column_stack([part.values[:, axis], half_widths(part)[:, axis]])
        distinct, counts = np.unique(pairs, axis=0, return_counts=True)
        quantum = part.quantum
        reach = min(_REACH * math.sqrt(alone.covariance[axis, axis]), _FARTHEST * quantum)
        places = alone.mean[axis] + max(reach, 1e-6 * quantum) * np.linspace(-1.0, 1.0, _PLACES)
        worth = counts.astype(np.float64) * (alone.n_effective / alone.n)
        return cls(distinct[:, 0] - distinct[:, 1], distinct[:, 0] + distinct[:, 1], worth, places)

    def posteriors(self, noises: Array) -> tuple[Array, Array, Array]:
        """For each of `noises` (S,): log-likelihood integrated over the mean, posterior mean and its variance."""
        likelihood = np.zeros((len(noises), len(self.places)))
        for low, high, worth in zip(self.lower, self.upper, self.worth, strict=True):
            a = (low - self.places) / noises[:, None]
            b = (high - self.places) / noises[:, None]
            flip = a > 0.0  # the far tail is small below zero, and one above
            share = ndtr(np.where(flip, -a, b)) - ndtr(np.where(flip, -b, a))
            likelihood += worth * np.log(np.maximum(share, 1e-300))
        top = likelihood.max(axis=1)
        weights = np.exp(likelihood - top[:, None])
        total = weights.sum(axis=1)
        mean = weights @ self.places / total
        variance = np.maximum(weights @ self.places**2 / total - mean**2, 0.0)
        return top + np.log(total * (self.places[1] - self.places[0])), mean, variance
