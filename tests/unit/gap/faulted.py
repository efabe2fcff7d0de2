"""Faults put into healthy flights: of one unit, or of all units of a sensor."""

from __future__ import annotations

import dataclasses
import lzma
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mavcal.calib import logs
from mavcal.calib.recording import Channel, Recording, Sensor

Array = NDArray[np.float64]

SEED = 7


def white(sd: float) -> Callable[[Channel, np.random.Generator], Array]:
    """Noise of a standard deviation."""
    return lambda c, rng: sd * rng.standard_normal(c.values.shape)


def walk(density: float) -> Callable[[Channel, np.random.Generator], Array]:
    """A random walk, per root second."""

    def made(c: Channel, rng: np.random.Generator) -> Array:
        steps = density * np.sqrt(np.maximum(np.diff(c.t, prepend=c.t[0]), 0.0))
        return np.asarray(np.cumsum(steps[:, None] * rng.standard_normal(c.values.shape), axis=0))

    return made


def changed(recording: Recording, sensor: Sensor, fault: Callable[[Channel, np.random.Generator], Array]) -> Recording:
    """The same with something added to every unit of a sensor, to each its own."""
    rng = np.random.default_rng(SEED)
    return recording.with_channels(
        dataclasses.replace(c, values=c.values + fault(c, rng)) if c.sensor is sensor else c for c in recording.channels
    )


def delayed(recording: Recording, sensor: Sensor, by: float) -> Recording:
    """The same with readings of unit 1 of a sensor that come late."""

    def late(c: Channel) -> Array:
        return np.column_stack([np.interp(c.t - by, c.t, axis) for axis in c.values.T])

    return recording.with_channels(
        dataclasses.replace(c, values=late(c)) if (c.sensor, c.instance) == (sensor, 0) else c
        for c in recording.channels
    )


def windy_and_calm(data: Path, folder: Path) -> tuple[Recording, Recording]:
    """A flight in wind, and the calm one that it is compared with."""

    def read(name: str) -> Recording:
        path = folder / f"{name}.bin"
        path.write_bytes(lzma.decompress((data / "airframe_flights" / f"{name}.bin.xz").read_bytes()))
        return logs.read(path)

    return read("d02"), read("d01sim")
