"""Selects samples where the time stamps go back."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.recording import Channel


def in_order(channel: Channel, latest: float) -> tuple[Channel, int]:
    """The largest part of the samples whose time never goes back, and how many were left out.

    Parameters
    ----------
    channel
        As logged. A stamp that was damaged, early or late, costs only itself.
    latest
        Times that are not finite, negative or beyond this (s) are damaged in any case.
    """
    possible = np.isfinite(channel.t) & (channel.t >= 0.0) & (channel.t <= latest)
    if possible.all() and not (np.diff(channel.t) < 0.0).any():
        return channel, 0
    rows = np.flatnonzero(possible)
    kept = rows[_longest_rise(channel.t[rows])]
    return channel.take(kept), len(channel) - len(kept)


MOST_AT_ONCE = 32
"""Samples that a clock of whole milliseconds may stamp alike; where more are, it stood still."""


def moving(t: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which of the times (N,), in order, are of a clock that goes on: the first alone of those in which it stood."""
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
