"""What every magnetometer fit asks of its samples before it begins."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import InvalidInputError, UndeterminedError

Array = NDArray[np.float64]

PLANAR = 0.02
"""Thickness of a cloud, relative to its width, below which it counts as a plane: +-2.5 degrees of tilt give this."""

LEAST_VARIANCE = 1e-32
"""Of residuals relative to the radius, squared: exact data have a rounding error at least."""

NEARLY_PLANAR = 0.1
"""Thickness below which a fit that fails is put down to the movement being flat."""

_COUNTED = 1000  # samples up to which repeats are counted; more than that are never so few

AXIS_WORDS = ("nose-tail", "left-right", "top-bottom")


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
    if array.ndim != 2 or array.shape[1] != 3:
        raise InvalidInputError(f"magnetometer samples must have shape (N, 3), not {array.shape}")
    # One pass and no mask in memory: the sum is finite only if every number is (an overflow is refused as well).
    if not np.isfinite(array.sum() if len(array) else 0.0):
        bad = int(np.count_nonzero(~np.isfinite(array).all(axis=1)))
        raise InvalidInputError(f"{bad} of {len(array)} magnetometer samples are not finite: drop those rows first")
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
    if not may_repeat and len(array) <= _COUNTED:
        distinct = len(np.unique(array, axis=0))
        if distinct < minimum:
            raise UndeterminedError(
                f"only {distinct} of {len(array)} magnetometer samples differ: at least {minimum} are needed",
                remedy="turn the vehicle in all directions; repeats add nothing",
            )
    return array


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
