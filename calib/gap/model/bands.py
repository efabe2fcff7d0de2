"""A long series at a high rate as two bands: slow movement at a low rate, and everything above.

The cosine transform is split at a bin. The lower part is a series at a lower rate with exactly the same coefficients;
only the finest detail of multiplied covariates is lost. The reference's movement is in the lower band; noise, vibration
and tones are above.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import idct

from mavcal.calib.gap.likelihood import fast_length, transform
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.problem import Trace

Array = NDArray[np.float64]

_LONG = 20_000
"""Samples above which a series is split. Chosen, not measured: shorter series are quick enough as they are."""
_RATE_HZ = 50.0
"""Rate of the lower band, Hz. Chosen, not measured: half of it lies above the 10 Hz up to which a vehicle moves as a
whole."""
_SAMPLES = 12_000
"""Samples of the lower band at most; a longer series has a lower rate. Chosen, not measured: four minutes at 50 Hz."""
_LOWEST_HZ = 20.0
"""Rate of the lower band at least, Hz. Source: twice the 10 Hz up to which a vehicle moves as a whole."""
_QUIET = 0.1
"""Power of the reference above the lower band, relative to the noise; with more, the band is widened. Chosen, not
measured: a tenth of the noise hardly changes a likelihood."""
_HOLES = 0.1
"""Fraction of the samples that may be lost to averages over a hole. Chosen, not measured: a band that loses more is
worse than the samples."""
_SERIES = ("measured", "ideal", "force", "rate", "spin", "field", "place", "motors", "rotor_hz")
_SCALARS = ("temperature", "current", "throttle")


def resampled(series: Array, m: int) -> Array:
    """`series` (p, n, ...) at a lower rate: the first `m` coefficients along its second axis."""
    cut = np.moveaxis(transform(np.moveaxis(series, 1, -1))[..., :m], -1, 1)
    lower: Array = idct(cut, type=2, norm="ortho", axis=1) * np.sqrt(m / series.shape[1])
    return lower


def combined(lower: Array, upper: Array) -> Array:
    """Both bands as one series (n, 3): `lower` (m, 3) at its rate, and the part of `upper` (n, 3) above it."""
    bins = np.ascontiguousarray(transform(upper.T).T)
    bins[: len(lower)] = transform(lower.T).T * np.sqrt(len(upper) / len(lower))
    return np.asarray(idct(bins, type=2, norm="ortho", axis=0))


def split(views: Iterable[View]) -> tuple[View, ...]:
    """Every long series in two bands, the lower one first."""
    slow: dict[tuple[int, int], Trace] = {}
    return tuple(band for view in views for band in _bands_of(view, slow))


def _bands_of(view: View, slow: dict[tuple[int, int], Trace]) -> tuple[View, ...]:
    if len(view.keep) >= _LONG:
        view = _at_fast_length(view, slow)
    whole = len(view.keep)
    fs = view.fs
    duration = whole / fs
    rate = max(_LOWEST_HZ, min(_RATE_HZ, _SAMPLES / duration))
    while whole >= _LONG and rate < 0.5 * fs:
        m = fast_length(round(whole * rate / fs))
        if _reference_is_slow(view, m / whole):
            return _split_at(view, m, slow)
        rate *= 2.0
    return (view,)


def _at_fast_length(view: View, slow: dict[tuple[int, int], Trace]) -> View:
    """The series without the last few samples: a length whose transform is fast."""
    n = fast_length(len(view.keep))
    keep = view.keep[:n]
    rows = int(keep.sum())
    if rows == view.n:
        return view
    traces = {}
    for i, trace in view.traces.items():
        key = id(trace), 0
        if key not in slow:
            slow[key] = _replaced(trace, {f.name: _first_rows(getattr(trace, f.name), trace, n) for f in fields(trace)})
        traces[i] = slow[key]
    density = None if view.density is None else _interpolated(view.density, rows)
    return replace(view, traces=traces, residual=view.residual[:rows], keep=keep, density=density)


def _first_rows(value: object, trace: Trace, n: int) -> object:
    return value[:n] if isinstance(value, np.ndarray) and len(value) == len(trace.t) else value


def _replaced(trace: Trace, changes: Mapping[str, Any]) -> Trace:
    return replace(trace, **changes)


def _reference_is_slow(view: View, share: float) -> bool:
    """Whether the reference has hardly any power above that share of the band."""
    for trace in view.traces.values():
        if trace.against is not None:
            continue
        for c in range(3):
            left = transform(np.ascontiguousarray(view.residual[:, c]))
            ideal = transform(np.ascontiguousarray(trace.ideal[view.keep][:, c]))
            above = slice(round(share * view.n), None)
            if float((ideal[above] ** 2).mean()) > _QUIET * float((left[above] ** 2).mean()):
                return False
    return True


def _split_at(view: View, m: int, slow: dict[tuple[int, int], Trace]) -> tuple[View, ...]:
    whole = len(view.keep)
    starts = (np.arange(m) * whole) // m
    keep = np.logical_and.reduceat(view.keep, starts)
    if keep.mean() < (1.0 - _HOLES) * view.keep.mean():
        return (view,)
    traces = {}
    for i, trace in view.traces.items():
        key = id(trace), m
        if key not in slow:
            slow[key] = _at_lower_rate(trace, m)
        traces[i] = slow[key]
    gain = m / whole
    first = round(view.n * gain)
    residual = np.zeros((whole, 3))
    residual[view.keep] = view.residual
    if not view.keep.all():
        rows = np.flatnonzero(view.keep)
        residual = np.column_stack([np.interp(np.arange(whole), rows, column[rows]) for column in residual.T])
    lower = replace(
        view,
        traces=traces,
        residual=np.ascontiguousarray(resampled(residual[None], m)[0][keep]),
        keep=keep,
        variance=None if view.variance is None else gain * view.variance,
        density=None if view.density is None else gain * _interpolated(view.density[:first], int(keep.sum())),
        fine=view,
        gain=gain,
    )
    bins = transform(np.ascontiguousarray(view.residual.T))
    bins[:, :first] = 0.0
    above = np.ascontiguousarray(np.asarray(idct(bins, type=2, norm="ortho")).T)
    density = None if view.density is None else view.density[first:]
    return lower, replace(view, residual=above, density=density, first=first)


def _interpolated(density: Array, m: int) -> Array:
    old, new = np.linspace(0.0, 1.0, len(density)), np.linspace(0.0, 1.0, m)
    return density if len(density) == m else np.column_stack([np.interp(new, old, d) for d in density.T])


def _at_lower_rate(trace: Trace, m: int) -> Trace:
    """A trace at a lower rate."""
    n = len(trace.t)
    centre = (np.arange(m) + 0.5) * n / m - 0.5
    starts = (np.arange(m) * n) // m
    made: dict[str, Array] = {}
    for name in _SERIES:
        values = getattr(trace, name)
        if values is not None:
            made[name] = np.ascontiguousarray(resampled(np.asarray(values, dtype=np.float64)[None], m)[0])
    for name in _SCALARS:
        values = getattr(trace, name)
        if values is not None:
            made[name] = resampled(np.asarray(values, dtype=np.float64)[None], m)[0]
    if trace.attitude is not None:
        made["attitude"] = trace.attitude[np.clip(np.rint(centre).astype(np.intp), 0, n - 1)]
    t, observed = np.interp(centre, np.arange(n), trace.t), np.logical_and.reduceat(trace.observed, starts)
    return _replaced(trace, {**made, "t": t, "observed": observed})


def assembled(views: Sequence[View], power: Sequence[Array], v: int, c: int) -> Array:
    """Power (n,) of axis `c` of series `v` on the bins of the whole series, from both bands."""
    view = views[v]
    if view.fine is None:
        return power[3 * v + c]
    upper = power[3 * (v + 1) + c]
    return np.concatenate([_interpolated(power[3 * v + c][:, None], view.fine.n - len(upper))[:, 0] / view.gain, upper])
