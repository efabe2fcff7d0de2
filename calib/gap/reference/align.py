"""Whether two recordings are of one trajectory: their clock offset, and an exchange of axes.

A sensor is compared with its reference axis by axis, so exchanged axes must be found first.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate, correlation_lags

from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.reference.channels import TRIADS
from mavcal.calib.gap.reference.signals import Signal, interpolated
from mavcal.calib.recording import Recording, Sensor, Stage

Array = NDArray[np.float64]

_BETTER = 0.25
"""Share of the misfit that another frame must leave. Chosen, not measured: a calibration error must not look like an
exchange of axes."""
_TIED = 1.1
"""Ratio to the least misfit within which the frame nearest to the identity is chosen. Chosen, not measured: noise makes
equal frames differ by less than a tenth."""
ANOTHER_UNIT = 3.0
"""Ratio of magnitudes above which the units differ. Chosen, not measured: no calibration error reaches it, and all
mistaken units do."""


def best_axis_exchange(measured: Array, ideal: Array, slight: float = 0.0) -> Array:
    """The exchange of axes and signs that fits best; the identity unless another leaves a quarter of its misfit.

    The identity also wins if its relative misfit is below `slight`. Scale and offset do not count: the sum ``m . P i``
    decides. Of several equal fits the one nearest to the identity is chosen.
    """
    cross = measured.T @ ideal
    best = float(np.sqrt((measured**2).sum() * (ideal**2).sum()))
    misfit = {key: max(best - float((cross * turn).sum()), 1e-12 * best) for key, turn in AXIS_EXCHANGES.items()}
    least = min(misfit.values())
    if misfit[_IDENTITY] <= max(least / _BETTER, slight * best):
        return AXIS_EXCHANGES[_IDENTITY]
    tied = [key for key, value in misfit.items() if value <= _TIED * least + 1e-3 * best]
    return AXIS_EXCHANGES[max(tied, key=lambda key: float(np.trace(AXIS_EXCHANGES[key])))]


def _axis_exchanges() -> dict[tuple[tuple[int, ...], tuple[int, ...]], Array]:
    found = {}
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            turn = np.zeros((3, 3))
            turn[range(3), order] = signs
            found[order, signs] = turn
    return found


AXIS_EXCHANGES = _axis_exchanges()
_IDENTITY = ((0, 1, 2), (1, 1, 1))


def correlation_in_best_frame(a: Array, b: Array) -> float:
    """Correlation of two movements (N, 3), with the axes of `b` exchanged for the best fit."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    return max(correlation(a, b @ turn.T) for turn in AXIS_EXCHANGES.values())


def matched_to(measured: Array, ideal: Array) -> Array:
    """`measured` in the frame and the unit of `ideal`, both (N, 3), if they differ."""
    turn = best_axis_exchange(measured, ideal)
    turned = measured @ turn
    size = float(np.sum(turned * ideal) / max(float(np.sum(ideal**2)), 1e-300))
    return turned / size if size > ANOTHER_UNIT or 0.0 < size < 1.0 / ANOTHER_UNIT else turned


def correlation(a: Array, b: Array) -> float:
    """Correlation of two movements (N, 3) over all axes, without removing means."""
    size = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / size if size > 0.0 else 0.0


_OVER_S = 0.5
"""Time difference, s, for changes: wandering signals correlate by chance, their changes do not. Chosen, not measured: a
vehicle turns within this time."""
_LATEST_S = 1.0
"""Largest delay of either signal, s. Chosen, not measured: twice the longest delay of the catalogue."""
UNCORRELATED = 0.3
"""Correlation below which movements have nothing in common. Chosen, not measured: less than a tenth of the power is
common then."""
FOLLOWS = 0.3
"""Least fraction of the reference's movement in any sensor's readings, whatever its noise. Chosen, not measured: no
scale error or filter removes as much."""
_MOST = 0.8
"""Largest fraction of the reference's movement attributed to chance. Chosen, not measured: four fifths are nearly
all."""
_BY_CHANCE = 3.0
"""Standard errors of a correlation that chance may reach. Chosen, not measured: one in 370 is larger."""
_FEWEST = 20
"""Least number of independent changes. Chosen, not measured: a correlation of so many has a standard error of 0.22."""


