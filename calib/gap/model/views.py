"""The series of the likelihood: traces, or combinations of instances with independent noise.

Instances with a common uncertain reference share its error; their differences are free of it. Traces of several
instances on one grid are therefore turned into orthonormal contrasts: the mean, and differences. They hold the same
information, and each has noise of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.fft import idct

from mavcal.calib.gap.likelihood import fast_length, frequencies, transform
from mavcal.calib.gap.problem import GapProblem, ReferenceKind, Trace
from mavcal.calib.gap.remembered import remembered
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_SHORTEST = 32
"""Least number of samples in a series. Chosen, not measured: fewer hardly have a spectrum."""


@dataclass(frozen=True, eq=False)
class View:
    """One series: a weighted sum over instances.

    Parameters
    ----------
    weights
        By instance.
    traces
        By instance: where its columns are evaluated.
    residual : shape (n, 3)
        Measured minus ideal at the rows that are kept.
    keep : shape (N,)
        The rows of the traces that are kept.
    variance : shape (3,) or None
        Variance of the declared white noise of one sample, quantisation included. None: to be learned.
    density : shape (n, 3) or None
        Power at the frequencies of the cosine transform, learned from nominal recordings; in place of `variance`.
    reference_error
        Whether the error of the reference's attitude is in it.
    att_sd
        Standard deviation of the reference's attitude about an axis, rad, where it was re-estimated; else 0.
    dof
        Squared numbers per axis from which the noise was learned; infinite where it is declared.
    inside_sd
        Standard deviations of what was estimated inside the reference: a gyroscope's matrix, an accelerometer's scales,
        or the Earth's field.
    label
        Identifies the noise, which blocks and bands of one series share.
    first
        The lowest bin of its transform that counts: below lies the other band of the same series.
    fine
        For a lower band: the whole series at its own rate.
    gain
        For a lower band: its rate over the series' own, which is also the ratio of the powers in a bin.
    """

    sensor: Sensor
    weights: Mapping[int, float]
    traces: Mapping[int, Trace]
    residual: Array
    keep: NDArray[np.bool_]
    variance: Array | None
    density: Array | None
    reference_error: bool
    dof: float = math.inf
    label: str = ""
    first: int = 0
    fine: View | None = None
    gain: float = 1.0
    att_sd: float = 0.0
    inside_sd: tuple[float, ...] = ()

    @property
    def n(self) -> int:
        """Samples."""
        return len(self.residual)

    @property
    def count(self) -> int:
        """Numbers per axis that it adds to the likelihood."""
        return self.n - self.first

    @property
    def whole(self) -> View:
        """The series at its own rate."""
        return self if self.fine is None else self.fine

    @cached_property
    def omega(self) -> Array:
        """Frequencies of its bins, rad per sample of the whole series."""
        return self.gain * frequencies(self.n)[self.first :]

    def spectra(self, series: Array) -> Array:
        """Transforms (3, count) of a `series` (n, 3), from its first bin."""
        return _spectra(series, self.first)

    def whitened(self, bins: Array) -> Array:
        """The series (n,) of given bins (count,), with zero for the others."""
        padded = np.concatenate([np.zeros(self.first), bins]) if self.first else bins
        return np.asarray(idct(padded, type=2, norm="ortho"))

    @property
    def fs(self) -> float:
        """Samples per second."""
        return self.any_trace.fs

    @property
    def any_trace(self) -> Trace:
        """The trace of its first instance."""
        return next(iter(self.traces.values()))

    @cached_property
    def t(self) -> Array:
        """Times of the kept rows, s."""
        return np.asarray(self.any_trace.t[self.keep])

    @property
    def ideal(self) -> Array:
        """Ideal reading (n, 3): the weighted sum over its instances."""
        return np.asarray(np.add.reduce([w * self.traces[i].ideal[self.keep] for i, w in self.weights.items()]))


@remembered(60)
def _spectra(series: Array, first: int) -> Array:
    """The transforms of a `series` (n, 3) from bin `first` on, (3, n - first)."""
    return transform(np.ascontiguousarray(series.T))[:, first:]


def views_of(
    problem: GapProblem, masked: Mapping[int, NDArray[np.bool_]], extra: Mapping[int, float]
) -> tuple[View, ...]:
    """Every series of `problem`.

    Parameters
    ----------
    problem
        Traces with one reference each.
    masked
        By index of the trace: rows that leave the likelihood.
    extra
        By index of the trace: variance that a coarser lattice than the declared one adds to a sample.
    """
    uncertain = problem.reference.att_sigma_deg > 0.0 or problem.reference.kind in {
        ReferenceKind.POSE,
        ReferenceKind.ESTIMATOR,
        ReferenceKind.NOMINAL,
    }
    views: list[View] = []
    for sensor in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG):
        entries = [
            _Entry(t, masked.get(i), extra.get(i, 0.0)) for i, t in enumerate(problem.traces) if t.sensor is sensor
        ]
        views += _of_sensor(entries, uncertain=uncertain)
    estimated = problem.reference.kind is ReferenceKind.ESTIMATOR
    sd = math.radians(problem.reference.att_sigma_deg) if estimated else 0.0
    known = problem.reference
    inside = {Sensor.GYRO: known.gyro_sd, Sensor.MAG: known.field_sd, Sensor.ACCEL: known.accel_sd}
    return tuple(
        replace(view, label=str(v), att_sd=sd, inside_sd=inside.get(view.sensor, ()))
        for v, view in enumerate(views)
        if view.n >= _SHORTEST
    )


class _Entry:
    """A trace and the rows of it that are kept."""

    def __init__(self, trace: Trace, masked: NDArray[np.bool_] | None, extra: float) -> None:
        finite = np.isfinite(trace.measured).all(axis=1) & np.isfinite(trace.ideal).all(axis=1)
        self.trace = trace
        self.keep = trace.observed & finite
        if masked is not None:
            self.keep = self.keep & ~masked
        self.extra = extra


def _of_sensor(entries: Sequence[_Entry], *, uncertain: bool) -> list[View]:
    single = [e for e in entries if e.trace.against is None]
    against = [e for e in entries if e.trace.against is not None]
    alone = all(len(e.trace.instances) == 1 for e in single)
    if uncertain and alone and len(single) > 1:
        if all(_same_grid(single[0].trace, e.trace) for e in single[1:]):
            return _contrasts(single)
        if against:
            return [_single_view(single[0]), *map(_difference_view, _independent_differences(against, set()))]
    covered = {i for e in single for i in e.trace.instances}
    return [*map(_single_view, single), *map(_difference_view, _independent_differences(against, covered))]


def _same_grid(a: Trace, b: Trace) -> bool:
    return len(a.t) == len(b.t) and bool(np.abs(a.t - b.t).max() < 0.05 / a.fs)


def _independent_differences(against: Sequence[_Entry], covered: set[int]) -> list[_Entry]:
    """Differences that each add a further instance."""
    chosen = []
    seen = set(covered)
    for entry in against:
        pair = {*entry.trace.instances, entry.trace.against}
        if not pair <= seen:
            chosen.append(entry)
            seen |= {i for i in pair if i is not None}
    return chosen


def _single_view(entry: _Entry) -> View:
    instances = entry.trace.instances
    weights = dict.fromkeys(instances, 1.0 / len(instances))
    return _view([entry], [1.0], weights, dict.fromkeys(instances, entry.trace), reference_error=True)


def _difference_view(entry: _Entry) -> View:
    trace = entry.trace
    assert trace.against is not None
    weights = {**dict.fromkeys(trace.instances, 1.0 / len(trace.instances)), trace.against: -1.0}
    return _view([entry], [1.0], weights, dict.fromkeys(weights, trace), reference_error=False)


def _contrasts(entries: Sequence[_Entry]) -> list[View]:
    m = len(entries)
    rows = [np.full(m, 1.0 / math.sqrt(m))]
    for j in range(1, m):
        row = np.zeros(m)
        row[:j], row[j] = 1.0, -float(j)
        rows.append(row / np.linalg.norm(row))
    instances = [e.trace.instances[0] for e in entries]
    traces = {i: e.trace for i, e in zip(instances, entries, strict=True)}
    return [
        _view(entries, row, dict(zip(instances, map(float, row), strict=True)), traces, reference_error=k == 0)
        for k, row in enumerate(rows)
    ]


def _view(
    entries: Sequence[_Entry],
    factors: Sequence[float] | Array,
    weights: Mapping[int, float],
    traces: Mapping[int, Trace],
    *,
    reference_error: bool,
) -> View:
    used = [(e, float(f)) for e, f in zip(entries, factors, strict=True) if f != 0.0]
    keep = np.logical_and.reduce([e.keep for e, _ in used])
    residual = np.add.reduce([f * (e.trace.measured - e.trace.ideal) for e, f in used])[keep]
    return View(
        used[0][0].trace.sensor,
        {i: w for i, w in weights.items() if w != 0.0},
        traces,
        np.ascontiguousarray(residual),
        keep,
        _declared_variance(used),
        _learned_density(used, len(residual)),
        reference_error,
        min(e.trace.sigma_dof for e, _ in used),
    )


def _declared_variance(used: Sequence[tuple[_Entry, float]]) -> Array | None:
    total = np.zeros(3)
    for entry, f in used:
        if entry.trace.sigma is None:
            return None
        # Noise learned from a recording includes its quantisation.
        rounding = entry.trace.quantum**2 / 12.0 if math.isinf(entry.trace.sigma_dof) else 0.0
        total += f**2 * (np.asarray(entry.trace.sigma) ** 2 + rounding + entry.extra)
    return total if (total > 0.0).all() else None


def _learned_density(used: Sequence[tuple[_Entry, float]], n: int) -> Array | None:
    """Learned power: independent noise adds by squares; the reference's error is common and cancels or grows."""
    traces = [entry.trace for entry, _ in used]
    if any(t.psd is None or t.psd_hz is None or (t.own_psd is None and len(used) > 1) for t in traces):
        return None
    total, shared = np.zeros((n, 3)), np.zeros((n, 3))
    for (entry, f), trace in zip(used, traces, strict=True):
        whole = _interpolated(trace, trace.psd, n)
        own = whole if trace.own_psd is None else np.minimum(_interpolated(trace, trace.own_psd, n), whole)
        total += f**2 * (own + entry.extra)
        shared += (whole - own) / len(used)
    total += sum(f for _, f in used) ** 2 * shared
    return total if (total > 0.0).all() else None


def _interpolated(trace: Trace, spectrum: Array | None, n: int) -> Array:
    assert spectrum is not None
    assert trace.psd_hz is not None
    hz = 0.5 * trace.fs * np.arange(n) / n
    return np.column_stack([np.interp(hz, trace.psd_hz, p) for p in spectrum.T])


def between(view: View, start: float, end: float) -> View | None:
    """The part of a series with ``start <= t < end``, shortened to a fast length; None if it is too short."""
    rows = (view.t >= start) & (view.t < end)
    if rows.sum() < _SHORTEST:
        return None
    count = fast_length(int(rows.sum()))
    rows[np.flatnonzero(rows)[count:]] = False
    keep = view.keep.copy()
    keep[np.flatnonzero(keep)[~rows]] = False
    fine = None if view.fine is None else between(view.fine, start, end)
    first = round(view.first * count / view.n)
    density = None
    if view.density is not None:
        old, new = np.arange(view.count) / view.count, np.arange(count - first) / (count - first)
        density = np.column_stack([np.interp(new, old, column) for column in view.density.T])
    return replace(view, residual=view.residual[rows], keep=keep, density=density, first=first, fine=fine)
