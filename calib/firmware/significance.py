"""Whether a change is larger than its own uncertainty.

The calibration in force was once an estimate too, at best as good as the present one. So a change ``d`` has twice the
covariance ``C`` of the present estimate: two calibrations of one sensor differ by that much. The whole change is judged
at once: it is no change while ``d^T (2 C)^+ d`` lies below the 95 % quantile of chi-squared. That has as many degrees
of freedom as `C` has independent parts. A change with zero variance always counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import scipy

from mavcal.calib.firmware.plan import Agreement
from mavcal.calib.recording import Array, Sensor

Judged = tuple[Array, Array]
"""A change (n,) and the covariance of the estimate over it (n, n)."""

CONFIDENCE: Final = 0.95
"""Confidence region within which a change is insignificant."""
ESTIMATES: Final = 2.0
"""Number of estimates in a change: the present one and the one in force."""
SAME: Final = 1e-6
"""Tolerance of an element that the fit holds fixed: single-precision rounding."""


def level_agreement(change: Array, sd: Array) -> Agreement | None:
    """Whether a level trim changes by no more than its uncertainty: `change` and `sd` of roll and pitch (2,)."""
    return agreed(Sensor.ACCEL, 0, "level", [(change, np.diag(sd**2))])


def agreed(sensor: Sensor, instance: int, name: str, judged: Sequence[Judged | None]) -> Agreement | None:
    """The agreement of `name` with what is in force; None: a part of it differs, or cannot be judged (None)."""
    deviation = within(judged)
    if deviation is None:
        return None
    text = f"{name} agrees with what is in force: differs by {deviation:.1f} sd, not written"
    return Agreement(sensor, instance, deviation, text)


def within(judged: Sequence[Judged | None]) -> float | None:
    """Root mean square of the whole change in its standard deviations; None: it is larger than its uncertainty."""
    squares, parts = 0.0, 0
    for item in judged:
        found = None if item is None else _distance(*item)
        if found is None:
            return None
        squares, parts = squares + found[0] / ESTIMATES, parts + found[1]
    if parts == 0 or squares > float(scipy.special.chdtri(parts, 1.0 - CONFIDENCE)):
        return None
    return math.sqrt(squares / parts)


def _distance(change: Array, covariance: Array) -> tuple[float, int] | None:
    """``d^T C^+ d`` and the rank of C; None: something changes that the fit holds for certain."""
    free = np.diag(covariance) > 0.0
    if np.abs(change[~free]).max(initial=0.0) > SAME:
        return None
    if not free.any():
        return None
    sd = np.sqrt(np.diag(covariance)[free])
    scaled = change[free] / sd
    values, vectors = np.linalg.eigh(covariance[np.ix_(free, free)] / np.outer(sd, sd))
    determined = values > 1e-10 * values[-1]
    along = vectors.T @ scaled
    if np.linalg.norm(along[~determined]) > 1e-3 * max(1.0, float(np.linalg.norm(along))):
        return None
    return float((along[determined] ** 2 / values[determined]).sum()), int(determined.sum())
