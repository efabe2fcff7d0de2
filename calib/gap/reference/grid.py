"""Uniform grids from time stamps that jitter, repeat and have holes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Channel

Array = NDArray[np.float64]

LONGEST_HOLE_S = 30.0
"""A recording with a longer hole is two; its longest part is taken."""
_STEP = 1.8  # times the median: longer differences are holes, not jitter


@dataclass(frozen=True, eq=False)
class Grid:
    """A uniform grid and which sample of a channel lies at which of its points.

    `t` (N,) is uniform; sample `sample[i]` of the channel, taken at `stamps[i]`, belongs to point `point[i]`.
    """

    t: Array
    point: NDArray[np.intp]
    sample: NDArray[np.intp]
    stamps: Array
    repeated: int
    cut: bool

    @property
    def observed(self) -> NDArray[np.bool_]:
        """Which points have a sample, shape (N,)."""
        seen = np.zeros(len(self.t), dtype=bool)
        seen[self.point] = True
        return seen


def grid_of(channel: Channel) -> Grid:
    """The grid nearest to the time stamps of `channel`, over its longest part without a long hole.

    Stamps of whole milliseconds, or that jitter by less than half a step, are kept apart; samples with the same stamp
    count once. Samples that are not finite are holes.

    Raises
    ------
    InvalidInputError
        If there are fewer than four samples at different times.
    """
    good = np.flatnonzero(np.isfinite(channel.values).all(axis=1) & np.isfinite(channel.t))
    t = channel.t[good]
    fresh = np.concatenate([[True], np.diff(t) > 0.0]) if len(t) else np.zeros(0, dtype=bool)
    repeated = int(len(t) - fresh.sum())
    good, t = good[fresh], t[fresh]
    if len(t) < 4:
        raise InvalidInputError(f"{channel.sensor} of {channel.source}: {len(t)} samples are no time series")
    first, last = _longest_part(t)
    cut = last - first < len(t)
    good, t = good[first:last], t[first:last]
    dt, start, number = _steps(t)
    points, index = np.unique(number, return_index=True)
    grid = start + dt * np.arange(points[-1] + 1)
    return Grid(grid, points, good[index], t[index], repeated + len(number) - len(points), cut)


def _longest_part(t: Array) -> tuple[int, int]:
    edges = np.concatenate([[0], np.flatnonzero(np.diff(t) > LONGEST_HOLE_S) + 1, [len(t)]])
    best = int(np.argmax(np.diff(edges)))
    return int(edges[best]), int(edges[best + 1])


def _steps(t: Array) -> tuple[float, float, NDArray[np.intp]]:
    """Step, start and number of every stamp on the line that fits them best."""
    if len(t) < 2:
        return 1.0, float(t[0]), np.zeros(len(t), dtype=np.intp)
    differences = np.diff(t)
    short = differences[differences < _STEP * np.median(differences)]
    dt, start = float(short.mean()), float(t[0])
    number = np.concatenate([[0], np.cumsum(np.maximum(np.rint(differences / dt), 1.0))])
    for _ in range(3):
        centred = number - number.mean()
        dt = float(centred @ (t - t.mean()) / (centred @ centred))
        start = float(t.mean() - dt * number.mean())
        if np.abs(t - start - dt * number).max() < 0.5 * dt:
            break
        number = np.rint((t - start) / dt)
    number = np.rint(number - number[0])
    start = float(np.mean(t - dt * number))
    return dt, start, number.astype(np.intp)
