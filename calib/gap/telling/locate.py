"""Location of the gap: every channel in every regime, in nats and in its unit.

A regime is one bin of one covariate: time, temperature, current, throttle, rate, specific force, attitude, frequency.
Samples are whitened by the declared noise. In a cell without a gap the sum of their squares is chi-squared, and their
sum is normal. Both are tested, with Holm's correction for all cells and channels.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, ndtr

from mavcal.calib.gap.model.joint import Model
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.schema import FIRST, LocatedGap, Regime

Array = NDArray[np.float64]

_BINS = 6
"""Bins of equal width over time or another covariate. Chosen, not measured: a table that a person reads."""
_BANDS = 8
"""Bands of frequency. Chosen, not measured: a table that a person reads."""
_FEWEST = 24
"""Least number of samples in a tested bin. Chosen, not measured: a variance of as many is known to 29 %
(sqrt(2/24))."""


@dataclass(frozen=True, eq=False)
class _Cell:
    v: int
    c: int
    regime: Regime
    squares: float
    count: int
    total: float
    rms: float

    @property
    def p(self) -> float:
        """Chance of the power or of the sum, twice the smaller one."""
        power = float(chdtrc(self.count, self.squares))
        mean = 2.0 * float(ndtr(-abs(self.total) / math.sqrt(self.count))) if math.isfinite(self.total) else 1.0
        return min(1.0, 2.0 * min(power, mean))

    @property
    def nats(self) -> float:
        """Loss of log-likelihood a sample against the declared noise."""
        return 0.5 * max(self.squares / self.count - 1.0, (self.total / self.count) ** 2, 0.0)


def located(model: Model, alpha: float) -> tuple[LocatedGap, ...]:
    """Every significant cell of a model without effects, the largest total loss first."""
    cells = [cell for v in range(len(model.setting.views)) for c in range(3) for cell in _cells(model, v, c)]
    order = sorted(range(len(cells)), key=lambda i: cells[i].p)
    findings, running = [], 0.0
    for rank, i in enumerate(order):
        running = max(running, min(1.0, cells[i].p * (len(cells) - rank)))
        if running >= alpha:
            break
        findings.append((cells[i].nats * cells[i].count, _located_gap(model, cells[i], running)))
    return tuple(finding for _, finding in sorted(findings, key=lambda pair: -pair[0]))


def _located_gap(model: Model, cell: _Cell, p: float) -> LocatedGap:
    view = model.setting.views[cell.v]
    instance = max(view.weights, key=lambda i: view.weights[i]) + FIRST
    channel = f"{view.sensor.value}.{'xyz'[cell.c]}"
    return LocatedGap(channel, instance, cell.regime, cell.nats, cell.rms, view.any_trace.unit, p)


def _cells(model: Model, v: int, c: int) -> Iterator[_Cell]:
    view = model.setting.views[v]
    residual = model.residual[v][:, c]
    sd = np.sqrt(model.noise[3 * v + c].power)
    y = view.spectra(model.residual[v])[c]
    if view.first:
        yield from _bands(v, c, view, y, sd)
        return
    white = view.whitened(y / sd)
    everything = np.ones(view.n, dtype=bool)
    yield _time_cell(v, c, Regime("all", (0.0, 1.0)), white, residual, everything)
    for kind, unit, values in _covariates(view):
        edges = _edges(values)
        for low, high in itertools.pairwise(edges):
            rows = (values >= low) & ((values < high) | (high == edges[-1]))
            if rows.sum() >= _FEWEST:
                yield _time_cell(v, c, Regime(kind, (float(low), float(high)), unit), white, residual, rows)
    yield from _bands(v, c, view, y, sd)


def _time_cell(v: int, c: int, regime: Regime, white: Array, residual: Array, rows: NDArray[np.bool_]) -> _Cell:
    inside = white[rows]
    rms = math.sqrt(float((residual[rows] ** 2).mean()))
    return _Cell(v, c, regime, float(inside @ inside), len(inside), float(inside.sum()), rms)


def _bands(v: int, c: int, view: View, y: Array, sd: Array) -> Iterator[_Cell]:
    hz = 0.5 * view.fs * np.arange(view.first, view.n) / view.n
    edges = [0.0, *np.geomspace(hz[min(8, view.count - 1)], 0.5 * view.fs, _BANDS)]
    for low, high in itertools.pairwise(edges):
        rows = (hz >= low) & (hz < high)
        if rows.sum() >= 4:
            inside = y[rows] / sd[rows]
            rms = math.sqrt(float((y[rows] ** 2).sum()) / view.n)
            regime = Regime("band", (float(low), float(high)), "Hz")
            yield _Cell(v, c, regime, float(inside @ inside), int(rows.sum()), math.nan, rms)


def _edges(values: Array) -> Array:
    """Edges of bins of equal width; one bin for a constant."""
    low, high = float(values.min()), float(values.max())
    return np.linspace(low, high, _BINS + 1) if high > low else np.array([low, high])


def _covariates(view: View) -> Iterator[tuple[str, str, Array]]:
    trace = view.any_trace
    yield "time", "s", view.t
    for kind, unit, values in _recorded(trace):
        if values is not None:
            yield kind, unit, np.asarray(values[view.keep])


def _recorded(trace: Trace) -> Iterator[tuple[str, str, Array | None]]:
    yield "temperature", "degC", trace.temperature
    yield "current", "A", trace.current
    yield "throttle", "1", trace.throttle
    yield "rate", "rad/s", None if trace.rate is None else np.linalg.norm(trace.rate, axis=1)
    yield "force", "m/s2", None if trace.force is None else np.linalg.norm(trace.force, axis=1)
    yield "attitude", "deg", None if trace.attitude is None else _tilt(trace.attitude)


def _tilt(q: Array) -> Array:
    """Angle of the body's down from the vertical, degrees."""
    cosine = 1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2) / (q**2).sum(axis=1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
