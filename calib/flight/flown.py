"""Drift with temperature where the rests alone are too narrow: two units' difference, in flight as well.

``f_1 - f_2 = c + N f_2 + p(T) + noise``: what the vehicle does cancels up to N, by which the two differ in scale and
mounting, and which the flight itself tells. A flight shakes, so its cells weigh as little as they scatter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.flight.rest import ground
from mavcal.calib.flight.warm import Log, difference
from mavcal.calib.recording import Channel, Recording, Sensor
from mavcal.calib.stats.windows import finite_rows
from mavcal.calib.thermal.drift import DriftData

Array = NDArray[np.float64]

_CELL = 1.0  # s
_LEAST_CELLS = 30
_LEAST_SAMPLES = 8  # of a cell


@dataclass(frozen=True, eq=False)
class Flown:
    """Differences freed of N and of the constant of each log, and what not knowing those costs."""

    channel: Channel
    """No samples yet; says the sensor and its unit."""
    data: DriftData
    loss: float  # largest factor by which the nuisances raise a variance of the curve
    flight: float  # s
    logs: int


def flown_difference(logs: Sequence[Log], sensor: Sensor, instance: int, other: int, degree: int) -> Flown | None:
    """Cells of one second of the whole logs; None: too few of them, or no difference can be taken."""
    cells = [cell for k, log in enumerate(logs) if (cell := _cells(log, sensor, instance, other, k)) is not None]
    if not cells:
        return None
    rows = np.concatenate(cells)
    time, log, flying, count, t = rows[:, :5].T
    y, second, variance = rows[:, 5:8], rows[:, 8:11], rows[:, 11]
    if len(rows) < _LEAST_CELLS + 3 * degree or np.ptp(t) < 1.0:
        return None
    constants = (log[:, None] == np.unique(log)).astype(np.float64)
    nuisance = np.hstack([constants, second - second.mean(axis=0)])
    curve = ((t - t.mean()) / np.ptp(t))[:, None] ** np.arange(1, degree + 1)
    weight = count / _noise(variance, count, flying)
    for _ in range(2):  # the second time by what is left, which knows of what is slower than a cell
        root = np.sqrt(weight)[:, None]
        whole = np.hstack([nuisance, curve])
        solution = np.linalg.lstsq(root * whole, root * y, rcond=1e-10)[0]
        left = y - whole @ solution
        weight = count / _noise((left**2).mean(axis=1) * count, count, flying)
    freed = y - nuisance @ solution[: nuisance.shape[1]]
    quiet = float(_noise(variance, count, flying).min())
    counts = np.maximum(weight * quiet, 1e-6)  # worth as many quiet samples
    channel = next(c for item in logs for c in item.recording.find(sensor, instance)).take(slice(0, 0))
    data = DriftData(
        time=time,
        t=t,
        y=freed,
        half=None,
        constant=np.zeros(3, dtype=np.bool_),
        ignored=0,
        counts=counts,
        scatter=np.full(3, float((quiet * count).sum())),
    )
    root = np.sqrt(weight)[:, None]
    loss = _loss(root * curve, root * np.ones((len(rows), 1)), root * nuisance)
    return Flown(channel, data, loss, float(flying.sum()) * _CELL, len(cells))


def _cells(log: Log, sensor: Sensor, instance: int, other: int, number: int) -> Array | None:
    """Rows time, log, flying, samples, temperature, difference (3), second unit (3), variance of a sample."""
    recording = log.recording
    try:
        first, second = recording.channel(sensor, instance), recording.channel(sensor, other)
    except InvalidInputError:
        return None
    apart = difference(first, second)
    thermometers = log.temperature_of
    thermometer = thermometers.get(instance, thermometers.get(0))
    if apart is None or thermometer is None or len(apart) < _LEAST_SAMPLES:
        return None
    apart = apart.take(finite_rows(apart.values))
    warm = thermometer.take(finite_rows(thermometer.values))
    if not len(apart) or not len(warm):
        return None
    cell = np.floor((apart.t - apart.t[0]) / _CELL).astype(np.intp)
    size = int(cell[-1]) + 1
    count = np.bincount(cell, minlength=size)
    beside = np.column_stack([np.interp(apart.t, second.t, column) for column in second.values.T])
    columns = [apart.t, *apart.values.T, *beside.T, (apart.values**2).sum(axis=1)]
    used = count >= _LEAST_SAMPLES
    means = np.array([np.bincount(cell, column, minlength=size) for column in columns])[:, used] / count[used]
    variance = np.maximum(means[7] - (means[1:4] ** 2).sum(axis=0), 0.0) / 3.0
    flying = _flying(recording, means[0])
    temperature = np.interp(means[0], warm.t, warm.values[:, 0])
    return np.column_stack(
        [
            means[0] + log.shift,
            np.full(means.shape[1], number),
            flying,
            count[used],
            temperature,
            means[1:4].T,
            means[4:7].T,
            variance,
        ]
    )


def _flying(recording: Recording, t: Array) -> NDArray[np.bool_]:
    flying = np.zeros(len(t), dtype=np.bool_)
    for span in ground(recording).running:
        flying |= (t > span.start - _CELL) & (t < span.end + _CELL)
    return flying


def _noise(variance: Array, count: Array, flying: Array) -> Array:
    """Variance of a sample for every cell: that of the rests, or of the flights."""
    found = np.empty(len(variance))
    for kind in (flying > 0, flying == 0):
        if kind.any():
            found[kind] = max(float(np.average(variance[kind], weights=count[kind])), 1e-18)
    return found


def _loss(curve: Array, one: Array, nuisance: Array) -> float:
    """Largest factor by which `nuisance` raises the variance of a combination of the curve's terms, over `one`."""
    plain, each = (curve - n @ np.linalg.lstsq(n, curve, rcond=1e-10)[0] for n in (one, nuisance))
    factor = np.linalg.cholesky(each.T @ each + 1e-12 * np.trace(plain.T @ plain) * np.eye(len(plain.T)))
    half = np.linalg.solve(factor, plain.T)
    return max(1.0, float(np.linalg.eigvalsh(half @ half.T)[-1]))
