"""Scales of axes: their limits, their ticks, and where a number lies on them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Point = tuple[float, float]

_MOST_POINTS = 600


def shares(values: ArrayLike, limits: tuple[float, float], *, log: bool) -> Array:
    """Positions of values between `limits`, 0..1; on a logarithmic axis values that are not positive lie at 0."""
    found = np.asarray(values, dtype=np.float64)
    low, high = limits
    if log:
        found = np.log10(np.where(found <= 0.0, low, found))
        low, high = math.log10(low), math.log10(high)
    return np.asarray((found - low) / (high - low), dtype=np.float64)


def runs_inside(u: Array, v: Array) -> list[list[Point]]:
    """Pieces inside the axes of a line through points (fractions of both axes), broken at non-finite points."""
    runs: list[list[Point]] = []
    points = list(zip(u.tolist(), v.tolist(), strict=True))
    if len(points) > 1 and np.all((u >= 0.0) & (u <= 1.0) & (v >= 0.0) & (v <= 1.0)):
        return [points]  # as nearly always
    for start, end in pairwise(points):
        kept = _cut(start, end)
        if kept is None:
            continue
        if runs and runs[-1][-1] == kept[0]:
            runs[-1].append(kept[1])
        else:
            runs.append(list(kept))
    return runs


def _cut(start: Point, end: Point) -> tuple[Point, Point] | None:
    """The part of a straight line that lies between 0 and 1 on both axes (Liang and Barsky 1984); None: no part."""
    if not all(map(math.isfinite, (*start, *end))):
        return None
    first, last = 0.0, 1.0
    for edge, step in _edges(start, end):
        if step == 0.0:
            if edge < 0.0:
                return None
        elif step < 0.0:
            first = max(first, edge / step)
        else:
            last = min(last, edge / step)
    if first > last:
        return None
    return _between(start, end, first), _between(start, end, last)


def _edges(start: Point, end: Point) -> Iterator[tuple[float, float]]:
    """For each of the four edges, the distance of `start` inside it, and the extent of the line outwards."""
    for a, b in zip(start, end, strict=True):
        yield a, a - b
        yield 1.0 - a, b - a


def _between(start: Point, end: Point, share: float) -> Point:
    if share in {0.0, 1.0}:
        return end if share else start
    return start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])


def ticks(limits: tuple[float, float], *, log: bool) -> list[tuple[float, str]]:
    """Round numbers within `limits`."""
    low, high = limits
    if log:
        first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
        if last - first < 1:  # less than two powers of ten: halves and fifths of them too
            fine = [m * 10.0**k for k in range(first - 1, last + 1) for m in (1.0, 2.0, 5.0)]
            return [(v, f"{v:g}") for v in fine if low <= v <= high]
        every = max(1, math.ceil((last - first) / 6))
        return [(10.0**k, f"{10.0**k:g}") for k in range(first, last + 1, every)]
    step = 10.0 ** math.floor(math.log10((high - low) / 4.0))
    step *= next(m for m in (1.0, 2.0, 5.0, 10.0) if (high - low) / (m * step) <= 5.0)
    count = range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    return [(k * step, f"{k * step:.6g}") for k in count]


def limits_of(*values: ArrayLike, log: bool = False, zero: bool = False) -> tuple[float, float]:
    """Limits that contain the finite `values` with a margin; never empty."""
    found = np.concatenate([np.asarray(v, dtype=np.float64).ravel() for v in values])
    found = found[np.isfinite(found) & ((found > 0.0) | (not log))]
    if not len(found):
        return (0.1, 1.0) if log else (0.0, 1.0)
    low, high = float(found.min()), float(found.max())
    if log:
        return (low / 1.3, high * 1.3) if high / low > 1.5 else (low / 3.0, high * 3.0)
    low, high = (min(low, 0.0), max(high, 0.0)) if zero else (low, high)
    room = 0.06 * (high - low) or 0.5 * abs(high) or 1.0
    return low - (0.0 if zero and low == 0.0 else room), high + room


def thinned(t: Array, values: Array) -> tuple[Array, Array]:
    """At most some hundreds of points of a series, its peaks kept."""
    count = len(t)
    if count <= _MOST_POINTS:
        return t, values
    size = math.ceil(count / (_MOST_POINTS // 2))
    starts = range(0, count, size)
    picked: list[int] = []
    for s in starts:
        part = values[s : s + size]
        picked += sorted({s + int(np.argmin(part)), s + int(np.argmax(part))})
    return t[picked], values[picked]
