"""Statistics of a campaign: intervals of proportions, calibration of probabilities, the limit of detection."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2, ncx2

Z95 = 1.959963984540054


def wilson(hits: int, n: int) -> tuple[float, float]:
    """95 % interval of a proportion (Wilson 1927); (0, 1) of nothing."""
    if n == 0:
        return 0.0, 1.0
    p, z2 = hits / n, Z95**2
    middle = (p + z2 / (2 * n)) / (1.0 + z2 / n)
    half = Z95 / (1.0 + z2 / n) * math.sqrt(p * (1.0 - p) / n + z2 / (4.0 * n * n))
    return max(0.0, middle - half), min(1.0, middle + half)


def calibration_error(probabilities: Sequence[float], hits: Sequence[bool], bins: int = 10) -> float:
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


def brier_skill(probabilities: Sequence[float], hits: Sequence[bool]) -> float:
    """1 - Brier score over that of the constant base rate; 0 where the base rate is certain."""
    p, h = np.asarray(probabilities, dtype=np.float64), np.asarray(hits, dtype=np.float64)
    if len(p) == 0 or h.std() == 0.0:
        return 0.0
    return 1.0 - float(((p - h) ** 2).mean()) / float(h.var())


def detection_limit(severity: float, df: int, alpha: float) -> float:
    """Power of the likelihood-ratio test that knows which effect of `df` parameters it looks for."""
    return float(ncx2.sf(chi2.isf(alpha, df), df, severity))
