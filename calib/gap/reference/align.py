"""Whether two recordings are of one trajectory, and by how much their clocks differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate, correlation_lags

from mavcal.calib.gap.reference.calibrated import TRIADS
from mavcal.calib.gap.reference.correlation import turned_correlation
from mavcal.calib.gap.reference.signals import Signal, linear
from mavcal.calib.recording import Recording, Sensor, Stage

Array = NDArray[np.float64]

SAME = 0.97
"""Correlation from which the movements of two tables are one."""
CLOSED = 0.9995
"""The same for logs of autopilots: two simulated flights of one mission reach 0.994 in their turn rates."""
_APART = 0.5  # correlation below which movements are different ones
_TURNED = 0.9  # the best of 48 frames is more alike by chance than one
_SAME_LAG_S = 0.02  # by which equal lags may differ
_RATE_HZ = 50.0  # of the samples whose lag is sought
_OVERLAP = 0.7  # of the shorter one
_LONGEST_S = 3600.0  # of a series whose lag is sought
_STILL = {Sensor.ACCEL: 0.3, Sensor.GYRO: 0.05, Sensor.MAG: 3.0}  # standard deviations below which nothing moves


@dataclass(frozen=True)
class ClockAlignment:
    """`lag` seconds are to be added to the second clock; `correlation` is that of the movements then, 1 at best."""

    lag: float
    correlation: float

    def near(self, lag: float, correlation: float) -> bool:
        """Whether the clocks differ by `lag`, and the movements agree that well."""
        return abs(self.lag - lag) < _SAME_LAG_S and self.correlation >= correlation


def same_digits(real: Recording, other: Recording) -> bool:
    """Whether all three sensors hold the same samples in both: one recording given twice."""
    pairs = [(_first(real, sensor), _first(other, sensor)) for sensor in TRIADS]
    both = [(a, b) for a, b in pairs if a is not None and b is not None]
    return bool(both) and all(np.array_equal(a.values, b.values) for a, b in both)


def one_clock(real: Recording, other: Recording) -> bool:
    """Whether a sensor of both was sampled at the very same times: rows of one run."""
    for sensor in TRIADS:
        a, b = _first(real, sensor), _first(other, sensor)
        if a is not None and b is not None:
            shared = np.isin(np.round(a.t, 9), np.round(b.t, 9)).mean()
            if len(a.t) >= 16 and shared > 0.9 and len(b.t) < 1.2 * len(a.t):
                return True
    return False


def unrelated_movement(real: Recording, other: Recording) -> bool:
    """Whether every sensor that moves in both moves otherwise: two runs whose clocks both began at the same number.

    Movements that are one in another frame are not apart: which frame, the checks say.
    """
    found = []
    for sensor in TRIADS:
        a, b = _first(real, sensor), _first(other, sensor)
        if a is None or b is None or min(len(a.t), len(b.t)) < 16:
            continue
        x, y = a.values - a.values.mean(axis=0), linear(b.t, b.values, a.t)
        y = y - y.mean(axis=0)
        if min(x.std(axis=0).max(), y.std(axis=0).max()) > _STILL[sensor]:
            coefficient = float((x * y).sum() / np.sqrt((x**2).sum() * (y**2).sum()))
            found.append(1.0 if turned_correlation(x, y) > _TURNED else coefficient)
    return bool(found) and max(found) < _APART


def aligned_in_any_frame(real: Recording, other: Recording) -> ClockAlignment | None:
    """As :func:`aligned`, by the sizes of turn rates and forces, which no frame changes; None where they do not tell.

    The correlation is that of the movements in the frame of `other` that fits best.
    """
    for sensor in (Sensor.GYRO, Sensor.ACCEL):
        a, b = _first(real, sensor), _first(other, sensor)
        if a is None or b is None or max(a.t[-1] - a.t[0], b.t[-1] - b.t[0]) > _LONGEST_S:
            continue
        sizes = [Signal(s.t, np.linalg.norm(s.values, axis=1, keepdims=True)) for s in (a, b)]
        if min(s.values.std() for s in sizes) > _STILL[sensor]:
            lag = _best_lag(*sizes).lag
            shared = a.t[(a.t >= b.t[0] + lag) & (a.t <= b.t[-1] + lag)]
            if len(shared) >= 16:
                return ClockAlignment(
                    lag, turned_correlation(linear(a.t, a.values, shared), linear(b.t + lag, b.values, shared))
                )
    return None


def aligned(real: Recording, other: Recording) -> ClockAlignment | None:
    """The shift that makes `other` move as `real` does; None if either does not move, or they have no sensor in common.

    Turn rates decide, then specific forces, then fields: the first of them that moves in both.
    """
    for sensor in (Sensor.GYRO, Sensor.ACCEL, Sensor.MAG):
        a, b = _first(real, sensor), _first(other, sensor)
        if a is None or b is None or max(a.t[-1] - a.t[0], b.t[-1] - b.t[0]) > _LONGEST_S:
            continue
        if min(a.values.std(axis=0).max(), b.values.std(axis=0).max()) > _STILL[sensor]:
            return _best_lag(a, b)
    return None


def _best_lag(a: Signal, b: Signal) -> ClockAlignment:
    step = 1.0 / _RATE_HZ
    x, y = _sampled(a, step), _sampled(b, step)
    n = min(len(x), len(y))
    product = sum(correlate(x[:, k], y[:, k], method="fft") for k in range(x.shape[1]))
    lags = correlation_lags(len(x), len(y))
    overlap = np.minimum(len(x), lags + len(y)) - np.maximum(0, lags)
    allowed = np.flatnonzero(overlap >= _OVERLAP * n)
    ahead = _energy(x, lags, len(y)), _energy(y, -lags, len(x))
    score = np.asarray(product)[allowed] / np.sqrt(np.maximum(ahead[0] * ahead[1], 1e-30))[allowed]
    best = int(np.argmax(score))
    fine = 0.0
    if 0 < best < len(score) - 1:
        left, here, right = score[best - 1 : best + 2]
        bend = left - 2.0 * here + right
        fine = float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5)) if bend < 0.0 else 0.0
    return ClockAlignment(float(a.t[0] - b.t[0] + (lags[allowed[best]] + fine) * step), float(score[best]))


def _sampled(signal: Signal, step: float) -> Array:
    values = linear(signal.t, signal.values, np.arange(signal.t[0], signal.t[-1], step))
    return np.asarray(values - values.mean(axis=0))


def _energy(x: Array, lags: NDArray[np.intp], other: int) -> Array:
    """Sum of squares of the rows of `x` that overlap `other` rows shifted by each lag."""
    total = np.concatenate([[0.0], np.cumsum((x**2).sum(axis=1))])
    start, end = np.clip(lags, 0, len(x)), np.clip(lags + other, 0, len(x))
    return np.asarray(total[end] - total[start])


def _first(recording: Recording, sensor: Sensor) -> Signal | None:
    found = [c for c in recording.channels if c.sensor == sensor and c.stage != Stage.DEBIASED]
    found += [c for c in recording.reference if c.sensor == sensor]
    return next((s for c in found if (s := Signal.of(c)) is not None), None)
