"""``python -m bench.common_faults DATA``: a fault that all units of a sensor have, put into healthy flights.

More noise on every compass, or gyroscopes that all wander: the answer is that fault on all units, beside what the
flight has of its own. Exit code 1: something else is named, or called unknown.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.airframes import HEADER, Answer, row, told, unpacked
from mavcal.calib import gap, logs
from mavcal.calib.recording import Channel, Recording, Sensor

Array = NDArray[np.float64]
Fault = Callable[[Channel, np.random.Generator], Array]

SEED = 7
BIASES: Mapping[str, tuple[int, ...]] = {"accel_bias": (1,), "gyro_bias": (1,), "mag_hard_iron": (1,)}
FLIGHTS: Mapping[str, tuple[str, str, Mapping[str, tuple[int, ...]]]] = {
    "d10": ("airframe_flights/d10.bin", "airframe_flights/d01sim.bin", {}),
    "bias": ("sitl_flights/bias.bin", "sitl_flights/null.bin", BIASES),
    "null": ("sitl_flights/null.bin", "sitl_flights/bias.bin", BIASES),
    "d01sim": ("airframe_flights/d01sim.bin", "airframe_flights/d10.bin", {}),
}
"""By name: the flight, the one that it is compared with, and by what they differ."""


def white(sd: float) -> Fault:
    """Noise of a standard deviation."""
    return lambda c, rng: sd * rng.standard_normal(c.values.shape)


def walk(density: float) -> Fault:
    """A random walk, per root second."""

    def made(c: Channel, rng: np.random.Generator) -> Array:
        steps = density * np.sqrt(np.maximum(np.diff(c.t, prepend=c.t[0]), 0.0))
        return np.asarray(np.cumsum(steps[:, None] * rng.standard_normal(c.values.shape), axis=0))

    return made


FAULTS: Mapping[str, tuple[Sensor, Fault, str]] = {
    "nothing": (Sensor.MAG, white(0.0), ""),
    "compass noise 0.3 uT": (Sensor.MAG, white(0.3), "mag_noise"),
    "compass noise 1 uT": (Sensor.MAG, white(1.0), "mag_noise"),
    "compass noise 3 uT": (Sensor.MAG, white(3.0), "mag_noise"),
    "gyroscope walk 0.0002 rad/s/sqrt(s)": (Sensor.GYRO, walk(2e-4), "gyro_random_walk"),
    "gyroscope walk 0.001 rad/s/sqrt(s)": (Sensor.GYRO, walk(1e-3), "gyro_random_walk"),
}
"""By name: on which sensor, what is added, and how it is to be named."""


def changed(recording: Recording, sensor: Sensor, fault: Fault) -> Recording:
    """The same with something added to every unit of a sensor, to each its own."""
    rng = np.random.default_rng(SEED)
    return recording.with_channels(
        dataclasses.replace(c, values=c.values + fault(c, rng)) if c.sensor is sensor else c for c in recording.channels
    )


def answer(flight: str, fault: str, data: Path, folder: Path) -> Answer:
    """One fault in one flight, diagnosed."""
    name, other, own = FLIGHTS[flight]
    sensor, made, called = FAULTS[fault]
    real, sim = (_read(data, path, folder) for path in (name, other))
    units = tuple(sorted({c.instance + 1 for c in real.channels if c.sensor is sensor}))
    began = time.process_time()
    report = gap.run(changed(real, sensor, made), sim, nested=False)
    known = {**own, called: units} if called else own
    return told(flight, (fault,), known, report, time.process_time() - began)


def _read(data: Path, name: str, folder: Path) -> Recording:
    parent, _, file = name.rpartition("/")
    return logs.read(data / name if (data / name).is_file() else unpacked(data / parent, file, folder))


def main(argv: Sequence[str] | None = None) -> int:
    """Each case once, told as soon as it is diagnosed."""
    parser = argparse.ArgumentParser(prog="python -m bench.common_faults", description=__doc__)
    parser.add_argument("data", type=Path, help="folder of the recordings")
    parser.add_argument("--flight", nargs="*", default=tuple(FLIGHTS), choices=tuple(FLIGHTS))
    parser.add_argument("--fault", nargs="*", default=tuple(FAULTS), choices=tuple(FAULTS))
    given = parser.parse_args(argv)
    print(HEADER, flush=True)
    right = True
    with tempfile.TemporaryDirectory(prefix="mavcal-common-") as folder:
        for flight in given.flight:
            for fault in given.fault:
                one = answer(flight, fault, given.data, Path(folder))
                print(row(one), flush=True)
                right = right and one.right
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
