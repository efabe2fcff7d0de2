"""Repeatability of a drift: warming against cooling, cross-validated sweeps, thermometer lag.

All use the block means of :class:`calib.thermal.drift.DriftBlocks`, with errors that include slow wander.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial import polynomial as power
from numpy.typing import NDArray

from mavcal.calib.recording import Array
from mavcal.calib.stats.correlated import coloured_covariance
from mavcal.calib.thermal.drift import DriftBlocks

_MOVING = 0.1  # of the fastest rate of temperature: slower is neither warming nor cooling
_BOTH = 0.1  # share of the moving time that either direction needs
_LEAST_BLOCKS = 24
_LAG_GAIN = 0.3  # share of the residual that a lag must explain to be named
_SIGNIFICANT = 4.0  # sd
_ROUNDS = 8
_GRID = 4096  # points of the temperature over time
_SWEEP = 0.4  # of the whole span: a passage of the temperature that covers less is no sweep


@dataclass(frozen=True)
class ThermometerLag:
    """Seconds by which the sensor's die lags its thermometer; negative where the thermometer lags the die.

    First order either way: ``T = T_die + tau dT_die/dt`` for a die that lags by tau, ``T_die = T + tau dT/dt`` for a
    thermometer that does.
    """

    seconds: float
    sd: float


@dataclass(frozen=True, eq=False)
class Die:
    """The temperature of the die for any lag, from that of the thermometer over time."""

    time: Array  # even
    temperature: Array
    rate: Array  # degC/s, smooth

    @classmethod
    def of(cls, time: Array, temperature: Array, blocks: DriftBlocks, rate: Array) -> Die:
        """Die temperature from single samples, with the `rate` (B,) of `blocks`, which is smoother than their steps."""
        grid = np.linspace(time[0], time[-1], _GRID)
        return cls(grid, np.interp(grid, time, temperature), np.interp(grid, blocks.time, rate))

    def at(self, time: Array, seconds: float) -> Array:
        """Temperature of the die at `time` (N,), degC, where it lags by `seconds`."""
        from scipy.signal import lfilter  # loads scipy.stats: 30 MB that an idle service does without

        if seconds <= 0.0:
            return np.asarray(np.interp(time, self.time, self.temperature - seconds * self.rate), dtype=np.float64)
        step = self.time[1] - self.time[0]

        decay = math.exp(-step / seconds)
        # exact for a temperature that is a straight line between two points of the grid
        here = 1.0 - seconds / step * (1.0 - decay)
        before = seconds / step * (1.0 - decay) - decay
        start = self.temperature[0] - seconds * self.rate[0]
        drive = here * self.temperature[1:] + before * self.temperature[:-1]
        rest, _ = lfilter([1.0], [1.0, -decay], drive, zi=np.array([decay * start]))
        return np.asarray(np.interp(time, self.time, np.concatenate([[start], rest])), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class DriftPrediction:
    """How well a drift predicts a record that it was not fitted to; rms of block means about their own mean.

    `explained` is the share of the variance that the correction removes; negative if it makes predictions worse.
    """

    before: Array  # (3,)
    after: Array  # (3,)

    @property
    def explained(self) -> Array:
        """Share of the variance removed, per axis; at most 1."""
        return np.asarray(1.0 - self.after**2 / np.maximum(self.before**2, 1e-300), dtype=np.float64)


def rates(blocks: DriftBlocks, middle: float, half_span: float) -> Array:
    """Rate of the temperature (B,) in degC/s at every block; zeros if the times do not determine it."""
    if len(blocks.time) < 3 or not (np.diff(blocks.time) > 0).all():
        return np.zeros(len(blocks.time))
    temperature = middle + half_span * blocks.design[:, 1]
    return np.asarray(np.gradient(temperature, blocks.time), dtype=np.float64)


def both_ways(rate: Array) -> bool:
    """Whether the temperature went up as well as down."""
    if len(rate) < _LEAST_BLOCKS or not rate.any():
        return False
    up = float((rate[np.abs(rate) > _MOVING * np.abs(rate).max()] > 0).mean())
    return min(up, 1.0 - up) > _BOTH


def thermal_lag(
    blocks: DriftBlocks, die: Die, middle: float, half_span: float, estimated: NDArray[np.bool_]
) -> ThermometerLag | None:
    """The lag that makes warming and cooling agree; None if nothing shows it.

    Newton's method on ``y = P(T_die(lag))``: the column ``P' dT_die/dlag`` beside the powers. It needs warming and
    cooling: in one direction a lag looks like a different curve. The axes share it, each with its own noise.
    """
    if not both_ways(rates(blocks, middle, half_span)):
        return None
    seconds, weight, before, after = 0.0, 0.0, 0.0, 0.0
    p = blocks.design.shape[1]
    longest = 0.25 * float(np.ptp(blocks.time))
    for step in range(_ROUNDS):
        ahead = 0.01 * max(abs(seconds), float(np.diff(die.time[:2])[0]))
        now, later = (die.at(blocks.time, seconds + s) for s in (0.0, ahead))
        design = ((now - middle) / half_span)[:, None] ** np.arange(p)
        total = weight = 0.0
        for axis in np.flatnonzero(estimated):
            change, variance, left, right = _lag_step(blocks, design, (later - now) / ahead / half_span, int(axis))
            total, weight = total + change / variance, weight + 1.0 / variance
            if step == 0:
                before, after = before + left, after + right
        if not (weight > 0.0 and math.isfinite(weight) and after < (1.0 - _LAG_GAIN) * before):
            return None
        seconds = float(np.clip(seconds + total / weight, -longest, longest))
        if abs(total / weight) < 1e-3 / math.sqrt(weight):
            break
    sd = 1.0 / math.sqrt(weight)
    significant = _SIGNIFICANT * sd < abs(seconds) < longest
    return ThermometerLag(seconds, sd) if significant else None


def _lag_step(blocks: DriftBlocks, design: Array, moved: Array, axis: int) -> tuple[float, float, float, float]:
    """Newton's step of the lag by one axis, its variance, and the share of squared residuals before and after it."""
    counts, series = blocks.counts, blocks.series[:, axis]
    plain = _weighted(design, series, counts)
    slope = power.polyval(design[:, 1], power.polyder(plain))
    wide = np.column_stack([design, slope * moved])
    solution = _weighted(wide, series, counts)
    left, right = series - design @ plain, series - wide @ solution
    size = max(float(counts @ left**2), 1e-300)
    gram = (wide.T * counts) @ wide
    if np.linalg.cond(gram / np.sqrt(np.outer(np.diag(gram), np.diag(gram)))) > 1e10:
        return 0.0, np.inf, 0.0, 0.0
    variance = coloured_covariance(wide, series[:, None], counts, blocks.time, gram=gram).covariances[0, -1, -1]
    return float(solution[-1]), max(float(variance), 1e-300), 1.0, float(counts @ right**2) / size


