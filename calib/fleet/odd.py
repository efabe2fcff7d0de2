"""Sensors that are unlike others of their type in the fleet.

Each axis is compared with the median of the type in robust standard deviations (1.4826 times the median distance from
it). The limit is that which, among normally distributed biases, the oddest axis of a whole group passes in 1 of 100
groups: a healthy group of any size names a sensor only that rarely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError

Array = NDArray[np.float64]

FALSE_ALARMS: Final = 0.01
"""Groups of healthy sensors in which one is called odd."""
LEAST = 6
"""Sensors below which a group says nothing of its own spread."""
FARTHEST: Final = 1e9
"""Distance of a sensor that differs from others which are all alike."""
_MAD = 1.4826

_SIZES: Final = (*range(LEAST, 22), 25, 31, 41, 51, 75, 101, 151, 201, 501, 1001)
_LIMITS: Final = (
    *(14.46, 15.67, 10.76, 11.36, 8.93, 9.03, 7.95, 8.01, 7.28, 7.28, 6.73, 6.77, 6.40, 6.48, 6.23, 6.20),
    *(5.77, 5.47, 5.17, 5.00, 4.77, 4.63, 4.62, 4.57, 4.66, 4.72),
)
"""By size of the group, as ``bench.fleet`` draws them; a test draws some of them again."""


@dataclass(frozen=True)
class Oddness:
    """How far a sensor is from the middle of its type, in robust standard deviations of its worst axis."""

    distance: float
    limit: float
    axis: int
    group: int
    """Sensors in the group."""

    @property
    def odd(self) -> bool:
        """Whether it is farther than the limit."""
        return self.distance > self.limit


def distances(values: Array, floor: float = 0.0) -> Array:
    """Robust distance from the median, shape of `values` (..., n, 3); `floor`: least spread that is believed."""
    away = np.abs(values - np.median(values, axis=-2, keepdims=True))
    spread = np.maximum(_MAD * np.median(away, axis=-2, keepdims=True), floor)
    return np.asarray(np.divide(away, spread, out=np.where(away > 0.0, FARTHEST, 0.0), where=spread > 0.0))


def limit_of(n: int) -> float:
    """The limit for a group of `n`, at least six: that of the next smaller size of the table, which is no stricter.

    A group larger than the table has the limit of so many normally distributed numbers of known spread, if that is
    larger.
    """
    known = _LIMITS[int(np.searchsorted(_SIZES, n, side="right")) - 1]
    return max(known, float(-scipy.special.ndtri(FALSE_ALARMS / (6.0 * n)))) if n > _SIZES[-1] else known


def oddness(biases: Sequence[Sequence[float]], sd: Sequence[float]) -> tuple[Oddness | None, ...]:
    """How odd each sensor of one type is; None: there are fewer than six of them.

    `biases` are (n, 3); `sd` are standard deviations of a measurement: differences below their median are none.

    Raises
    ------
    InvalidInputError
        If a number is not finite.
    """
    n = len(biases)
    if n < LEAST:
        return (None,) * n
    values = np.array(biases, dtype=np.float64)
    if not (np.isfinite(values).all() and np.isfinite(sd).all()):
        raise InvalidInputError("biases and standard deviations that are compared must be finite")
    found = distances(values, float(np.median(sd)))
    limit = limit_of(n)
    worst = found.argmax(axis=1)
    return tuple(Oddness(float(row[axis]), limit, int(axis), n) for row, axis in zip(found, worst, strict=True))
