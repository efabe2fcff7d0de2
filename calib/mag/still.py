"""Readings of a compass that was held still, in steps that are coarser than its noise.

Rounding is white noise only where something moves the field across the steps from one reading to the next: the turning
of the vehicle, or the sensor's own noise. Held still, a sensor repeats one rounding error, and the mean of many
readings is as far off as one reading. Let the noise be sigma steps, and let the value lie anywhere within a step. The
error that all readings share then has this variance, in steps squared (Widrow and Kollar 2008, the mean of a rounded
normal variable):

    s(sigma) = sum over k of exp(-4 pi^2 k^2 sigma^2) / (2 pi^2 k^2),

and the error that is new at each reading has ``w(sigma) = sigma^2 + 1/12 - s(sigma)``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_WITHIN = 1.5  # steps from the mean of a stretch: three standard deviations where the noise is half a step
_SIGMAS = np.linspace(0.0, 0.6, 121)  # beyond 0.6 steps, 1e-7 of the variance is shared
_K = np.arange(1, 200)[:, None]
_SHARED = (np.exp(-((2.0 * np.pi * _K * _SIGMAS) ** 2)) / (2.0 * np.pi**2 * _K**2)).sum(axis=0)
_SHARED[0] = 1.0 / 12.0
_NEW = np.maximum.accumulate(np.maximum(_SIGMAS**2 + 1.0 / 12.0 - _SHARED, 0.0))


def still_stretches(samples: Array, step: float) -> NDArray[np.intp]:
    """Where each stretch of `samples` (N, 3) begins, whose readings stay within a few steps of their mean.

    A reading that moved on is a stretch of its own.
    """
    starts, begin = [0], 0
    total = samples[0].copy()
    for k in range(1, len(samples)):
        if (np.abs(samples[k] - total / (k - begin)) > _WITHIN * step).any():
            starts.append(k)
            begin, total = k, samples[k].copy()
        else:
            total += samples[k]
    return np.array(starts)


def counted_as(samples: Array, starts: NDArray[np.intp], step: float) -> Array:
    """How many independent readings each stretch is worth, (M,): one at least, all of its readings at most.

    The rounding of each axis is an error of its own: an axis that lies next to an edge jumps to and fro, and is known
    well, which tells nothing of the others. The variance of the mean is that of the three axes on average.
    """
    lengths = np.diff(starts, append=len(samples))
    means = np.add.reduceat(samples, starts) / lengths[:, None]
    squares = np.add.reduceat((samples - np.repeat(means, lengths, axis=0)) ** 2, starts)
    new = squares / np.maximum(lengths - 1, 1)[:, None] / step**2
    shared = np.interp(new, _NEW, _SHARED)
    whole = np.maximum(new, np.interp(new, _NEW, _SIGMAS) ** 2 + 1.0 / 12.0 - shared) + shared
    per_reading = (shared + (whole - shared) / lengths[:, None]) / whole
    return np.asarray(1.0 / per_reading.mean(axis=1))