def _weighted(design: Array, series: Array, counts: Array) -> Array:
    root = np.sqrt(counts)
    return np.asarray(np.linalg.lstsq(design * root[:, None], series * root, rcond=None)[0], dtype=np.float64)


def hysteresis(blocks: DriftBlocks, middle: float, half_span: float) -> tuple[Array, Array] | None:
    """Warming minus cooling at the same temperature, and its sd, per series; None without both."""
    rate = rates(blocks, middle, half_span)
    if not both_ways(rate):
        return None
    side = np.where(np.abs(rate) > _MOVING * np.abs(rate).max(), 0.5 * np.sign(rate), 0.0)
    wide = np.column_stack([blocks.design, side])
    gram = (wide.T * blocks.counts) @ wide
    found = coloured_covariance(wide, blocks.series, blocks.counts, blocks.time, gram=gram)
    difference = np.array([_weighted(wide, y, blocks.counts)[-1] for y in blocks.series.T])
    return difference, np.sqrt(found.covariances[:, -1, -1])


def sweeps(blocks: DriftBlocks) -> list[NDArray[np.intp]]:
    """Blocks of every one-way passage of the temperature through a considerable part of its span."""
    x = blocks.design[:, 1]
    least = _SWEEP * float(np.ptp(x))
    turns = [0]
    extreme, way = 0, 0.0
    for i in range(1, len(x)):  # a turn counts once the temperature came back by a good part
        if way == 0.0 and abs(x[i] - x[0]) > 0.25 * least:
            way = float(np.sign(x[i] - x[0]))
        if way * (x[i] - x[extreme]) >= 0.0:
            extreme = i
        elif way * (x[extreme] - x[i]) > 0.5 * least:
            turns.append(extreme)
            extreme, way = i, -way
    turns.append(len(x) - 1)
    parts = [np.arange(a, b + 1) for a, b in pairwise(turns)]
    return [part for part in parts if np.ptp(x[part]) >= least]


def cross_validated(blocks: DriftBlocks) -> DriftPrediction | None:
    """Prediction of every sweep by the curve of all others, over their common temperatures; None: only one sweep."""
    p = blocks.design.shape[1]
    parts = sweeps(blocks)
    if len(parts) < 2 or min(len(part) for part in parts) < p + 2:
        return None
    before, after, weight = np.zeros(blocks.series.shape[1]), np.zeros(blocks.series.shape[1]), 0.0
    x = blocks.design[:, 1]
    for part in parts:
        others = np.concatenate([other for other in parts if other is not part])
        seen = part[(x[part] >= x[others].min()) & (x[part] <= x[others].max())]
        if len(seen) < 3:
            continue
        counts = blocks.counts[seen]
        curve = np.column_stack(
            [_weighted(blocks.design[others], y, blocks.counts[others]) for y in blocks.series[others].T]
        )
        left = blocks.series[seen] - blocks.design[seen] @ curve
        before += _scatter(blocks.series[seen], counts)
        after += _scatter(left, counts)
        weight += float(counts.sum())
    if weight <= 0.0:
        return None
    return DriftPrediction(np.sqrt(before / weight), np.sqrt(after / weight))


def _scatter(series: Array, counts: Array) -> Array:
    mean = counts @ series / counts.sum()
    return np.asarray(counts @ (series - mean) ** 2, dtype=np.float64)