def uncorrelated_axes(trace: Trace, moves: float) -> NDArray[np.bool_]:
    """Axes (3,) on which the reference moves and the sensor does not follow.

    The reference moves if its rms change over half a second is `moves` or more. The fraction of its movement in the
    readings counts, not the correlation alone: a vibrating sensor follows as well. Exchanged axes are reported
    elsewhere.
    """
    step = max(1, round(_OVER_S * trace.fs))
    both = trace.observed[step:] & trace.observed[:-step]
    apart = both.sum() / step
    if apart < _FEWEST:
        return np.zeros(3, dtype=bool)
    measured, ideal = (_changes(values, step, both) for values in (trace.measured, trace.ideal))
    if not np.array_equal(best_axis_exchange(measured, ideal), np.eye(3)):
        return np.zeros(3, dtype=bool)
    latest = round(_LATEST_S * trace.fs)
    return np.array([_is_uncorrelated(measured[:, c], ideal[:, c], moves, latest, apart) for c in range(3)])


def _changes(values: Array, step: int, both: NDArray[np.bool_]) -> Array:
    change = np.where(both[:, None], values[step:] - values[:-step], 0.0)
    return np.asarray(change - np.where(both[:, None], change[both].mean(axis=0), 0.0))


def _is_uncorrelated(measured: Array, ideal: Array, moves: float, latest: int, apart: float) -> bool:
    own, its = float(measured @ measured), float(ideal @ ideal)
    if its < moves**2 * len(ideal) or own == 0.0:
        return False
    products = correlate(measured, ideal, method="fft")
    lags = np.abs(correlation_lags(len(measured), len(ideal)))
    common = float(np.abs(products[lags <= latest]).max())
    by_chance = min(_BY_CHANCE * math.sqrt(own * its / apart), _MOST * its)
    return common < UNCORRELATED * math.sqrt(own * its) and common < max(FOLLOWS * its, by_chance)


SAME = 0.97
"""Correlation above which two tables have the same movement. Chosen, not measured: 94 % of the power is common then."""
SAME_LOG = 0.9995
"""The same for logs of autopilots: two simulated flights of one mission reach 0.994 in their turn rates. Chosen, not
measured: well above that, and below what one flight reaches with itself."""
_APART = 0.5
"""Correlation below which movements are unrelated. Chosen, not measured: a quarter of the power is common then."""
_TURNED = 0.9
"""Correlation that the best of 48 frames must reach, more than for one frame because of chance. Chosen, not measured:
four fifths of the power are common then."""
_SAME_LAG_S = 0.02
"""Tolerance of equal lags, s. Source: one sample at the rate of the search, `_RATE_HZ`."""
_RATE_HZ = 50.0
"""Rate, Hz, of the samples whose lag is sought. Chosen, not measured: beyond the movement of vehicles, and quick."""
_OVERLAP = 0.7
"""Share of the shorter series that must overlap. Chosen, not measured: most of it; one log may begin later."""
_LONGEST_S = 3600.0
"""Seconds of a series whose lag is sought. Chosen, not measured: it bounds the time; few flights are longer."""
_AT_REST = {Sensor.ACCEL: 0.3, Sensor.GYRO: 0.05, Sensor.MAG: 3.0}
"""Standard deviations below which nothing moves, m/s2, rad/s and uT. Chosen, not measured: noise and gusts at rest stay
below."""


@dataclass(frozen=True)
class ClockAlignment:
    """`lag` seconds to add to the second clock, and the `correlation` of the movements with it."""

    lag: float
    correlation: float

    def near(self, lag: float, correlation: float) -> bool:
        """Whether the clocks differ by `lag`, and the movements agree that well."""
        return abs(self.lag - lag) < _SAME_LAG_S and self.correlation >= correlation


def have_same_samples(real: Recording, other: Recording) -> bool:
    """Whether all three sensors have identical samples in both, as for one recording given twice."""
    pairs = [(_first(real, sensor), _first(other, sensor)) for sensor in TRIADS]
    both = [(a, b) for a, b in pairs if a is not None and b is not None]
    return bool(both) and all(np.array_equal(a.values, b.values) for a, b in both)


