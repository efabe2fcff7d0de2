"""Checks inertial sensors in flight, without a rest: the force along the vertical, and the rates against the attitude.

Over ten seconds the mean vertical force is gravity, apart from the change of the climb rate. The integral of a
gyroscope is the turn of the attitude. Medians over such windows suppress take-off, impacts and lost attitudes. While
the specific force keeps its direction and the length of gravity for seconds, the vehicle does not tilt. The mean rate
perpendicular to the force is then the gyroscope's offset; about the force the vehicle may turn freely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.flight.flying import usable
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.stillness import Still

WINDOW_S: Final = 10.0
LEAST_WINDOWS: Final = 3
LONGEST_STEP_S: Final = 0.5
"""Longest step between two attitudes, s; a longer one is a gap."""
_FULL: Final = 0.8  # of a window that must be covered
_MEDIAN: Final = 1.2533 * 1.4826  # standard error of a median from the median deviation
_LONG_S: Final = 2.0
"""Shortest calm span, s, whose mean is used."""
_ENOUGH_S: Final = 5.0
"""Least total calm time, s, that shows an offset."""
_LIGHT, _HEAVY = 0.8, 1.15
"""Fractions of g between which a force counts as gravity, sensor error included; a banked turn exceeds them."""
_MOST: Final = 0.5  # of the stretches that must be such
_APART: Final = float(np.cos(np.radians(20.0)))
"""Cosine of the largest angle of a window's mean force from the median while the vehicle stays upright."""


@dataclass(frozen=True, eq=False)
class WindowMeans:
    """Means over windows of ten seconds, (M,) times of their middle and (M, k) values."""

    t: Array
    values: Array

    @property
    def enough(self) -> bool:
        """Whether there are enough windows for a median."""
        return len(self.t) >= LEAST_WINDOWS

    @property
    def median(self) -> Array:
        """Median over the windows, (k,)."""
        return np.asarray(np.median(self.values, axis=0), dtype=np.float64)

    @property
    def sd(self) -> Array:
        """Standard error of :attr:`median`, (k,)."""
        spread = np.median(np.abs(self.values - self.median), axis=0)
        return np.asarray(_MEDIAN * spread / np.sqrt(len(self.values)), dtype=np.float64)


def vertical_force(accel: Channel, attitude: Channel) -> WindowMeans:
    """Specific force along the vertical, m/s2: 9.8 for a good sensor, apart from the change of the climb rate."""
    f, q = usable(accel), usable(attitude)
    if len(f) < 2 or len(q) < 2:
        return no_windows(1)
    up = -Rotation.from_quat(q.values, scalar_first=True).as_matrix()[:, 2, :]  # down in the body is the third row
    at = np.column_stack([np.interp(f.t, q.t, column) for column in up.T])
    known = _steps_around(q.t, f.t) <= LONGEST_STEP_S
    return window_means(f.t[known], np.einsum("ij,ij->i", f.values, at)[known][:, None])


class RatePart(StrEnum):
    """Part of a rate: about the vertical it turns the heading, across it the tilt."""

    ALL = "all"
    LEVEL = "level"
    VERTICAL = "vertical"


def rate_error(gyro: Channel, attitude: Channel, part: RatePart = RatePart.ALL) -> WindowMeans:
    """Rate of the gyroscope beyond the turn of the attitude, rad/s, about all axes of the body or that part of it."""
    w, q = usable(gyro), usable(attitude)
    if len(w) < 2 or len(q) < 2:
        return no_windows(3)
    step = np.diff(q.t)
    turned = Rotation.from_quat(q.values, scalar_first=True)
    by_attitude = (turned[:-1].inv() * turned[1:]).as_rotvec()
    angle = np.vstack([np.zeros(3), np.cumsum(0.5 * (w.values[1:] + w.values[:-1]) * np.diff(w.t)[:, None], axis=0)])
    by_gyro = np.diff(np.column_stack([np.interp(q.t, w.t, column) for column in angle.T]), axis=0)
    covered = (q.t[:-1] >= w.t[0]) & (q.t[1:] <= w.t[-1]) & (_steps_around(w.t, q.t[1:]) <= LONGEST_STEP_S)
    good = covered & (step <= LONGEST_STEP_S)
    beyond = (by_gyro - by_attitude) / step[:, None]
    if part != RatePart.ALL:
        down = turned[1:].as_matrix()[:, 2, :]
        vertical = np.einsum("ni,ni->n", beyond, down)[:, None] * down
        beyond = vertical if part == RatePart.VERTICAL else beyond - vertical
    return window_means(0.5 * (q.t[1:] + q.t[:-1])[good], beyond[good], step[good])


