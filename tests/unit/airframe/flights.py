"""Short flights of the flying simulated vehicle: every manoeuvre that shows an effect, in 34 s of vehicle time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mavcal.calib.logs.dataflash import read_dataflash
from mavcal.calib.recording import Recording
from tests.unit.simvehicle.flights import Flight


def flight(
    path: Path, frame: Mapping[str, Any] | None = None, *, other: bool = False, low: bool = False, **parameters: float
) -> Recording:
    """Doublets, yaw steps, climbs and runs; `other`: in the other order and directions.

    `low`: then a hover near the ground and a landing.
    """
    one = Flight(path, frame, **parameters)
    way = -1.0 if other else 1.0
    one.take_off(10.0, 7.0)
    parts = [lambda: _turns(one, way), lambda: _runs(one, way)]
    for part in reversed(parts) if other else parts:
        part()
    one.follow(0.0, 0.0, 0.0, 1.5)
    if low:
        _near_ground(one)
    one.close()
    return read_dataflash(path)


def _turns(one: Flight, way: float) -> None:
    for _ in range(2):
        for angles in ((15.0, 0.0), (0.0, 15.0)):
            for sign, seconds in ((1.0, 0.3), (-1.0, 0.5), (1.0, 0.3)):
                one.lean(way * sign * angles[0], way * sign * angles[1], seconds)
        one.follow(0.0, 0.0, -2.5, 1.5, yaw=1.2 * way)
        one.follow(0.0, 0.0, 2.5, 1.5, yaw=0.0)


def _runs(one: Flight, way: float) -> None:
    for north, east in ((8.0, 0.0), (0.0, 8.0)):
        one.follow(way * north, way * east, 0.0, 3.5)
        one.follow(-way * north, -way * east, 0.0, 4.0)


def _near_ground(one: Flight) -> None:
    """A hover at height, one at some decimetres, and a landing."""
    one.follow(0.0, 0.0, 0.0, 8.0)
    height = -one.vehicle.airframe.place[2]
    one.follow(0.0, 0.0, 2.0, (height - 1.0) / 2.0)
    for _ in range(50):
        one.follow(0.0, 0.0, 0.5 * (-one.vehicle.airframe.place[2] - 0.2), 0.2)
    one.land()
    one.wait(2.0)
