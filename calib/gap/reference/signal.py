"""A signal between its samples, and where it is known."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from mavcal.calib.recording import Channel

Array = NDArray[np.float64]

_HOLE = 3.5  # median steps between two samples beyond which nothing is known between them


@dataclass(frozen=True, eq=False)
class Signal:
    """Smooth values over time: samples `t` (N,), increasing, `values` (N, k)."""

    t: Array
    values: Array

    @classmethod
    def of(cls, channel: Channel) -> Signal | None:
        """The finite samples of `channel`; None if there are fewer than four."""
        good = np.isfinite(channel.values).all(axis=1) & np.isfinite(channel.t)
        t, values = channel.t[good], channel.values[good]
        fresh = np.concatenate([[True], np.diff(t) > 0.0]) if len(t) else np.zeros(0, dtype=bool)
        return cls(t[fresh], values[fresh]) if fresh.sum() >= 4 else None

    def shifted(self, by: float) -> Signal:
        """The same, `by` seconds later."""
        return Signal(self.t + by, self.values)

    def at(self, t: Array) -> Array:
        """Values at `t`, cubic between the samples and exact at them; held at the ends, linear across holes."""
        if len(t) == len(self.t) and np.array_equal(t, self.t):
            return self.values
        inside = np.clip(t, self.t[0], self.t[-1])
        smooth = np.asarray(CubicSpline(self.t, self.values, axis=0)(inside), dtype=np.float64)
        hole = self._in_hole(inside)
        if hole.any():
            smooth[hole] = linear(self.t, self.values, inside[hole])
        return smooth

    def known(self, t: Array) -> NDArray[np.bool_]:
        """Whether each of `t` lies between two samples that are near to each other."""
        step = float(np.median(np.diff(self.t)))
        inside = (t >= self.t[0] - 0.5 * step) & (t <= self.t[-1] + 0.5 * step)
        return np.asarray(inside & ~self._in_hole(t))

    def rate_of_change(self) -> Signal:
        """Central differences."""
        return Signal(self.t, np.gradient(self.values, self.t, axis=0))

    def _in_hole(self, t: Array) -> NDArray[np.bool_]:
        differences = np.diff(self.t)
        after = np.clip(np.searchsorted(self.t, t, side="right"), 1, len(self.t) - 1)
        at_sample = self.t[after - 1] == t
        return np.asarray((differences[after - 1] > _HOLE * np.median(differences)) & ~at_sample)


def linear(t: Array, values: Array, wanted: Array) -> Array:
    """Columns of `values` (N, k) at `t` (N,), straight between the samples and held at the ends."""
    return np.column_stack([np.interp(wanted, t, column) for column in values.T])


def slow(channels: Iterable[Channel], wanted: Array) -> Array | None:
    """The first of `channels` that has samples, at the times `wanted`; None if none has.

    For what changes slowly: temperature, current, throttle. Held at the ends.
    """
    for channel in channels:
        good = np.isfinite(channel.values).all(axis=1) & np.isfinite(channel.t)
        if good.sum() >= 2:
            return linear(channel.t[good], channel.values[good], wanted)
    return None
