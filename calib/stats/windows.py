"""Statistics of a three-axis sensor over overlapping windows of time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SPIKE = 4.0  # times the scatter of its neighbours


class Windows(NamedTuple):
    """Statistics of a sensor over M windows; n is 0 if a quarter of the window or more has no sample at either end."""

    n: NDArray[np.intp]
    mean: Array  # (M, 3)
    scatter: Array  # (M,) about a line, all axes
    change: Array  # (M, 3) of that line across the window


def window_statistics(t: Array, x: Array, origin: float, starts: Array, length: float) -> Windows:
    """Mean and straight line of the samples ``start <= t < start + length`` of every window.

    Every window is summed separately, so its numbers do not depend on the rest of `t` (N,) and `x` (N, 3). `origin` is
    a time near the samples. A window without samples has n = 0 and zeros.
    """
    i, j = np.searchsorted(t, starts), np.searchsorted(t, starts + length)
    covered = (t[np.minimum(i, len(t) - 1)] <= starts + length / 4) & (
        t[np.maximum(j - 1, 0)] >= starts + 0.75 * length
    )
    n = np.where(covered, j - i, 0)
    columns = np.column_stack([np.ones(len(t)), t - origin, x, (t - origin)[:, None] * x, (t - origin) ** 2, x**2])
    edges = np.column_stack([i, np.maximum(j, i + 1)]).ravel()
    padded = np.vstack([columns, np.zeros((1, columns.shape[1]))])
    sums = np.add.reduceat(padded, np.minimum(edges, len(t)), axis=0)[::2]
    count = np.maximum(n, 1)[:, None]
    mean, mean_t = sums[:, 2:5] / count, sums[:, 1:2] / count
    time_squares = np.maximum(sums[:, 8:9] - count * mean_t**2, 1e-12)
    slope = (sums[:, 5:8] - count * mean_t * mean) / time_squares
    squares = sums[:, 9:12] - count * mean**2 - slope**2 * time_squares
    variance = np.maximum(squares, 0.0) / np.maximum(count - 2, 1)
    return Windows(n, mean, np.sqrt(variance.sum(axis=1)), slope * length)


def occupied_starts(t: Array, begin: float, end: float, length: float) -> Array:
    """Beginnings of windows, a quarter of `length` apart, within ``begin <= start <= end - length``.

    Only those next to a sample of `t` (N,), so that a recording with a hole of years has no more windows than samples.
    """
    hop = length / 4.0
    numbers = np.floor((t[(t >= begin) & (t <= end)] - begin) / hop)
    starts = begin + hop * np.unique(numbers)
    return np.asarray(starts[starts <= end - length], dtype=np.float64)


def row_of(windows: Windows | None, k: int) -> Windows | None:
    """The statistics of window `k` alone."""
    return None if windows is None else Windows(*(field[k] for field in windows))


def without_spikes(values: Array) -> NDArray[np.bool_]:
    """Mask (N,) of `values` (N, k): False at a lone spike, far from both neighbours, which agree.

    Far means four times the changes around it and thirty times the usual change; a movement lasts longer than one
    sample. Two rounds prevent spikes from hiding each other.
    """
    keep = np.ones(len(values), dtype=np.bool_)
    for _ in range(2):
        rows = np.flatnonzero(keep)
        keep[rows[_isolated(values[rows])]] = False
    return keep


def _isolated(values: Array) -> NDArray[np.bool_]:
    if len(values) < 9:
        return np.zeros(len(values), dtype=np.bool_)
    padded = np.pad(values, ((2, 2), (0, 0)), mode="reflect")
    b2, b1, a1, a2 = (padded[2 + k : len(values) + 2 + k] for k in (-2, -1, 1, 2))
    off = np.abs(values - 0.5 * (b1 + a1))
    across = np.abs(a1 - b1)
    around = np.median([across, np.abs(b1 - b2), np.abs(a1 - a2)], axis=0)  # the next but one may be a spike as well
    usual = np.median(off, axis=0)
    lone = (off > _SPIKE * np.maximum(across, around) + 30.0 * usual) & (off > 1e-9 * np.abs(a1))
    return np.asarray(lone.any(axis=1), dtype=np.bool_)


def finite_rows(values: Array) -> NDArray[np.bool_]:
    """Mask of the rows that hold finite numbers only."""
    finite = np.isfinite(values)
    if finite.all():  # as they almost always are: a reduction of rows takes ten times as long
        return np.ones(len(values), dtype=np.bool_)
    return np.asarray(finite.all(axis=1), dtype=np.bool_)
