"""Which of two instances an effect sits on, where only their difference is looked at.

A difference d of two instances says that one has what the other has not, and not which. Their mean s does, however
badly any reference follows it: what one of them has alone is half in it, ``E[s d] = (var_1 - var_2) / 2`` (the test of
Pitman 1939 and Morgan 1939 for two variances of a correlated pair), and how the vehicle moves is in s and not in d. In
the band where d has most power beyond the simulator's recording, by X, the excess of ``2 s d / X`` is 1 if the first
instance has it, -1 if the second, and 0 if both have as much of it.

Below the slowest bands there is too little of either; there it is asked which of both is at the reference.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.likelihood import transform
from mavcal.calib.gap.problem import Trace, Worse
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_SLOW = 8
"""Bins of a recording up to which the reference is that of position and field, and of no inertial unit."""
_NEAR = 1.0 / 16.0
"""Part of the power of a difference below which an instance is at the reference."""
_SIDE, _BEYOND = 0.5, 1.5
"""Excess from which on it is one instance that has it, and beyond which it goes with the movement: a scale error."""
_SURE = 4.0
"""Standard errors of the excess that it must be away from zero; half of them for both."""
_MORE = 4.0
"""Standard errors by which a band must have more power than the simulator's."""
_ONE_RATE = 0.02
"""By which rates may differ, relative."""
_CLOSE = 0.05
"""Share of a step by which the times of two instances may differ: beyond, their difference is movement."""


def worse_of(real: Sequence[Trace], sim: Sequence[Trace] = ()) -> dict[Sensor, Worse]:
    """By sensor with two instances, which of them has more than it should; absent where nothing says so.

    Parameters
    ----------
    real
        Each instance against the reference that both share.
    sim
        The same of a simulator's recording.
    """
    found = {}
    for sensor in dict.fromkeys(t.sensor for t in real):
        pair = _pair(real, sensor)
        if pair is None:
            continue
        worse = Worse(_slow(*pair), _fast(pair, _pair(sim, sensor)))
        if worse != Worse():
            found[sensor] = worse
    return found


def _pair(traces: Sequence[Trace], sensor: Sensor) -> tuple[Trace, Trace] | None:
    own = [t for t in traces if t.sensor is sensor and len(t.instances) == 1]
    return (own[0], own[1]) if len(own) == 2 and _together(own[0], own[1]) else None


def _together(one: Trace, other: Trace) -> bool:
    """Whether both were sampled at the same moments, row by row, and some rows are known of both."""
    if len(one.t) != len(other.t) or float(np.abs(one.t - other.t).max(initial=0.0)) > _CLOSE / one.fs:
        return False
    return bool(_known(one, other).any())


def _slow(one: Trace, other: Trace) -> tuple[int, ...] | None:
    """The one that is off the reference while the other is not."""
    known = _known(one, other)
    first, second = (_spectra(t.residual[known])[:, :_SLOW] for t in (one, other))
    apart = float(((first - second) ** 2).sum())
    left = [float((second**2).sum()), float((first**2).sum())]
    for trace, of_other in zip((one, other), left, strict=True):
        if of_other < _NEAR * apart:
            return trace.instances
    return None


@dataclass(frozen=True)
class _Band:
    """Two instances in a band: power of their mean and of their difference, and the product of both, a number."""

    mean: float
    difference: float
    product: float
    count: int


def _fast(real: tuple[Trace, Trace], sim: tuple[Trace, Trace] | None) -> tuple[int, ...] | None:
    """Who has what the difference has more than in the simulator's recording, in the band where that is most."""
    if sim is not None and abs(math.log(real[0].fs / sim[0].fs)) > _ONE_RATE:
        return None
    bands = _bands(*real)
    usual = _bands(*sim) if sim is not None else []
    usual += [_Band(0.0, 0.0, 0.0, 0)] * (len(bands) - len(usual))
    best, found = 0.0, None
    for band, before in zip(bands, usual, strict=False):
        excess = band.difference - before.difference
        chance = before.difference * math.sqrt(2.0 / band.count)
        if excess > _MORE * chance and (energy := band.count * excess) > best:
            best, found = energy, _of(real, band, before, excess)
    return found


def _of(real: tuple[Trace, Trace], band: _Band, before: _Band, excess: float) -> tuple[int, ...] | None:
    side = 2.0 * (band.product - before.product) / excess
    error = 2.0 * math.sqrt(band.mean * band.difference / band.count) / excess
    if abs(side) > _BEYOND + error:
        return None
    if abs(side) > max(_SIDE, _SURE * error):
        return real[0 if side > 0.0 else 1].instances
    if abs(side) + 0.5 * _SURE * error < _SIDE:
        return tuple(sorted(real[0].instances + real[1].instances))
    return None


def _bands(one: Trace, other: Trace) -> list[_Band]:
    """Octaves, the highest first."""
    known = _known(one, other)
    first, second = (_spectra(t.measured[known]) for t in (one, other))
    mean, difference = 0.5 * (first + second), first - second
    n = mean.shape[1]
    edges = [n // 2**k for k in range(max(int(math.log2(max(n / _SLOW, 1.0))), 0) + 1)]
    found = []
    for high, low in itertools.pairwise(edges):
        s, d = mean[:, low:high], difference[:, low:high]
        found.append(_Band(float((s**2).mean()), float((d**2).mean()), float((s * d).mean()), s.size))
    return found


def _known(one: Trace, other: Trace) -> NDArray[np.bool_]:
    finite = [np.isfinite(t.residual).all(axis=1) for t in (one, other)]
    return np.asarray(one.observed & other.observed & finite[0] & finite[1])


def _spectra(series: Array) -> Array:
    """Spectra of a series (n, 3), by axis (3, n)."""
    return transform(np.ascontiguousarray(series.T))
