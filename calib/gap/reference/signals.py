"""Signals over time: values between samples, uniform grids from time stamps, derivatives below a cut-off.

Time stamps jitter, repeat and have holes. Derivatives of a recorded pose are taken up to the frequency where its own
noise takes over.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct
from scipy.interpolate import CubicSpline

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Channel

Array = NDArray[np.float64]

HOLE = 3.5
"""Longest interpolated interval between two samples, in median steps. Chosen, not measured: two lost samples in a row
are bridged."""


@dataclass(frozen=True, eq=False)
class Signal:
    """Smooth values over time: samples `t` (N,), increasing, `values` (N, k)."""

    t: Array
    values: Array

    @classmethod
    def of(cls, channel: Channel) -> Signal | None:
        """The finite samples of `channel`; None if there are fewer than four."""
        good = _finite(channel)
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
            smooth[hole] = interpolated(self.t, self.values, inside[hole])
        return smooth

    def known(self, t: Array) -> NDArray[np.bool_]:
        """Whether each of `t` lies between two neighbouring samples without a hole."""
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
        return np.asarray((differences[after - 1] > HOLE * np.median(differences)) & ~at_sample)


def _finite(channel: Channel) -> NDArray[np.bool_]:
    """Samples of a channel whose time and values are finite."""
    return np.asarray(np.isfinite(channel.values).all(axis=1) & np.isfinite(channel.t))


def interpolated(t: Array, values: Array, wanted: Array) -> Array:
    """Columns of `values` (N, k) at `wanted`, linear between the samples `t` and held at the ends."""
    return np.column_stack([np.interp(wanted, t, column) for column in values.T])


def slow_values(channels: Iterable[Channel], wanted: Array) -> Array | None:
    """The first of `channels` with samples, interpolated at `wanted`; None without one.

    For slow quantities: temperature, current, throttle.
    """
    for channel in channels:
        good = _finite(channel)
        if good.sum() >= 2:
            return interpolated(channel.t[good], channel.values[good], wanted)
    return None


LONGEST_HOLE_S = 30.0
"""Longest hole, s; a recording with a longer one is split, and its longest part used. Chosen, not measured: temperature
and battery stay the same for as long."""
_STEP = 1.8
"""Multiple of the median step above which a step is a hole, not jitter. Chosen, not measured: one lost sample makes
two."""
_SINGLE = 1.5
"""Multiple of the mean of the remaining steps above which a step contains a lost sample, shortened by jitter. Chosen,
not measured: midway between one step and two. The median is unsuitable here: whole milliseconds at 400 Hz are steps of
2 and 3."""


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
    """The uniform grid nearest to the time stamps of `channel`, over its longest part without a long hole.

    Stamps of whole milliseconds, or with jitter below half a step, stay distinct; samples with one stamp count once.
    Samples that are not finite are holes.

    Raises
    ------
    InvalidInputError
        If there are fewer than four samples at different times.
    """
    good = np.flatnonzero(_finite(channel))
    t = channel.t[good]
    fresh = np.concatenate([[True], np.diff(t) > 0.0]) if len(t) else np.zeros(0, dtype=bool)
    repeated = int(len(t) - fresh.sum())
    good, t = good[fresh], t[fresh]
    if len(t) < 4:
        raise InvalidInputError(f"{channel.sensor} of {channel.source}: {len(t)} samples are no time series")
    first, last = _longest_part(t)
    cut = last - first < len(t)
    good, t = good[first:last], t[first:last]
    dt, start, number = _uniform_steps(t)
    points, index = np.unique(number, return_index=True)
    grid = start + dt * np.arange(points[-1] + 1)
    return Grid(grid, points, good[index], t[index], repeated + len(number) - len(points), cut)


def _longest_part(t: Array) -> tuple[int, int]:
    edges = np.concatenate([[0], np.flatnonzero(np.diff(t) > LONGEST_HOLE_S) + 1, [len(t)]])
    best = int(np.argmax(np.diff(edges)))
    return int(edges[best]), int(edges[best + 1])


def _uniform_steps(t: Array) -> tuple[float, float, NDArray[np.intp]]:
    """Step, start and sample numbers of the line that fits the time stamps best."""
    if len(t) < 2:
        return 1.0, float(t[0]), np.zeros(len(t), dtype=np.intp)
    differences = np.diff(t)
    dt, start = float(np.median(differences)), float(t[0])
    for longest in (_STEP, _SINGLE):
        dt = float(differences[differences < longest * dt].mean())
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


_OPEN = 0.9
"""Fraction of the Nyquist frequency above which no cut-off is applied. Chosen, not measured: nearly all of the band
passes."""
_LOWEST_HZ = 1.0
"""Lowest cut-off, Hz. Chosen, not measured: below, nothing of a movement passes."""
_STEEP = 8
"""Steepness of the filter's edge: it attenuates by 4 % half an octave below its cut-off, and by 0.3 % an octave below.
A Gaussian (2) attenuates by 16 % there, and every sensor would look noisier than its reference. Source: the response
`2^-(f / f_c)^n`."""


@dataclass(frozen=True, eq=False)
class LowPassedSignal:
    """Values (N, k) and their first two derivatives on a uniform grid `t`; `cutoff_hz` is None if nothing was smoothed.

    `noise` (k,) is the standard deviation of what was left out.
    """

    t: Array
    values: Array
    first: Array
    second: Array
    cutoff_hz: float | None
    noise: Array


def low_passed(signal: Signal, cutoff_hz: float | None = None) -> LowPassedSignal:
    """`signal` low-passed at `cutoff_hz`; None: unchanged.

    The filter has zero phase, is flat up to its edge, and has half amplitude at the cut-off.
    """
    step = float(np.median(np.diff(signal.t)))
    t = signal.t[0] + step * np.arange(int(np.floor((signal.t[-1] - signal.t[0]) / step + 1e-6)) + 1)
    values = signal.at(t)
    noise = np.zeros(values.shape[1])
    if cutoff_hz is not None:
        line = values[0] + (values[-1] - values[0]) * ((t - t[0]) / max(t[-1] - t[0], step))[:, None]
        spectrum = dct(values - line, axis=0, norm="ortho")
        hz = np.arange(len(t)) / (2.0 * step * len(t))
        passed = spectrum * np.exp2(-((hz / cutoff_hz) ** _STEEP))[:, None]
        noise = np.sqrt(((spectrum - passed) ** 2).sum(axis=0) / len(t))
        values = line + idct(passed, axis=0, norm="ortho")
    spline = CubicSpline(t, values, axis=0)
    return LowPassedSignal(t, values, spline(t, 1), spline(t, 2), cutoff_hz, noise)


def bandwidth(t: Array, derived: Array, measured: Array) -> float | None:
    """Frequency up to which `derived` (N, 3), uniform in `t`, predicts `measured` (N, 3); None: all.

    A band helps if ``|m - d|^2 < |m|^2``; the cut-off maximises the cumulative gain. The sensor's own noise raises both
    sides alike.
    """
    d, m = (dct(x - x.mean(axis=0), axis=0, norm="ortho") for x in (derived, measured))
    gained = np.cumsum((2.0 * m * d - d**2).sum(axis=1))
    hz = np.arange(len(t)) / (2.0 * (t[1] - t[0]) * len(t))
    best = float(hz[int(np.argmax(gained))])
    return None if best > _OPEN * hz[-1] else max(best, _LOWEST_HZ)
