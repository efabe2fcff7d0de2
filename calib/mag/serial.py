"""Serial correlation of residuals, and covariances widened by it."""

from __future__ import annotations

import numpy as np
import scipy

from mavcal.calib.stats.residuals import Array, first_correlation

LONGEST = 1 << 17
"""Most samples used: enough for the time constant of any movement by hand."""

_SIGNIFICANT = 3.0  # standard deviations of the first correlation below which residuals count as white


def variance_inflation(series: Array) -> float:
    """Factor on the variance of the sum of `series` (N,), in order of time, over that of white noise.

    The factor is ``1 + 2 sum rho_k`` up to the first pair of correlations that is not positive (Geyer 1992, initial
    positive sequence). For an AR(1) process it is ``(1 + rho)/(1 - rho)`` (METHODS 3.5). White series: exactly 1.
    """
    series = series[:LONGEST]
    n = len(series)
    if n < 4 or first_correlation(series) < _SIGNIFICANT / np.sqrt(n):
        return 1.0
    power = float(series @ series)
    width = scipy.fft.next_fast_len(2 * n, real=True)
    spectrum = scipy.fft.rfft(series, width)
    rho = scipy.fft.irfft(spectrum.real**2 + spectrum.imag**2, width)[: n // 2] / power
    pairs = rho[: len(rho) // 2 * 2].reshape(-1, 2).sum(axis=1)
    stop = int(np.argmax(pairs <= 0.0)) if (pairs <= 0.0).any() else len(pairs)
    return max(1.0, float(2.0 * pairs[:stop].sum() - 1.0))


def weakened_information(information: Array, rows: Array, residuals: Array) -> tuple[Array, float]:
    """`information` (p, p) of a least squares fit reduced for serial correlation, and the largest factor.

    The error of the estimate is a sum of scores ``J_k r_k``, not of residuals. A misfit that the movement rotates
    through the parameters therefore costs less than a constant one. Each of the p eigenvectors of the information,
    whose scores are uncorrelated with each other, is weakened by its own factor.

    Parameters
    ----------
    information
        ``sum J J^T`` over the variance of the residuals.
    rows : shape (p, N)
        Derivatives of the residuals; the first :data:`LONGEST` are looked at.
    residuals : shape (N,)
        Times their weight, for a robust fit.
    """
    values, directions, factors = _score_factors(information, rows, residuals)
    weakened = (directions * (values / factors)) @ directions.T
    return 0.5 * (weakened + weakened.T), float(factors.max())


def widened_scatter(scatter: Array, rows: Array, residuals: Array) -> tuple[Array, float]:
    """Covariance `scatter` (p, p) of the sum of scores ``rows_k r_k`` widened likewise, and the largest factor."""
    values, directions, factors = _score_factors(scatter, rows, residuals)
    widened = (directions * (values * factors)) @ directions.T
    return 0.5 * (widened + widened.T), float(factors.max())


def _score_factors(scatter: Array, rows: Array, residuals: Array) -> tuple[Array, Array, Array]:
    values, directions = np.linalg.eigh(scatter)
    rows, residuals = rows[:, :LONGEST], residuals[:LONGEST]
    return values, directions, np.array([variance_inflation((d @ rows) * residuals) for d in directions.T])


def white_variance(residuals: Array) -> float:
    """Variance of the part of `residuals` (N,) that is new at every sample: half the mean squared difference."""
    if len(residuals) < 2:
        return 0.0
    steps = np.diff(residuals)
    return float(steps @ steps) / (2.0 * len(steps))
