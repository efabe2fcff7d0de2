"""The sensors of a recording, thinned for a picture; extremes are kept."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.recording import Array, Channel, Recording, Sensor

POINTS: Final = 600
"""Most points of a series: two for each pixel column of a narrow picture."""
SHOWN: Final[Mapping[Sensor, int]] = {
    Sensor.ACCEL: 3, Sensor.GYRO: 3, Sensor.MAG: 3, Sensor.TEMPERATURE: 1, Sensor.CURRENT: 1, Sensor.THROTTLE: 1,
    Sensor.VIBRATION: 3,
}  # fmt: skip
"""Sensors that are drawn, and their axes."""


@dataclass(frozen=True, eq=False)
class Series:
    """One sensor over a recording."""

    sensor: Sensor
    instance: int
    unit: str
    source: str
    t: Array
    """Seconds since the recording began, (N,)."""
    values: Array
    """Values (k, N), one row for each axis."""


def series_of(recording: Recording, points: int = POINTS) -> tuple[Series, ...]:
    """One series for each sensor and instance, from its densest channel, of at most `points` samples."""
    best: dict[tuple[Sensor, int], Channel] = {}
    for channel in recording.channels:
        key = channel.sensor, channel.instance
        if channel.sensor in SHOWN and len(channel) and (key not in best or len(channel) > len(best[key])):
            best[key] = channel
    begin = min((float(channel.t[0]) for channel in best.values()), default=0.0)
    return tuple(
        _series(best[key], begin, points) for key in sorted(best, key=lambda k: (list(SHOWN).index(k[0]), k[1]))
    )


def _series(channel: Channel, begin: float, points: int) -> Series:
    t, values = channel.t - begin, channel.values[:, : SHOWN[channel.sensor]]
    if len(t) > points:
        rows = _kept(values, points)
        t, values = t[rows], values[rows]
    return Series(channel.sensor, channel.instance, channel.unit, channel.source, t, values.T)


def _kept(values: Array, points: int) -> NDArray[np.intp]:
    """Rows that hold the extremes of every axis in equal pieces of the series."""
    axes = values.shape[1]
    pieces = max(points // (2 * axes), 1)
    edges = np.linspace(0, len(values), pieces + 1).astype(int)
    filled = np.where(np.isfinite(values), values, np.nanmean(values) if np.isfinite(values).any() else 0.0)
    rows = {
        int(low + extreme)
        for low, high in itertools.pairwise(edges)
        if high > low
        for extreme in (*filled[low:high].argmin(axis=0), *filled[low:high].argmax(axis=0))
    }
    return np.array(sorted(rows), dtype=np.intp)
