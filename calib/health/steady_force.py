"""Gyroscope offset in flight from the stretches where the specific force keeps its direction.

A vehicle whose force keeps its direction and the length of gravity for seconds does not turn over meanwhile. The rate
across that direction, on average, is then the gyroscope's offset. About it the vehicle may turn as it likes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.health import motion
from mavcal.calib.recording import Channel
from mavcal.calib.stats.stillness import Still

Array = NDArray[np.float64]

_LONG_S: Final = 2.0
"""Shortest calm stretch whose mean is taken."""
_ENOUGH_S: Final = 5.0
"""Calm seconds in all that tell of an offset."""
_LIGHT, _HEAVY = 0.8, 1.15
"""Parts of gravity: between them the force is gravity, by a sensor that is off; in a banked turn it is more."""
_MOST: Final = 0.5  # of the stretches that must be such
_APART: Final = float(np.cos(np.radians(20.0)))
"""Cosine of the angle within which the mean forces of all windows lie where a vehicle stays upright."""


def rates_across(gyro: Channel, accel: Channel, laid: Sequence[Still]) -> motion.WindowMeans:
    """Mean rate across the force in each calm stretch of `laid`, else in each window of ten seconds, rad/s.

    Without a row where the unit shows no stretch in which nothing turned over.
    """
    long = [span for span in laid if span.duration >= _LONG_S]
    calm = sum(span.duration for span in long) >= _ENOUGH_S
    by_rate, by_force = (_span_means(c, long) if calm else _ten_seconds(c) for c in (gyro, accel))
    if not len(by_rate.t) or not len(by_force.t):
        return motion.nothing(3)
    forces = np.column_stack([np.interp(by_rate.t, by_force.t, column) for column in by_force.values.T])
    length = np.linalg.norm(forces, axis=1)
    up = forces / np.maximum(length, 1e-9)[:, None]
    kept = (length > _LIGHT * STANDARD_GRAVITY) & (length < _HEAVY * STANDARD_GRAVITY)
    if not calm:
        middle = np.median(up, axis=0)
        kept &= up @ middle > _APART * float(np.linalg.norm(middle))
    if kept.sum() < _MOST * len(kept) or not (calm or kept.sum() >= motion.LEAST_WINDOWS):
        return motion.nothing(3)
    across = by_rate.values - np.einsum("ni,ni->n", by_rate.values, up)[:, None] * up
    return motion.WindowMeans(by_rate.t[kept], across[kept])


def mean_lengths(accel: Channel, laid: Sequence[Still]) -> motion.WindowMeans:
    """Length of the mean force in each calm stretch of `laid`, else in each window of ten seconds, m/s2."""
    long = [span for span in laid if span.duration >= _LONG_S]
    calm = sum(span.duration for span in long) >= _ENOUGH_S
    means = _span_means(accel, long) if calm else _ten_seconds(accel)
    return motion.WindowMeans(means.t, np.linalg.norm(means.values, axis=1)[:, None])


def _span_means(channel: Channel, spans: Sequence[Still]) -> motion.WindowMeans:
    parts = [motion.usable(channel.between(span.start, span.end)) for span in spans]
    parts = [part for part in parts if len(part) > 3]
    if not parts:
        return motion.nothing(3)
    return motion.WindowMeans(
        np.array([0.5 * (p.t[0] + p.t[-1]) for p in parts]), np.array([p.values.mean(axis=0) for p in parts])
    )


def _ten_seconds(channel: Channel) -> motion.WindowMeans:
    good = motion.usable(channel)
    return motion.window_means(good.t, good.values)
