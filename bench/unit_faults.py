"""``python -m bench.unit_faults DATA``: a fault of one of several units, put into healthy flights.

The answer is that fault on that unit, and nothing else. There are three pairs: the halves of a nominal flight, a windy
flight beside a calm one, and a vehicle that only rests. Exit code 1: an answer is another.
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
from mavcal.calib.withheld_check import halves

Array = NDArray[np.float64]
Fault = Callable[[Channel], Array]

SEED = 5
REST_S = 30.0
"""Seconds, from its beginning, of the flight of a vehicle at rest."""
FAULTY = 0
"""The instance that has the fault: unit 1."""


def added(x: float, y: float = 0.0, z: float = 0.0) -> Fault:
    """An offset."""
    return lambda c: c.values + np.array([x, y, z])


def scaled(x: float, y: float, z: float) -> Fault:
    """Scale errors."""
    return lambda c: c.values * (1.0 + np.array([x, y, z]))


def crossed(c: Channel) -> Array:
    """Axes x and z that read 0.02 and 0.01 of another one."""
    return c.values + c.values[:, [2, 0, 1]] * np.array([0.02, 0.0, 0.01])


def noisier(sd: float) -> Fault:
    """White noise of a standard deviation."""
    return lambda c: c.values + sd * np.random.default_rng(SEED).standard_normal(c.values.shape)


def silenced(c: Channel) -> Array:
    """A dead band of 0.02."""
    return np.where(np.abs(c.values) < 0.02, 0.0, c.values)


def delayed(c: Channel) -> Array:
    """Readings that come 20 ms late."""
    return np.column_stack([np.interp(c.t - 0.02, c.t, axis) for axis in c.values.T])


FAULTS: Mapping[str, tuple[Sensor, Fault, str]] = {
    "gyroscope scale x, z 2 %": (Sensor.GYRO, scaled(0.02, 0.0, 0.02), "gyro_scale"),
    "gyroscope axes crossed 0.02, 0.01": (Sensor.GYRO, crossed, "gyro_misalignment"),
    "gyroscope bias x 0.02 rad/s": (Sensor.GYRO, added(0.02), "gyro_bias"),
    "gyroscope noise 0.003 rad/s": (Sensor.GYRO, noisier(0.003), "gyro_noise"),
    "gyroscope dead band 0.02 rad/s": (Sensor.GYRO, silenced, "gyro_dead_band"),
    "gyroscope delay 20 ms": (Sensor.GYRO, delayed, "gyro_delay"),
    "accelerometer bias 0.3, 0, -0.2 m/s2": (Sensor.ACCEL, added(0.3, 0.0, -0.2), "accel_bias"),
    "accelerometer scale z 2 %": (Sensor.ACCEL, scaled(0.0, 0.0, 0.02), "accel_scale"),
    "accelerometer noise 0.05 m/s2": (Sensor.ACCEL, noisier(0.05), "accel_noise"),
    "compass hard iron x 4 uT": (Sensor.MAG, added(4.0), "mag_hard_iron"),
    "compass hard iron 4, -0.3, 0.2 uT": (Sensor.MAG, added(4.0, -0.3, 0.2), "mag_hard_iron"),
    "compass noise 1 uT": (Sensor.MAG, noisier(1.0), "mag_noise"),
}
"""By name: on which sensor, what it reads then, and how it is to be named."""
RESTING: Mapping[str, Sequence[int]] = {"accel_bias": (1,), "gyro_bias": (1,)}
"""Errors of the vehicle at rest. Its compass has an offset too, which nobody can tell from the field there."""
FLIGHTS = ("half", "d02", "rest")


def pair(flight: str, data: Path, folder: Path) -> tuple[Recording, Recording]:
    """A flight, and the one that it is compared with."""
    if flight == "d02":
        windy, calm = (logs.read(unpacked(data / "airframe_flights", f"{n}.bin", folder)) for n in ("d02", "d01sim"))
        return windy, calm
    nominal = logs.read(data / "sitl_flights" / "null.bin")
    if flight == "half":
        first, second = halves(nominal)
        return second, first
    whole = logs.read(data / "sitl_flights" / "bias.bin")
    began = min(float(c.t[0]) for c in whole.channels)
    return whole.with_channels(c.between(began, began + REST_S) for c in whole.channels), nominal


def broken(recording: Recording, sensor: Sensor, fault: Fault) -> Recording:
    """The same with a fault of unit 1 of a sensor."""
    return recording.with_channels(
        dataclasses.replace(c, values=fault(c)) if (c.sensor, c.instance) == (sensor, FAULTY) else c
        for c in recording.channels
    )


def answer(flight: str, fault: str, real: Recording, other: Recording) -> Answer:
    """One fault in one flight, diagnosed. The vehicle at rest has errors of its own."""
    began = time.process_time()
    if flight == "rest":
        return told(flight, ("its own",), RESTING, gap.run(real, other, nested=False), time.process_time() - began)
    sensor, made, called = FAULTS[fault]
    report = gap.run(broken(real, sensor, made), other, nested=False)
    return told(flight, (fault,), {called: (FAULTY + 1,)}, report, time.process_time() - began)


def main(argv: Sequence[str] | None = None) -> int:
    """Print each case as soon as it is diagnosed."""
    parser = argparse.ArgumentParser(prog="python -m bench.unit_faults", description=__doc__)
    parser.add_argument("data", type=Path, help="folder of the recordings")
    parser.add_argument("--flight", nargs="*", default=FLIGHTS, choices=FLIGHTS)
    parser.add_argument("--fault", nargs="*", default=tuple(FAULTS), choices=tuple(FAULTS), metavar="NAME")
    given = parser.parse_args(argv)
    print(HEADER, flush=True)
    right = True
    with tempfile.TemporaryDirectory(prefix="mavcal-unit-") as folder:
        for flight in given.flight:
            real, other = pair(flight, given.data, Path(folder))
            for fault in given.fault if flight != "rest" else ("",):
                one = answer(flight, fault, real, other)
                print(row(one), flush=True)
                right = right and one.right
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
