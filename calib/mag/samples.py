"""Checks of magnetometer samples, and access to large sets without a copy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcal.calib.errors import InvalidInputError, UndeterminedError

Array = NDArray[np.float64]

PLANAR = 0.02
"""Thickness of a cloud, relative to its width, below which it counts as a plane: +-2.5 degrees of tilt give this."""

LEAST_VARIANCE = 1e-32
"""Least variance of residuals, relative to the squared radius: exact data still have a rounding error."""

NEARLY_PLANAR = 0.1
"""Thickness below which a failed fit is attributed to a flat movement."""

_COUNTED = 1000  # samples up to which repeats are counted; more than that are never so few

CHUNK = 8192
"""Samples processed at a time, few enough for the processor's cache."""

_LOOKED_AT = 4096  # samples that give centre and scale: these only serve the conditioning

AXIS_WORDS = ("nose-tail", "left-right", "top-bottom")
_WITHIN = 1.5  # steps from the mean of a stretch: three standard deviations where the noise is half a step
_SIGMAS = np.linspace(0.0, 0.6, 121)  # beyond 0.6 steps, 1e-7 of the variance is shared
_K = np.arange(1, 200)[:, None]
_SHARED = (np.exp(-((2.0 * np.pi * _K * _SIGMAS) ** 2)) / (2.0 * np.pi**2 * _K**2)).sum(axis=0)
_SHARED[0] = 1.0 / 12.0
_NEW = np.maximum.accumulate(np.maximum(_SIGMAS**2 + 1.0 / 12.0 - _SHARED, 0.0))


