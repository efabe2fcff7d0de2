"""Where an inertial unit stands still, by limits that the recording itself chooses.

Every quarter of a window the scatter of accelerometer and gyroscope about a straight line is measured. A window is
still if both stay below a multiple of what the quietest windows have; half a window is left off at both ends of every
still span, and a span whose halves disagree is none (METHODS 3.3). Which multiples serve is not known beforehand, so a
ladder of them is tried (:func:`candidates`). The module :mod:`calib.imu.poses` keeps the ones whose accelerometer would
be known best, misfit included. This criterion is per residual, so it does not favour keeping few poses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.recording import Channel
from mavcal.calib.stats.windows import Windows, occupied_starts, window_statistics

Array = NDArray[np.float64]

ACCEL_LADDER = (1.5, 2.5, 4.0, 8.0)
GYRO_LADDER = (1.5, 3.0, 6.0, 12.0)
"""Multiples of the quietest windows' scatter."""
_WINDOW = 0.5  # s
_LEAST_SAMPLES = 10  # of a window
_TILT = 0.01  # rad across a window, beyond its noise: it turns slowly
_HALVES = 0.01  # of gravity, beyond their noise: the halves of a pose differ
_SHORTEST = 1.0  # windows that a span must last after its guards
_QUIET = 0.1  # quantile that is called the quietest


@dataclass(frozen=True, eq=False)
class ScatterWindows:
    """Scatter of both sensors over windows that begin at `starts` (M,), `length` long."""

    starts: Array
    length: float
    accel: Windows
    gyro: Windows
    accel_floor: float
    gyro_floor: float
    gravity: float

    @classmethod
    def of(cls, accel: Channel, gyro: Channel, gravity: float, part: float = 1.0) -> ScatterWindows:
        """Watch two channels of finite samples over the time that both cover; `gravity` in the unit of `accel`.

        `part` is that of the usual window, for poses that were held for less or more than usual.
        """
        begin, end = max(accel.t[0], gyro.t[0]), min(accel.t[-1], gyro.t[-1])
        step = max(_median_step(accel), _median_step(gyro))
        length = max(part * _WINDOW, _LEAST_SAMPLES * step)
        starts = occupied_starts(accel.t, begin, end, length)
        both = [window_statistics(c.t, c.values, begin, starts, length) for c in (accel, gyro)]
        floors = [_floor(windows, c.quantum) for windows, c in zip(both, (accel, gyro), strict=True)]
        return cls(starts, length, both[0], both[1], floors[0], floors[1], gravity)

    def still(self, accel_factor: float, gyro_factor: float) -> NDArray[np.bool_]:
        """Which windows are still at those multiples of the quietest scatter."""
        limit = gyro_factor * self.gyro_floor
        quiet = (self.accel.scatter <= accel_factor * self.accel_floor) & (self.gyro.scatter <= limit)
        full = (self.accel.n >= _LEAST_SAMPLES // 2) & (self.gyro.n >= _LEAST_SAMPLES // 2)
        noise = 4.0 * self.accel.scatter * np.sqrt(12.0 / np.maximum(self.accel.n, 1))
        level = np.linalg.norm(self.accel.change, axis=1) <= _TILT * self.gravity + noise
        quiet &= full & level
        if not quiet.any():
            return quiet
        usual = np.median(self.gyro.mean[quiet], axis=0)
        return np.asarray(quiet & (np.linalg.norm(self.gyro.mean - usual, axis=1) <= limit))


def candidates(watch: ScatterWindows) -> Iterator[Array]:
    """Spans (P, 2) of the still poses for every rung of the ladder, the same ones not twice."""
    seen = set()
    for gyro_factor in GYRO_LADDER:
        for accel_factor in ACCEL_LADDER:
            still = watch.still(accel_factor, gyro_factor)
            if still.tobytes() in seen:
                continue
            seen.add(still.tobytes())
            yield _spans(watch, still)


def _spans(watch: ScatterWindows, still: NDArray[np.bool_]) -> Array:
    """Consecutive still windows, half a window shorter at both ends where motion borders."""
    apart = np.diff(watch.starts) > 0.3 * watch.length  # a hole in the recording
    first = np.flatnonzero(still & np.concatenate([[True], ~still[:-1] | apart]))
    last = np.flatnonzero(still & np.concatenate([~still[1:] | apart, [True]]))
    guard = 0.5 * watch.length
    begins = watch.starts[first] + np.where(first > 0, guard, 0.0)
    ends = watch.starts[last] + watch.length - np.where(last < len(still) - 1, guard, 0.0)
    spans = np.column_stack([begins, ends])
    return spans[ends - begins >= _SHORTEST * watch.length]


def steady(accel: Channel, spans: Array, gravity: float) -> NDArray[np.bool_]:
    """Which of `spans` (P, 2) read the same in both halves, within their noise and a hand's sway."""
    keep = np.zeros(len(spans), dtype=np.bool_)
    for k, (start, end) in enumerate(spans):
        values = accel.between(start, end).values
        if len(values) < _LEAST_SAMPLES:
            continue
        halves = values[: len(values) // 2], values[len(values) // 2 :]
        noise = np.sqrt(sum(half.var(axis=0, ddof=1).sum() / len(half) for half in halves))
        apart = float(np.linalg.norm(halves[0].mean(axis=0) - halves[1].mean(axis=0)))
        keep[k] = apart <= _HALVES * gravity + 4.0 * float(noise)
    return keep


def _median_step(channel: Channel) -> float:
    return float(np.median(np.diff(channel.t)))


def _floor(windows: Windows, quantum: float) -> float:
    """Scatter of the quietest windows; of what the bins alone make where there is no noise."""
    usable = windows.n >= _LEAST_SAMPLES // 2
    quietest = float(np.quantile(windows.scatter[usable], _QUIET)) if usable.any() else 0.0
    largest = float(np.abs(windows.mean[usable]).max(initial=0.0))
    return float(max(quietest, quantum * np.sqrt(3.0 / 12.0), 1e-7 * largest, 1e-300))
