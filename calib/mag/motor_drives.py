"""Regressors of the motors' field: current, throttle, or every motor output."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import scipy

from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.windows import finite_rows

METHOD = "mag-motor"
"""The fit of :mod:`calib.mag.motor`; named here, so that composing its result loads no fit."""
SMOOTHING = 2.0
"""Smoothing time, s: faster changes reach compass and log at different times, and would attenuate the slope."""
_GAP = 3.0  # s over which a drive is not known
_LIVE = 0.02  # of the largest: an output that moves less is no motor


class DriveKind(StrEnum):
    """Signal to which the field of the motors is proportional."""

    CURRENT = "current"
    THROTTLE = "throttle"
    MOTORS = "motors"


UNIT = {DriveKind.CURRENT: "A", DriveKind.THROTTLE: "1", DriveKind.MOTORS: "1"}


@dataclass(frozen=True, eq=False)
class Drive:
    """Samples (N, p) at `t` (N,): A, or 0..1. `numbers`: which motors, from 1; (0,) where it is one for all.

    A reversible motor (-1..1) has two columns: its signed drive, and the square, which its supply current follows
    whichever way it turns. `squares` says which columns are such squares.
    """

    kind: DriveKind
    t: Array
    values: Array
    numbers: tuple[int, ...]
    squares: tuple[bool, ...] = ()

    @classmethod
    def of(cls, kind: DriveKind, channel: Channel) -> Drive | None:
        """The drive that `channel` carries; None where it never changes, or is nowhere finite."""
        channel = channel.take(finite_rows(channel.values))
        channel = channel.take(np.diff(channel.t, prepend=-np.inf) > 0.0)
        if len(channel) < 3:
            return None
        moves = np.ptp(channel.values, axis=0)
        live = np.flatnonzero(moves > _LIVE * max(float(np.abs(channel.values).max()), 1e-9))
        if not len(live) or not moves[live].all():
            return None
        if kind != DriveKind.MOTORS:
            return cls(kind, channel.t, channel.values[:, live[:1]], (0,))
        columns = [
            (int(i) + 1, squared)
            for i in live
            for squared in ((False, True) if channel.values[:, i].min() < -_LIVE else (False,))
        ]
        values = [channel.values[:, number - 1] ** (2 if squared else 1) for number, squared in columns]
        numbers, squares = zip(*columns, strict=True)
        return cls(kind, channel.t, np.column_stack(values), numbers, squares)

    def columns(self, t: Array) -> Array:
        """At the times `t` (N,): the slow part of every drive, then the fast part (N, 2 p); nan where not known."""
        slow = self._slow()
        both = np.hstack([slow, self.values - slow])
        found = np.column_stack([np.interp(t, self.t, column) for column in both.T])
        after = np.clip(np.searchsorted(self.t, t), 1, len(self.t) - 1)
        known = (t >= self.t[0] - _GAP) & (t <= self.t[-1] + _GAP) & (self.t[after] - self.t[after - 1] < _GAP)
        found[~known] = np.nan
        return found

    def _slow(self) -> Array:
        step = float(np.median(np.diff(self.t)))
        width = int(np.clip(round(SMOOTHING / step), 1, len(self.t)))
        return np.asarray(scipy.ndimage.uniform_filter1d(self.values, width, axis=0, mode="nearest"))

    @property
    def range(self) -> Array:
        """Range of each drive signal (p,), without the extreme percents."""
        low, high = np.percentile(self._slow(), (2.0, 98.0), axis=0)
        return np.asarray(high - low)
