"""Scripted motion without an operator, in vehicle time."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from mavcal.service.simvehicle.vehicle import FlightController

FACE_S = 4.0
OBLIQUE: tuple[tuple[float, float, float], ...] = ((35, 30, 0), (-40, 25, 90), (140, -30, 180), (-130, -35, 270))
Pose = str | tuple[float, float, float]

FACE_NAMES: tuple[Pose, ...] = ("level", "left", "right", "nose_down", "nose_up", "back")
TILT_DEG, TREMOR_DEG = 3.0, 0.2
WARM_UP = (20.0, 60.0, 60.0)  # start and end in °C, time constant in s


def _still(vehicle: FlightController) -> Iterator[float]:
    vehicle.world.motion.still(vehicle.time)
    yield from ()


def _faces(vehicle: FlightController) -> Iterator[float]:
    for pose in itertools.cycle((*FACE_NAMES, *OBLIQUE)):
        vehicle.world.motion.hold(vehicle.time, pose, TILT_DEG, TREMOR_DEG)
        yield FACE_S


def _tumble(vehicle: FlightController) -> Iterator[float]:
    vehicle.world.motion.tumble(vehicle.time)
    yield from ()


def _warm_up(vehicle: FlightController) -> Iterator[float]:
    vehicle.world.motion.still(vehicle.time)
    vehicle.world.thermal.warm_up(vehicle.time, *WARM_UP)
    yield from ()


# Each script acts, and yields the seconds until it acts again.
SCRIPTS = {"still": _still, "faces": _faces, "tumble": _tumble, "warm_up": _warm_up, "demo": _still}
