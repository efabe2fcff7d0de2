"""Statistics of a three-axis sensor over overlapping windows of time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Windows(NamedTuple):
    """Statistics of a sensor over M windows; n is 0 where a quarter of the window or more at an end has no sample."""

    n: NDArray[np.intp]
    mean: Array  # (M, 3)
    scatter: Array  # (M,) about a line, all axes
    change: Array  # (M, 3) of that line across the window


def window_statistics(t: Array, x: Array, origin: float, starts: Array, length: float) -> Windows:
    """Mean and straight line of the samples ``start <= t < start + length`` of every window.

    Every window is summed by itself, so the numbers do not depend on what else is in `t` (N,) and `x` (N, 3).
    `origin` is a time near the samples. A window without samples has n = 0 and zeros.
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


def row_of(windows: Windows | None, k: int) -> Windows | None:
    """The statistics of window `k` alone."""
    return None if windows is None else Windows(*(field[k] for field in windows))


def finite_rows(values: Array) -> NDArray[np.bool_]:
    """Which rows hold only finite numbers."""
    return np.asarray(np.isfinite(values).all(axis=1), dtype=np.bool_)