def have_same_times(real: Recording, other: Recording) -> bool:
    """Whether a sensor was sampled at the same times in both, as in two tables of one run."""
    for sensor in TRIADS:
        a, b = _first(real, sensor), _first(other, sensor)
        if a is not None and b is not None:
            shared = np.isin(np.round(a.t, 9), np.round(b.t, 9)).mean()
            if len(a.t) >= 16 and shared > 0.9 and len(b.t) < 1.2 * len(a.t):
                return True
    return False


def have_unrelated_movement(real: Recording, other: Recording) -> bool:
    """Whether every sensor that moves in both recordings moves differently, as in two runs on similar clocks.

    Movements that agree in another frame are related.
    """
    found = []
    for sensor in TRIADS:
        a, b = _first(real, sensor), _first(other, sensor)
        if a is None or b is None or min(len(a.t), len(b.t)) < 16:
            continue
        x, y = a.values - a.values.mean(axis=0), interpolated(b.t, b.values, a.t)
        y = y - y.mean(axis=0)
        if min(x.std(axis=0).max(), y.std(axis=0).max()) > _AT_REST[sensor]:
            coefficient = float((x * y).sum() / np.sqrt((x**2).sum() * (y**2).sum()))
            found.append(1.0 if correlation_in_best_frame(x, y) > _TURNED else coefficient)
    return bool(found) and max(found) < _APART


def clock_alignment_in_any_frame(real: Recording, other: Recording) -> ClockAlignment | None:
    """Clock shift from the norms of rates and forces, which do not depend on the frame; None if they do not move.

    The correlation is that in the best frame of `other`. See :func:`clock_alignment`.
    """
    for sensor in (Sensor.GYRO, Sensor.ACCEL):
        a, b = _first(real, sensor), _first(other, sensor)
        if a is None or b is None or max(a.t[-1] - a.t[0], b.t[-1] - b.t[0]) > _LONGEST_S:
            continue
        sizes = [Signal(s.t, np.linalg.norm(s.values, axis=1, keepdims=True)) for s in (a, b)]
        if min(s.values.std() for s in sizes) > _AT_REST[sensor]:
            lag = _best_lag(*sizes).lag
            shared = a.t[(a.t >= b.t[0] + lag) & (a.t <= b.t[-1] + lag)]
            if len(shared) >= 16:
                return ClockAlignment(
                    lag,
                    correlation_in_best_frame(
                        interpolated(a.t, a.values, shared), interpolated(b.t + lag, b.values, shared)
                    ),
                )
    return None


def clock_alignment(real: Recording, other: Recording) -> ClockAlignment | None:
    """Clock shift that aligns the movement of `other` with that of `real`; None without a common moving sensor.

    Rates decide, else specific forces, else fields: the first that moves in both.
    """
    for sensor in (Sensor.GYRO, Sensor.ACCEL, Sensor.MAG):
        a, b = _first(real, sensor), _first(other, sensor)
        if a is None or b is None or max(a.t[-1] - a.t[0], b.t[-1] - b.t[0]) > _LONGEST_S:
            continue
        if min(a.values.std(axis=0).max(), b.values.std(axis=0).max()) > _AT_REST[sensor]:
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
    values = interpolated(signal.t, signal.values, np.arange(signal.t[0], signal.t[-1], step))
    return np.asarray(values - values.mean(axis=0))


def _energy(x: Array, lags: NDArray[np.intp], other: int) -> Array:
    """Sum of squares of the rows of `x` that overlap `other` rows, by lag."""
    total = np.concatenate([[0.0], np.cumsum((x**2).sum(axis=1))])
    start, end = np.clip(lags, 0, len(x)), np.clip(lags + other, 0, len(x))
    return np.asarray(total[end] - total[start])


def _first(recording: Recording, sensor: Sensor) -> Signal | None:
    found = [c for c in recording.channels if c.sensor == sensor and c.stage != Stage.DEBIASED]
    found += [c for c in recording.reference if c.sensor == sensor]
    return next((s for c in found if (s := Signal.of(c)) is not None), None)
