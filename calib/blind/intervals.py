"""Statistics of a campaign: intervals of proportions, calibration of probabilities, the limit of detection."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import binomtest, chi2, ncx2

Array = NDArray[np.float64]

_DRAWS = 1000
"""Of as many rows as there are: the ends of a 95 % interval are the 25th of either side."""


def wilson(hits: int, n: int) -> tuple[float, float]:
    """95 % interval of a proportion (Wilson 1927); (0, 1) of nothing."""
    if n == 0:
        return 0.0, 1.0
    found = binomtest(hits, n).proportion_ci(0.95, method="wilson")
    return float(found.low), float(found.high)


def resampled(statistic: Callable[[Array], float | None], rows: Array) -> tuple[float, float]:
    """95 % interval of a statistic: that of rows drawn again with replacement (Efron 1979), always the same draws.

    Draws in which it is not defined do not count; (-inf, inf) where there is none in which it is.
    """
    rng = np.random.default_rng(len(rows))
    drawn = (statistic(rows[rng.integers(0, len(rows), len(rows))]) for _ in range(_DRAWS))
    found = [value for value in drawn if value is not None]
    if not found:
        return -math.inf, math.inf
    low, high = np.quantile(found, [0.025, 0.975])
    return float(low), float(high)


def calibration_error(probabilities: ArrayLike, hits: ArrayLike, bins: int = 10) -> float:
    """Expected calibration error over bins of equal width; NaN of nothing is never returned: 0."""
    p, h = np.asarray(probabilities, dtype=np.float64), np.asarray(hits, dtype=np.float64)
    if len(p) == 0:
        return 0.0
    index = np.minimum((p * bins).astype(int), bins - 1)
    error = 0.0
    for k in np.unique(index):
        rows = index == k
        error += float(rows.mean()) * abs(float(p[rows].mean()) - float(h[rows].mean()))
    return error


def brier_skill(probabilities: ArrayLike, hits: ArrayLike) -> float:
    """1 - Brier score over that of the constant base rate; 0 where the base rate is certain."""
    p, h = np.asarray(probabilities, dtype=np.float64), np.asarray(hits, dtype=np.float64)
    if len(p) == 0 or h.std() == 0.0:
        return 0.0
    return 1.0 - float(((p - h) ** 2).mean()) / float(h.var())


def detection_limit(severity: float, df: int, alpha: float) -> float:
    """Power of the likelihood-ratio test that knows which effect of `df` parameters it looks for."""
    return float(ncx2.sf(chi2.isf(alpha, df), df, severity))