def difference(first: Channel, second: Channel) -> WindowMeans:
    """First minus second of two units of a kind."""
    a, b = usable(first), usable(second)
    if len(a) < 2 or len(b) < 2:
        return no_windows(a.values.shape[1])
    beside = np.column_stack([np.interp(a.t, b.t, column) for column in b.values.T])
    known = (_steps_around(b.t, a.t) <= LONGEST_STEP_S) & (a.t >= b.t[0]) & (a.t <= b.t[-1])
    return window_means(a.t[known], (a.values - beside)[known])


def no_windows(columns: int) -> WindowMeans:
    """No windows, of that many columns."""
    return WindowMeans(np.zeros(0), np.zeros((0, columns)))


def _steps_around(t: Array, at: Array) -> Array:
    """Length of the step of `t` (N,) in which each of `at` lies; infinite outside."""
    row = np.searchsorted(t, at)
    inside = (row > 0) & (row < len(t))
    row = np.clip(row, 1, len(t) - 1)
    return np.where(inside | (at == t[0]), t[row] - t[row - 1], np.inf)


def window_means(t: Array, values: Array, weight: Array | None = None) -> WindowMeans:
    """Means over the covered windows; each sample is weighted by the time since the previous one."""
    if len(t) < 2:
        return no_windows(values.shape[1])
    step = np.diff(t, prepend=t[0]) if weight is None else weight
    step = np.minimum(step, LONGEST_STEP_S)
    cell = np.floor((t - t[0]) / WINDOW_S).astype(np.intp)
    named, row = np.unique(cell, return_inverse=True)
    covered = np.bincount(row, step)
    used = covered >= _FULL * WINDOW_S
    total = np.maximum(covered, 1e-12)
    sums = np.column_stack([np.bincount(row, step * column) for column in values.T])
    means = (sums / total[:, None])[used]
    return WindowMeans(t[0] + (named[used] + 0.5) * WINDOW_S, means)


def rates_across(gyro: Channel, accel: Channel, laid: Sequence[Still]) -> WindowMeans:
    """Mean rate across the force in each calm stretch of `laid`, else in each window of ten seconds, rad/s.

    Empty if the vehicle tilted in too many of these spans.
    """
    long = [span for span in laid if span.duration >= _LONG_S]
    calm = sum(span.duration for span in long) >= _ENOUGH_S
    by_rate, by_force = (_span_means(c, long) if calm else _ten_seconds(c) for c in (gyro, accel))
    if not len(by_rate.t) or not len(by_force.t):
        return no_windows(3)
    forces = np.column_stack([np.interp(by_rate.t, by_force.t, column) for column in by_force.values.T])
    length = np.linalg.norm(forces, axis=1)
    up = forces / np.maximum(length, 1e-9)[:, None]
    kept = (length > _LIGHT * STANDARD_GRAVITY) & (length < _HEAVY * STANDARD_GRAVITY)
    if not calm:
        middle = np.median(up, axis=0)
        kept &= up @ middle > _APART * float(np.linalg.norm(middle))
    if kept.sum() < _MOST * len(kept) or not (calm or kept.sum() >= LEAST_WINDOWS):
        return no_windows(3)
    across = by_rate.values - np.einsum("ni,ni->n", by_rate.values, up)[:, None] * up
    return WindowMeans(by_rate.t[kept], across[kept])


def mean_lengths(accel: Channel, laid: Sequence[Still]) -> WindowMeans:
    """Length of the mean force in each calm stretch of `laid`, else in each window of ten seconds, m/s2."""
    long = [span for span in laid if span.duration >= _LONG_S]
    calm = sum(span.duration for span in long) >= _ENOUGH_S
    means = _span_means(accel, long) if calm else _ten_seconds(accel)
    return WindowMeans(means.t, np.linalg.norm(means.values, axis=1)[:, None])


def _span_means(channel: Channel, spans: Sequence[Still]) -> WindowMeans:
    parts = [usable(channel.between(span.start, span.end)) for span in spans]
    parts = [part for part in parts if len(part) > 3]
    if not parts:
        return no_windows(3)
    return WindowMeans(
        np.array([0.5 * (p.t[0] + p.t[-1]) for p in parts]), np.array([p.values.mean(axis=0) for p in parts])
    )


def _ten_seconds(channel: Channel) -> WindowMeans:
    good = usable(channel)
    return window_means(good.t, good.values)