@dataclass(frozen=True, eq=False)
class Cloud:
    """Samples (N, 3) of any real type, looked at as ``(samples - centre)/scale``: never copied as a whole.

    `centre` and `scale` only serve the conditioning: the middle and the width of the cloud, roughly.
    """

    samples: NDArray[Any]
    centre: Array
    scale: float
    precision: Array | None = None
    """Inverse noise of every sample (N,), relative to a sample with only the sensor's noise; None: all are equal."""

    @classmethod
    def of(cls, samples: NDArray[Any], precision: Array | None = None) -> Cloud:
        """The cloud of checked `samples`."""
        seen = samples[:: max(1, len(samples) // _LOOKED_AT)].astype(np.float64)
        centre = seen.mean(axis=0)
        scale = float(np.sqrt(np.mean(np.sum((seen - centre) ** 2, axis=1))))
        if not scale > 0.0:  # the few that were looked at are one and the same
            scale = max(float(np.linalg.norm(np.abs(samples - centre).max(axis=0))), 1e-300)
        return cls(samples, centre, scale, precision)

    def __len__(self) -> int:
        return len(self.samples)

    def rows(self, start: int) -> Array:
        """The chunk that begins at `start`, (3, n), n <= :data:`CHUNK`, in units of `scale`."""
        block: Array = np.subtract(self.samples[start : start + CHUNK].T, self.centre[:, None], order="C")
        block *= 1.0 / self.scale
        return block

    def take(self, rows: NDArray[Any] | slice) -> Cloud:
        """The samples `rows` (indices, a mask or a slice), with the same centre and scale."""
        precision = None if self.precision is None else self.precision[rows]
        return Cloud(self.samples[rows], self.centre, self.scale, precision)

    def scaled(self) -> Array:
        """All samples in units of `scale`, (N, 3): for few only."""
        return np.asarray((self.samples - self.centre) * (1.0 / self.scale))


def not_repeated(samples: NDArray[Any]) -> NDArray[np.bool_]:
    """Mask of the `samples` (N, 3) that differ from the one before.

    An exact repeat has no new information: it was sent twice, or the sensor was still and its steps are coarser than
    its noise. Counted as independent samples, repeats would make the error of one step look like a mean of many.
    """
    fresh = np.ones(len(samples), dtype=np.bool_)
    fresh[1:] = (samples[1:] != samples[:-1]).any(axis=1)
    return fresh


def still_stretches(samples: Array, step: float) -> NDArray[np.intp]:
    """First row of each stretch of `samples` (N, 3) whose readings stay within a few steps of their mean.

    A reading that moved begins a new stretch.
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
    """Number of independent readings in each stretch, (M,): from one to all of its readings.

    Rounding is white noise only where something moves the field across the steps. Held still, a sensor repeats one
    rounding error. Let the noise be sigma steps, and the value anywhere within a step. The error common to all readings
    then has the variance ``s(sigma) = sum over k of exp(-4 pi^2 k^2 sigma^2) / (2 pi^2 k^2)``, in steps squared. The
    independent error of each reading has ``sigma^2 + 1/12 - s(sigma)`` (Widrow and Kollar 2008, the mean of a rounded
    normal variable). The rounding of each axis is independent: an axis next to an edge alternates and is known well,
    without information on the others. The variance of the mean is that of the three axes on average.
    """
    lengths = np.diff(starts, append=len(samples))
    means = np.add.reduceat(samples, starts) / lengths[:, None]
    squares = np.add.reduceat((samples - np.repeat(means, lengths, axis=0)) ** 2, starts)
    new = squares / np.maximum(lengths - 1, 1)[:, None] / step**2
    shared = np.interp(new, _NEW, _SHARED)
    whole = np.maximum(new, np.interp(new, _NEW, _SIGMAS) ** 2 + 1.0 / 12.0 - shared) + shared
    per_reading = (shared + (whole - shared) / lengths[:, None]) / whole
    return np.asarray(1.0 / per_reading.mean(axis=1))


def check_samples(samples: ArrayLike, minimum: int, *, may_repeat: bool = False) -> Array:
    """`samples` as a finite (N, 3) array with N >= `minimum`, not one and the same point unless it `may_repeat`.

    Raises
    ------
    InvalidInputError
        Wrong shape, or a number that is not finite.
    UndeterminedError
        Too few samples, or a sensor that never moved.
    """
    array = np.ascontiguousarray(samples, dtype=np.float64)
    check_real_samples(array, minimum, may_repeat=may_repeat)
    return array


def real_array(samples: ArrayLike) -> NDArray[Any]:
    """`samples` as an array of numbers: integers and floats of 32 bits and more as they are, all else as float64.

    Raises
    ------
    InvalidInputError
        If they are not numbers.
    """
    array = np.asarray(samples)
    if array.dtype.kind in "iu" or (array.dtype.kind == "f" and array.dtype.itemsize >= 4):
        return array
    try:
        return array.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"magnetometer samples must be numbers: {error}") from error


def check_real_samples(array: NDArray[Any], minimum: int, *, may_repeat: bool = False) -> None:
    """As :func:`check_samples`, of an array of any real type, which is not copied."""
    if array.ndim != 2 or array.shape[1] != 3:
        raise InvalidInputError(f"magnetometer samples must have shape (N, 3), not {array.shape}")
    if array.dtype.kind == "f":
        _check_finite(array)
    if len(array) < minimum:
        raise UndeterminedError(
            f"{len(array)} magnetometer samples are too few: at least {minimum} in different directions are needed",
            remedy="record longer while turning the vehicle in all directions",
        )
    if not may_repeat and np.array_equal(array[0], array[-1]) and not np.ptp(array, axis=0).any():
        raise UndeterminedError(
            f"all {len(array)} magnetometer samples are the same: the sensor is stuck, or was not turned",
            remedy="turn the vehicle in all directions; if the numbers stay, the sensor is broken",
        )
    if not may_repeat and len(array) <= _COUNTED and len(np.unique(array[:, 0])) < minimum:
        distinct = len(np.unique(array, axis=0))
        if distinct < minimum:
            raise UndeterminedError(
                f"only {distinct} of {len(array)} magnetometer samples differ: at least {minimum} are needed",
                remedy="turn the vehicle in all directions; repeats add nothing",
            )


def _check_finite(array: NDArray[Any]) -> None:
    # One pass and no mask in memory: the sum is finite only if every number is (an overflow is refused as well).
    with np.errstate(over="ignore"):
        total = array.sum(dtype=np.float64)
    if np.isfinite(total):
        return
    bad = int(np.count_nonzero(~np.isfinite(array).all(axis=1)))
    if bad:
        raise InvalidInputError(f"{bad} of {len(array)} magnetometer samples are not finite: drop those rows first")
    raise InvalidInputError(f"magnetometer samples up to {np.abs(array).max():.3g} are no field: check the unit")


def check_not_flat(centred_scatter: Array, limit: float = PLANAR) -> None:
    """Refuse a cloud that is a line or a plane, given the (3, 3) scatter matrix about its mean.

    `limit` is the thickness relative to the width up to which it counts as one.

    Raises
    ------
    UndeterminedError
        Naming the movement that is missing.
    """
    values, vectors = np.linalg.eigh(centred_scatter)
    width = np.sqrt(np.clip(values, 0.0, None))
    if width[1] < limit * width[2]:
        raise UndeterminedError(
            "the magnetometer samples lie on a line: the vehicle was hardly turned, or one axis alone is alive",
            remedy="turn the vehicle through full circles about two different axes",
        )
    if width[0] < limit * width[2]:
        normal = vectors[:, 0]
        raise UndeterminedError(
            f"the magnetometer samples lie in one plane with normal ({normal[0]:.2f}, {normal[1]:.2f}, "
            f"{normal[2]:.2f}): the vehicle was turned about one axis only",
            remedy=f"tilt the vehicle so that its {axis_word(normal)} axis points up and down as well, and turn it",
        )


def axis_word(direction: Array) -> str:
    """The name of the vehicle's axis that is nearest to `direction` (3,)."""
    return AXIS_WORDS[int(np.argmax(np.abs(direction)))]
