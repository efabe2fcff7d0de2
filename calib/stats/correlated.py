"""Variance of the mean of correlated samples.

Streamed samples are low-passed and have slow drift, so N samples are worth fewer than N. The *long-run variance* S of a
series satisfies ``var(mean) = S / N``; for white noise it is the variance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LEAST = 16  # samples below which correlation cannot be told from chance
_ORDERS = 8  # highest order of the autoregression
_BLOCKS = 16
_SIGNIFICANT = 0.001  # chance at which drift between blocks is believed
_TINY = 1e-300
_RATIOS = np.concatenate([[0.0], np.geomspace(1e-2, 1e6, 33)])  # variance of the walk over the white one
# Prior weights of no walk, against one for each of the 33 ratios. A one-way warm-up cannot tell a small walk from
# drift, so any assumption errs to one side. The figures are squared errors over stated ones, for a cubic.
_ALONE = 8.0
"""For one series: 0.45 with white noise and 1.9 under the worst walk, where 2.6 % of errors exceed 4.5 sd."""
_TOGETHER = 1.0
"""For three series that share information on the walk: 0.41 with white noise, 1.3 at worst, 0.4 % beyond 4.5 sd."""
_SHARED = 0.5
"""Weight of the other series' information on the ratio: a twofold difference of the walks does no harm (1.2)."""
_STEADY = 1e-10  # of a series' size: residuals below that are rounding and tell nothing of noise
_LEAST_FREEDOM = 12  # residuals below which colour cannot be told from chance


def long_run_variance(series: Array) -> float:
    """Long-run variance of `series` (N,), at least its variance and at most N times that.

    The spectral density at frequency zero of an autoregression whose order minimises Akaike's criterion, ``s2 / (1 -
    sum phi)^2``; white noise chooses order 0. If the means of sixteen blocks scatter more (drift too slow for any
    order), the scatter of the blocks is used instead.
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
        if scipy.special.chdtrc(_BLOCKS - 1, (_BLOCKS - 1) * scatter / value) < _SIGNIFICANT:
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


@dataclass(frozen=True, eq=False)
class ColouredCovariance:
    """Covariances (k, p, p) of the p coefficients of k series fitted by least squares, under coloured noise.

    `whiteness` (k,) is the probability that a series has no noticeable random walk. `excess` (k,) is the largest ratio
    of a coefficient's variance to that under white noise.
    """

    covariances: Array
    whiteness: Array
    excess: Array


def coloured_covariance(design: Array, series: Array, counts: Array, t: Array, *, gram: Array) -> ColouredCovariance:
    """Covariance of least squares whose noise is white plus a random walk in time.

    The size of the walk follows from the block means by restricted maximum likelihood, which allows for slow noise
    absorbed by the fit. The result is averaged over it, weighted by the likelihood. The series are axes of one sensor
    with similar ratios of walk to white noise, so they share information.

    A random walk has more power at the slowest scales than any mean-reverting wander, whose errors are therefore
    overestimated. The estimate stays ordinary least squares: the best one for the walk is only a twentieth better.

    Parameters
    ----------
    design : shape (B, p)
        Means of the regressors over B consecutive blocks.
    series : shape (B, k)
        Means of the k series.
    counts : shape (B,)
        Samples of each block.
    t : shape (B,)
        Mean time of each block.
    gram : shape (p, p)
        ``X^T X`` over all single samples.
    """
    weight = np.sqrt(counts)
    p = design.shape[1]
    Q, R = np.linalg.qr(design * weight[:, None], mode="complete")
    back, Q1, Q2 = np.linalg.inv(R[:p]), Q[:, :p], Q[:, p:]
    outside = Q2.T @ (series * weight[:, None])
    freedom = len(outside)
    white = ((outside**2).sum(axis=0) / freedom)[:, None, None] * np.linalg.inv(gram)
    if freedom < _LEAST_FREEDOM:
        return ColouredCovariance(white, np.ones(len(white)), np.ones(len(white)))
    walk = weight[:, None] * _random_walk(t) * weight
    values, vectors = np.linalg.eigh(Q2.T @ walk @ Q2)
    size = float(values.mean())
    v = 1.0 + _RATIOS[:, None] * np.maximum(values, 0.0) / size  # (ratios, freedom)
    variance = (1.0 / v) @ (vectors.T @ outside) ** 2 / freedom  # (ratios, k)
    log_likelihood = -0.5 * (np.log(v).sum(axis=1)[:, None] + freedom * np.log(np.maximum(variance, _TINY)))
    steady = (outside**2).sum(axis=0) <= (_STEADY * np.abs(series * weight[:, None]).max(axis=0)) ** 2
    log_likelihood, none = _shared(log_likelihood, ~steady)
    weights = np.exp(log_likelihood - log_likelihood.max(axis=0))
    weights[0] *= none
    weights /= weights.sum(axis=0)
    walking = back @ (Q1.T @ walk @ Q1 / size) @ back.T
    factor = np.einsum("mk,mk->k", weights, variance)
    slow = np.einsum("mk,mk,m->k", weights, variance, _RATIOS)
    covariances = factor[:, None, None] * np.linalg.inv(gram) + slow[:, None, None] * walking
    excess = np.einsum("kpp->kp", covariances) / np.maximum(np.einsum("kpp->kp", white), _TINY)
    return ColouredCovariance(covariances, weights[_RATIOS < 1.0].sum(axis=0), excess.max(axis=1))


def _shared(log_likelihood: Array, informative: NDArray[np.bool_]) -> tuple[Array, float]:
    """Likelihood (ratios, k) of each series, combined with the `informative` others, and the probability of no walk."""
    if informative.sum() < 2:
        return log_likelihood, _ALONE
    informative_likelihood = np.where(informative, log_likelihood, 0.0)
    others = informative_likelihood.sum(axis=1, keepdims=True) - informative_likelihood
    return log_likelihood + _SHARED * others, _TOGETHER


def _random_walk(t: Array) -> Array:
    """Covariance (B, B) of the block means of a random walk over the span of `t`.

    The mean of ``min(s, s')`` over two blocks is the earlier middle; within one block of width w it is w/6 less.
    """
    s = (t - t[0]) / max(float(t[-1] - t[0]), _TINY)
    width = np.diff(s).mean()
    return np.asarray(np.minimum(s[:, None], s) + (0.5 - np.eye(len(s)) / 6.0) * width, dtype=np.float64)
