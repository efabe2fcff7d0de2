"""Instances that were not sampled at the moment of their common stamp.

A log writes the latest sample of every unit under one time; each is older by up to a period of its own driver (SITL
runs its inertial units at 1000 and 760 Hz). Their difference then has noise in proportion to how fast the reading
changes, which no steady spectrum holds. A nominal recording shows its size: the variance of that age. Samples in which
it is more than the noise beside it say nothing about the sensor; in the others it is expected.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from mavcal.calib.gap.likelihood import AmplitudeFit, fit_amplitudes
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.reference.noise import with_more

Array = NDArray[np.float64]

_CHANCE = 1e-4
"""Chance of steady noise that seems to follow the change of the reading."""
_FEWEST = 64  # samples that say something of noise


def slopes_squared(trace: Trace) -> Array:
    """Square of the change of the reading in a second, (N, 3): mean of the steps to the samples before and after."""
    known = trace.observed[1:] & trace.observed[:-1]
    steps = np.where(known[:, None], (np.diff(trace.measured, axis=0) * trace.fs) ** 2, 0.0)
    total = np.vstack([steps, np.zeros(3)]) + np.vstack([np.zeros(3), steps])
    return np.asarray(total / np.maximum(np.convolve(known, [1.0, 1.0]), 1.0)[:, None])


def age_of(nominal: Sequence[Trace]) -> float:
    """Variance (s2) of the age of one unit's samples against the other's, the largest of differences `nominal`.

    Zero where the noise does not follow the change of the reading.
    """
    return max((_age(trace) for trace in nominal if trace.observed.sum() >= _FEWEST), default=0.0)


def _age(trace: Trace) -> float:
    slopes = slopes_squared(trace)[trace.observed].T.ravel()
    steady = _fitted(trace, np.zeros(len(slopes)), ())
    if not slopes.any() or steady is None:
        return 0.0
    unit = float(_squares(trace).mean() / slopes.mean())
    aged = _fitted(trace, np.zeros(len(slopes)), (unit * slopes,))
    if aged is None or chdtrc(1, max(steady.deviance - aged.deviance, 0.0)) > _CHANCE:
        return 0.0
    return unit * float(aged.amplitudes[3])


def _squares(trace: Trace) -> Array:
    """Squares (n, 3) of what the observed samples are off the median."""
    residual = trace.residual[trace.observed]
    return np.asarray((residual - np.median(residual, axis=0)) ** 2)


def with_sway_noise(trace: Trace, nominal: Sequence[Trace]) -> Trace:
    """The difference of two instances, with the noise that it has for moving faster than the `nominal` ones.

    Of what these leave at most all is movement between the moments of their samples: as much is expected as there is,
    up to that. How fast a vehicle moves is what both instances show alike: noise of either is not in it. A calmer
    recording is not expected to be quieter.
    """
    before, now = [_common(n) for n in nominal], _common(trace)
    if trace.against is None or not before:
        return trace
    nominal_movement = np.maximum(np.mean(before, axis=0), np.maximum(1e-12 * now, np.finfo(float).tiny))
    left = np.mean([_squares(n).mean(axis=0) for n in nominal], axis=0)
    known = trace.observed[1:] & trace.observed[:-1]
    there = 0.5 * (np.diff(trace.residual, axis=0)[known] ** 2).mean(axis=0)
    return with_more(trace, np.clip(there - left, 0.0, left * np.maximum(now / nominal_movement - 1.0, 0.0)))


def _common(trace: Trace) -> Array:
    """How much of the fast movement both instances of a difference show, (3,).

    Second differences: manoeuvres are far larger than what changes from one sample to the next, and hide it in the
    first ones.
    """
    known = trace.observed[2:] & trace.observed[1:-1] & trace.observed[:-2]
    if not known.any():
        return np.zeros(3)
    one, other = (np.diff(reading, 2, axis=0)[known] * trace.fs**2 for reading in (trace.measured, trace.ideal))
    return np.asarray(np.maximum((one * other).mean(axis=0), 0.0))


def _fitted(trace: Trace, base: Array, more: Sequence[Array]) -> AmplitudeFit | None:
    """Steady noise of each axis, in units of its mean square, beside `base` and variances `more`, all (3 n,)."""
    squares = _squares(trace)
    if not squares.any(axis=0).all():
        return None
    steady = np.kron(np.diag(squares.mean(axis=0)), np.ones(len(squares)))
    return fit_amplitudes(squares.T.ravel(), np.ones(squares.size), base, [*steady, *more])


def without_aged_samples(trace: Trace, age: float) -> Trace:
    """`trace` without the samples in which an `age` of that variance (s2) is more than the noise beside it."""
    expected = age * slopes_squared(trace)
    rest = _fitted(trace, expected[trace.observed].T.ravel(), ())
    if rest is None:
        return trace
    noise = rest.amplitudes * _squares(trace).mean(axis=0)
    return dataclasses.replace(trace, observed=trace.observed & ~(expected > noise).any(axis=1))


def with_age_noise(trace: Trace, age: float, nominal: Sequence[Trace]) -> Trace:
    """`trace` with the noise that its faster movement adds to what the `nominal` ones show, all of them settled."""
    nominal_slopes = np.mean([slopes_squared(n)[n.observed].mean(axis=0) for n in nominal], axis=0)
    more = age * np.maximum(slopes_squared(trace)[trace.observed].mean(axis=0) - nominal_slopes, 0.0)
    return with_more(trace, more)
