"""Removal of samples that no sensor measured: zeros of a dead sensor, and times that go back or stand still."""

from __future__ import annotations

from bisect import bisect_right
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.recording import Channel, Event, Oddity, OddSamples, Sensor

_NEVER_ZERO: Final = (Sensor.ACCEL, Sensor.MAG)
"""Sensors that never read exactly 0, 0, 0; a gyroscope at rest may."""


def without_zeros(channel: Channel, events: list[Event]) -> Channel:
    """`channel` without samples that are exactly zero; `events` gets their number.

    Such samples of an accelerometer or compass come from a dead sensor. A channel that holds nothing else is kept.
    """
    if channel.sensor not in _NEVER_ZERO or channel.unit == "counts":
        return channel
    zero = ~np.asarray(channel.values.any(axis=1))
    if not zero.any() or zero.all():
        return channel
    when, count = channel.t[zero], int(zero.sum())
    odd = OddSamples(Oddity.ZERO, channel.sensor, channel.instance, count, len(zero), until=float(when[-1]))
    text = f"{count} of {len(zero)} samples of {channel.source} are exactly 0, 0, 0, which such a sensor never reads"
    message = f"{channel.sensor} {channel.instance + 1}: {text}; left out"
    events.append(Event(float(when[0]), "damage", message, odd))
    return channel.take(~zero)


def in_order(channel: Channel, latest: float) -> tuple[Channel, int]:
    """The largest part of the samples whose time never goes back, and how many were left out.

    Parameters
    ----------
    channel
        As logged. A damaged time stamp, early or late, removes only its own sample.
    latest
        Times that are not finite, negative or beyond this (s) are always damaged.
    """
    possible = np.isfinite(channel.t) & (channel.t >= 0.0) & (channel.t <= latest)
    if possible.all() and not (np.diff(channel.t) < 0.0).any():
        return channel, 0
    rows = np.flatnonzero(possible)
    kept = rows[_longest_rise(channel.t[rows])]
    return channel.take(kept), len(channel) - len(kept)


MOST_AT_ONCE = 32
"""Most samples with the same stamp of a millisecond clock; with more, the clock had stopped."""


def moving(t: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mask of the ordered times (N,) at which the clock ran; of a run of equal times only the first."""
    first = np.ones(len(t), dtype=np.bool_)
    first[1:] = t[1:] != t[:-1]
    runs = np.diff(np.append(np.flatnonzero(first), len(t)))
    return np.asarray(first | np.repeat(runs <= MOST_AT_ONCE, runs))


def _longest_rise(t: NDArray[np.float64]) -> NDArray[np.intp]:
    """Rows of a longest non-decreasing subsequence, by patience sorting."""
    tops: list[float] = []
    top_rows: list[int] = []
    before = np.full(len(t), -1, dtype=np.intp)
    for row, time in enumerate(t.tolist()):
        pile = bisect_right(tops, time)
        if pile:
            before[row] = top_rows[pile - 1]
        if pile == len(tops):
            tops.append(time)
            top_rows.append(row)
        else:
            tops[pile], top_rows[pile] = time, row
    chain = []
    row = top_rows[-1] if top_rows else -1
    while row >= 0:
        chain.append(row)
        row = int(before[row])
    return np.array(chain[::-1], dtype=np.intp)
