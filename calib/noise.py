"""How much the mean of correlated samples knows.

What a vehicle streams went through a low-pass filter and rides on slow drift, so N samples are worth fewer than N. The
*long-run variance* S of a series is what makes ``var(mean) = S / N`` true; for white noise it is the variance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

Array = NDArray[np.float64]

_LEAST = 16  # samples below which correlation cannot be told from chance
_ORDERS = 20  # highest order of the autoregression
_BLOCKS = 16
_SIGNIFICANT = 0.001  # chance at which drift between blocks is believed


def long_run_variance(series: Array) -> float:
    """Long-run variance of `series` (N,), at least its variance and at most N times that.

    The spectral density at frequency zero of an autoregression whose order minimises Akaike's
    criterion, ``s2 / (1 - sum phi)^2``; white noise chooses order 0. Where the means of sixteen blocks scatter
    more than that explains (drift slower than any order sees), the scatter of the blocks counts instead.
    """
    x = np.asarray(series, dtype=np.float64)
    x = x - x.mean()
    n = len(x)
    variance = float(x @ x) / max(n - 1, 1)
    if n < _LEAST or variance <= 0.0:
        return variance
    value = variance * _autoregressive_factor(x)
    if n >= 8 * _BLOCKS:
        length = n // _BLOCKS
        means = x[: length * _BLOCKS].reshape(_BLOCKS, length).mean(axis=1)
        scatter = length * float(means.var(ddof=1))
        if chi2.sf((_BLOCKS - 1) * scatter / value, _BLOCKS - 1) < _SIGNIFICANT:
            value = scatter
    return float(np.clip(value, variance, n * variance))


def _autoregressive_factor(x: Array) -> float:
    """Long-run variance over variance, by Levinson and Durbin's recursion."""
    n = len(x)
    top = min(_ORDERS, n // 8)
    r = np.array([x[: n - k] @ x[k:] for k in range(top + 1)]) / n
    phi = np.zeros(0)
    error = r[0]
    best, factor = n * np.log(error), 1.0
    for order in range(1, top + 1):
        reflection = (r[order] - phi @ r[order - 1 : 0 : -1]) / error
        phi = np.append(phi - reflection * phi[::-1], reflection)
        error *= 1.0 - reflection**2
        if error <= 1e-12 * r[0]:  # a deterministic series: n_effective is one
            return float(n)
        criterion = n * np.log(error) + 2.0 * order
        if criterion < best:
            best = criterion
            factor = error / (r[0] * (1.0 - phi.sum()) ** 2)
    return float(factor)
