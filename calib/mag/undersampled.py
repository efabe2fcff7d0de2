"""Blur and lag of a compass that was sampled more slowly than it turned.

Residuals of slow samples are no series: from one to the next everything has changed, so misfit cannot be told from
noise by its correlation in time. What causes blur and lag is known, though: the turn. A mean over a window ``w``
shortens the field by ``(w^2/24) |du/dt|^2``, which a steady tumble hides in the ellipsoid. An axis that is read later
by ``d`` than the others is off by ``d du_i/dt``, along the field by ``d u_i du_i/dt``.

Rows that are poses, written down one by one with their times, have no turn and independent errors. They show by one of
three things: steps of 60 degrees and more, steps as long as those between rows taken at random, or a rate of turn that
no vehicle has.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]

WINDOW_S: Final = 0.1
"""What a compass averages over at most: ArduPilot's read-out at 10 Hz, and the internal averages of magnetometers."""
_SPARSE: Final = float(np.radians(30.0))  # from one sample to the next: beyond it residuals are no series
_POSES: Final = float(np.radians(60.0))  # no vehicle turns so far at every sample
_FASTEST: Final = 2.0 * np.pi  # rad/s: nor so fast for the whole of a recording
_IN_ORDER: Final = 4.0  # standard deviations by which the steps of a movement are shorter than those at random
_MOVES: Final = float(np.radians(1.0))  # between samples, of a compass that is being turned
_FEWEST: Final = 30  # samples that tell of it
_GAP: Final = 3.0  # usual steps, beyond which nothing is known of the turn
_CHANCE: Final = 1e-3  # of finding blur or lag where there is none
_UNIFORM: Final = float(np.sqrt(0.2))  # of the fourth power of a window, if any up to the longest is as likely
_FAR: Final = 5.0  # standard deviations beyond which a residual is an outlier
_CAUSES: Final = 3  # the blur, and the lag of two axes behind the third


@dataclass(frozen=True, eq=False)
class TurningField:
    """Rotation of the field between readings of a slowly sampled compass, where neighbouring samples determine it."""

    rows: NDArray[np.intp]
    """Which of the samples these are, (M,)."""
    u: Array
    """Direction of the field, (M, 3)."""
    rate: Array
    """Its change, 1/s, (M, 3)."""
    squared: Array
    """Square of its rate of turn, rad^2/s^2, (M,)."""
    step: float
    """Usual turn from one sample to the next, rad."""
    window: float
    """Over which a reading may be a mean, s: no longer than the time between samples."""

    @classmethod
    def of(cls, t: Array, corrected: Array) -> TurningField | None:
        """The turn of `corrected` (N, 3), samples at `t` (N,) after the fit; None for a series, and for poses."""
        if len(t) < _FEWEST:
            return None
        u = corrected / np.maximum(np.linalg.norm(corrected, axis=1), 1e-300)[:, None]
        cosines = np.clip(np.einsum("ni,ni->n", u[1:], u[:-1]), -1.0, 1.0)
        turned, steps = np.arccos(cosines), np.diff(t)
        moving = (turned > _MOVES) & (steps > 0.0)
        if int(moving.sum()) < _FEWEST:
            return None
        step, rate = float(np.median(turned[moving])), float(np.median(turned[moving] / steps[moving]))
        by_chance, spread = float(u.mean(axis=0) @ u.mean(axis=0)), float(cosines.std()) / np.sqrt(len(cosines))
        in_order = float(cosines.mean()) - by_chance > _IN_ORDER * spread
        if not (_SPARSE <= step < _POSES and rate < _FASTEST and in_order):
            return None
        usual = float(np.median(steps))
        known = (steps[1:] > 0.0) & (steps[:-1] > 0.0) & (np.maximum(steps[1:], steps[:-1]) < _GAP * usual)
        rows = np.flatnonzero(known) + 1
        if len(rows) < _FEWEST:
            return None
        rates = turned / np.maximum(steps, 1e-12)
        return cls(
            rows=rows,
            u=u[rows],
            rate=(u[rows + 1] - u[rows - 1]) / (t[rows + 1] - t[rows - 1])[:, None],
            squared=0.5 * (rates[rows - 1] ** 2 + rates[rows] ** 2),
            step=step,
            window=min(WINDOW_S, usual),
        )

    @property
    def blur(self) -> Array:
        """Share of the field by which a mean shortens it, root mean square over windows up to the longest, (M,)."""
        return np.asarray(_UNIFORM * self.window**2 / 24.0 * self.squared, dtype=np.float64)

    def seen_in(self, lengths: Array) -> float:
        """Share of the variance of `lengths` (N,), one but for noise and misfit, that follows the turn; 0: none."""
        off = (lengths - np.median(lengths))[self.rows]
        kept = np.abs(off) <= _FAR * 1.4826 * float(np.median(np.abs(off)))
        if int(kept.sum()) < _FEWEST:
            return 0.0
        u, off = self.u[kept], off[kept]
        causes = np.column_stack([self.squared, self.u[:, 0] * self.rate[:, 0], self.u[:, 1] * self.rate[:, 1]])[kept]
        model = np.column_stack([np.ones(len(u)), u, u**2, u * np.roll(u, 1, axis=1)])
        whole = np.column_stack([model, causes / np.maximum(np.abs(causes).max(axis=0), 1e-300)])
        without, with_them = _squares_left(model, off), _squares_left(whole, off)
        free = len(off) - whole.shape[1]
        if free < 1 or not with_them > 0.0:
            return 0.0
        chance = scipy.special.fdtrc(_CAUSES, free, (without - with_them) / _CAUSES / (with_them / free))
        return float((without - with_them) / without) if chance < _CHANCE else 0.0


def _squares_left(columns: Array, y: Array) -> float:
    left = y - columns @ np.linalg.lstsq(columns, y, rcond=1e-9)[0]
    return float(left @ left)
