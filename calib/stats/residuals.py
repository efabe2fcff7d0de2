"""Statistics of residuals: chi-square against the noise, and whiteness."""

from __future__ import annotations

import math
from typing import TypedDict

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]

WHITE = 0.001
"""P-value below which residuals do not count as white."""


class ResidualStatistics(TypedDict):
    """Part of :attr:`calib.fit.FitResult.quality`, the same for every method."""

    chi2: float | None
    """Sum of squares over the expected noise variance; None: the noise is known only from the residuals."""
    dof: int
    p_value: float | None
    """Probability of so large a `chi2`; None without it, or without degrees of freedom."""
    first_correlation: float
    """Correlation of each residual with the one before."""
    white: bool | None
    """Whether that correlation is insignificant; None: too few residuals to tell."""


def first_correlation(series: Array) -> float:
    """Correlation of each of `series` (N,), whose mean is zero, with the one before."""
    power = float(series @ series)
    return float(series[1:] @ series[:-1]) / power if power > 0.0 else 0.0


def residual_statistics(residuals: Array, dof: int, noise_sd: float | None) -> ResidualStatistics:
    """Size of the residuals of a fit, and a test whether they are white.

    Parameters
    ----------
    residuals : shape (N,) or (N, k)
        In order of time; each column is a series.
    dof
        Degrees of freedom: numbers less fitted parameters.
    noise_sd
        Expected standard deviation, same unit (1 for standardised ones); None: known only from the residuals.

    >>> residual_statistics(np.array([1.0, -1.0, 1.0, -1.0]), 3, 1.0)["chi2"]
    4.0
    """
    columns = np.asarray(residuals, dtype=np.float64).reshape(len(residuals), -1)
    power = (columns**2).sum(axis=0)
    lagged = (columns[1:] * columns[:-1]).sum(axis=0)
    correlation = float(lagged.sum() / power.sum()) if power.sum() > 0.0 else 0.0
    count = columns[1:].size
    # sd of the first correlation of white noise is 1/sqrt(n) (Bartlett 1946); two-sided
    white = 2.0 * float(scipy.special.ndtr(-abs(correlation) * math.sqrt(count))) >= WHITE if count >= 8 else None
    chi2 = None if noise_sd is None or noise_sd <= 0.0 else float(power.sum()) / noise_sd**2
    p_value = float(scipy.special.chdtrc(dof, chi2)) if chi2 is not None and dof > 0 else None
    return ResidualStatistics(chi2=chi2, dof=dof, p_value=p_value, first_correlation=correlation, white=white)


def student_variance(dof: float) -> float:
    """Factor on a variance that was estimated with `dof` degrees of freedom, so that 1.96 sd hold 95 %.

    >>> round(student_variance(91.0), 3), round(student_variance(3.0), 2)
    (1.027, 2.64)
    """
    return float(scipy.special.stdtrit(dof, 0.975) / scipy.special.stdtrit(math.inf, 0.975)) ** 2
