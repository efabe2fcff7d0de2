"""Common part of every picture: size, colours, units, and the number of samples shown."""

from __future__ import annotations

import math
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BEFORE: Final = "#b3261e"
AFTER: Final = "#14713a"
SHADES: Final = ("#1f6fb2", "#c9731f", "#7a4fb5")
"""Colours of the axes x, y and z."""
PALE: Final = ("#a9cae4", "#eecdad", "#cfbfe4")
"""Pale colours of the same axes, for values before the fit."""
RULE: Final = "#6b7a86"
"""Colour of the expected value."""
MOST: Final = 4000
"""Most samples that are drawn."""
WIDTH, HEIGHT = 520, 340
"""Size of one panel."""
ROW_HEIGHT = 220
"""Height of one of several rows."""
TOO_FEW: Final = "too few samples for a spectrum"
NAMES: Final = {"gyro": "Gyro", "accel": "Accelerometer", "mag": "Compass"}
_SEGMENT = 1024
"""Most samples in one segment of Welch's method."""
_LEAST = 16


class PlottedChannel(Protocol):
    """The part of :class:`calib.recording.Channel` that a picture needs."""

    @property
    def sensor(self) -> str: ...  # noqa: D102 - as there
    @property
    def instance(self) -> int: ...  # noqa: D102
    @property
    def t(self) -> Array: ...  # noqa: D102
    @property
    def values(self) -> Array: ...  # noqa: D102
    @property
    def unit(self) -> str: ...  # noqa: D102


def name_of(sensor: str, instance: int) -> str:
    """``Compass 1``; instances count from 1 for people."""
    return f"{NAMES.get(sensor, str(sensor).replace('_', ' ').capitalize())} {instance + 1}"


def shown(unit: str) -> tuple[str, float]:
    """Display unit, and the factor from `unit`."""
    if unit == "rad/s":
        return "deg/s", math.degrees(1.0)
    return {"m/s2": "m/s²", "degC": "°C", "uT": "µT"}.get(unit, unit), 1.0


def thinned(count: int) -> slice:
    """Slice that leaves at most :data:`MOST` of `count` samples, evenly spaced."""
    return slice(None, None, max(1, math.ceil(count / MOST)))


def density(t: Array, values: Array) -> tuple[Array, Array] | None:
    """Frequencies (K,), Hz, and root power density (K, 3) by Welch's method; None: too few samples, or no times.

    Unevenly sampled data are interpolated to their mean rate; near the Nyquist frequency the spectrum is then too
    small.
    """
    keep = np.isfinite(values).all(axis=1)
    t, values = t[keep], values[keep]
    if len(t) < _LEAST or not t[-1] > t[0]:
        return None
    from scipy.signal import welch

    rate = (len(t) - 1) / (t[-1] - t[0])
    even = np.linspace(t[0], t[-1], len(t))
    columns = np.stack([np.interp(even, t, column) for column in values.T])
    hz, power = welch(
        columns, rate, nperseg=min(len(t), max(_SEGMENT // 4, min(_SEGMENT, len(t) // 4))), detrend="linear"
    )
    return hz[1:], np.sqrt(power[:, 1:].T)
