"""Likelihood in the domain of the cosine transform, in which the bins of stationary noise are independent.

The orthonormal DCT-II diagonalises white noise and a random walk exactly, and other stationary noise approximately
(Whittle). ``-2 log L = sum_k [log S_k + (y_k - X_k beta)^2 / S_k]`` at ``w_k = pi k / n``. Powers are variances of one
sample.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.optimize import nnls

Array = NDArray[np.float64]

_SINGLE = 48
"""Lowest bins of the periodogram that are not merged. Chosen, not measured: they tell drifts from walks."""
_MERGED = 900
"""Number of bins, evenly spaced in log frequency, into which the others are merged. Chosen, not measured: finer than
any spectrum of the catalogue, and quick."""
_PRIMES = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31)
"""Factors of lengths that the Fourier transform takes quickly. Source: mixed-radix transforms; a larger prime costs its
square."""
_FIRST = np.sqrt(3.0) / np.pi
"""Bin number at which a power law is evaluated for the mean: a random walk from 0 over n samples has n^2 / 3 there.
Source: `1 / w^2` at `w = pi k / n` with k of that size."""


@lru_cache(maxsize=256)
def fast_length(n: int) -> int:
    """The largest length up to `n` without a prime factor above 31, whose transform is fast.

    Of 14 000 samples at most 36 are lost. SciPy's ``prev_fast_len``, without a factor above 11, loses up to 1.8 %, and
    an effect that grows to the end has a tenth of its energy there.
    """
    for length in range(n, 0, -1):
        rest = length
        for prime in _PRIMES:
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return length
    return n


def transform(series: Array) -> Array:
    """Orthonormal DCT-II along the last axis."""
    return np.asarray(dct(series, type=2, norm="ortho", axis=-1, overwrite_x=False))


def frequencies(n: int) -> Array:
    """Frequencies of the bins of the transform of `n` samples, rad per sample; the mean counts as 0.55 bins."""
    k = np.arange(n, dtype=np.float64)
    k[0] = _FIRST
    return np.pi * k / n


def random_walk(omega: Array) -> Array:
    """Power of a random walk of unit variance a step."""
    return np.asarray(1.0 / (4.0 * np.sin(0.5 * omega) ** 2))


def flicker(omega: Array) -> Array:
    """Power of 1/f noise, 1 at one radian per sample."""
    return np.asarray(1.0 / omega)


@dataclass(frozen=True, eq=False)
class FrequencyBins:
    """Merged neighbouring frequencies, for noise that is smooth over a bin."""

    starts: NDArray[np.intp]
    counts: Array

    def total(self, values: Array) -> Array:
        """Sum over each bin, along the last axis."""
        return np.asarray(np.add.reduceat(values, self.starts, axis=-1))

    def mean(self, values: Array) -> Array:
        """Mean over each bin, along the last axis."""
        return self.total(values) / self.counts


@lru_cache(maxsize=64)
def bins_of(n: int) -> FrequencyBins:
    """Bins for the transform of `n` samples."""
    upper = np.unique(np.geomspace(_SINGLE, n, _MERGED).astype(np.intp)) if n > _SINGLE else np.zeros(0, np.intp)
    starts = np.concatenate([np.arange(min(n, _SINGLE), dtype=np.intp), upper[upper > _SINGLE - 1]])
    starts = np.unique(starts[starts < n])
    return FrequencyBins(starts, np.diff(np.append(starts, n)).astype(np.float64))


@dataclass(frozen=True, eq=False)
class AxisNoise:
    """The noise of one axis of one series: `base` (n,), and densities (n,) by name with amplitudes >= 0."""

    base: Array
    densities: Mapping[str, Array]
    amplitudes: Mapping[str, float]

    @cached_property
    def power(self) -> Array:
        """S_k, shape (n,); never changed in place."""
        total = self.base.copy()
        for name, density in self.densities.items():
            total += self.amplitudes[name] * density
        return total


@dataclass(frozen=True, eq=False)
class AmplitudeFit:
    """Maximum of the likelihood over amplitudes >= 0."""

    amplitudes: Array
    deviance: float
    """``-2 log L``"""
    information: Array
    """Fisher information of the amplitudes."""


def deviance(power: Array, periodogram: Array, counts: Array) -> float:
    """``-2 log L`` of merged bins: sums of squares `periodogram` (B,) of `counts` (B,) values of variance `power`."""
    return float(counts @ np.log(power) + (periodogram / power).sum())


def fit_amplitudes(
    periodogram: Array, counts: Array, base: Array, densities: Sequence[Array], start: Array | None = None
) -> AmplitudeFit:
    """Amplitudes of `densities` (each (B,)) beside `base` (B,), by scoring steps with non-negative least squares.

    `base` may be 0 if the densities contain all noise.
    """
    D = np.asarray(densities, dtype=np.float64).reshape(len(densities), len(counts))
    if not len(D):
        return AmplitudeFit(np.zeros(0), deviance(base, periodogram, counts), np.zeros((0, 0)))
    mean = periodogram / counts
    if not (mean > 0.0).any():
        return AmplitudeFit(np.zeros(len(D)), deviance(base + 1e-150, periodogram, counts), np.eye(len(D)))
    a = _start(mean, counts, base, D) if start is None else np.maximum(start, 0.0)
    floor = 1e-12 * float(np.average(mean, weights=counts)) + 1e-150
    level = deviance(np.maximum(base + a @ D, floor), periodogram, counts)
    for _ in range(40):
        power = np.maximum(base + a @ D, floor)
        target = _scored(D, mean - base, np.sqrt(counts) / power)
        step, gain = 1.0, 0.0
        while step > 1e-3:
            trial = a + step * (target - a)
            new = deviance(np.maximum(base + trial @ D, floor), periodogram, counts)
            gain = level - new
            if gain > 0.0:
                break
            step *= 0.4
        if gain <= 0.0:
            break
        a, level = trial, new
        if gain < 1e-4:
            break
    power = np.maximum(base + a @ D, floor)
    weighted = D * (np.sqrt(0.5 * counts) / power)
    return AmplitudeFit(a, level, weighted @ weighted.T)


def _start(mean: Array, counts: Array, base: Array, D: Array) -> Array:
    """Initial amplitudes: the share of each density in the excess, matched in the logarithm."""
    excess = np.maximum(mean - base, 0.0)
    scale = np.maximum(mean, 1e-9 * float(np.average(mean, weights=counts)) + 1e-150)
    found = []
    for d in D:
        ratio = d / scale
        largest = float(ratio.max(initial=0.0))
        if not 0.0 < largest < math.inf:
            found.append(0.0)
            continue
        ratio = ratio / largest
        size = float((counts * ratio**2).sum())
        found.append(max(float((counts * excess / scale * ratio).sum()) / size, 0.0) / largest)
    return np.asarray(found)


def _scored(D: Array, target: Array, weight: Array) -> Array:
    A = (D * weight).T
    norm = np.sqrt((A**2).sum(axis=0))
    norm[norm == 0.0] = 1.0
    solution, _ = nnls(A / norm, target * weight, maxiter=30 * (len(norm) + 1))
    return np.asarray(solution / norm)
