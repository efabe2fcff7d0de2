"""Flights of the flying vehicle without a link: vehicle time by hand."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mavcal.service.simvehicle.flight.flightlog import FlightLog
from mavcal.service.simvehicle.flight.frame import frame_of
from mavcal.service.simvehicle.flight.modes import LOOP_HZ, Mode
from mavcal.service.simvehicle.flight.parameters import FlightParameters
from mavcal.service.simvehicle.flight.vehicle import FlyingVehicle

TARGET_S = 0.1


class Flight:
    """One vehicle and what a pilot does with it."""

    def __init__(self, log: Path, frame: Mapping[str, Any] | None = None, **parameters: float) -> None:
        self.vehicle = FlyingVehicle(frame_of(frame or {}), FlightParameters(parameters), FlightLog(log), seed=3)

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds * LOOP_HZ)):
            self.vehicle.loop()

    def take_off(self, height: float = 6.0, seconds: float = 6.0) -> None:
        self.wait(6.0)
        assert self.vehicle.set_mode(Mode.GUIDED)
        assert self.vehicle.arm()
        assert self.vehicle.takeoff(height)
        self.wait(seconds)

    def follow(self, north: float, east: float, down: float, seconds: float, yaw: float | None = None) -> None:
        for _ in range(round(seconds / TARGET_S)):
            self.vehicle.follow_velocity((north, east, down), yaw, 0.0)
            self.wait(TARGET_S)

    def lean(self, roll_deg: float, pitch_deg: float, seconds: float) -> None:
        for _ in range(round(seconds / TARGET_S)):
            self.vehicle.follow_attitude((math.radians(roll_deg), math.radians(pitch_deg), 0.0), 0.5)
            self.wait(TARGET_S)

    def land(self, most_s: float = 60.0) -> None:
        assert self.vehicle.set_mode(Mode.LAND)
        for _ in range(round(most_s)):
            self.wait(1.0)
            if not self.vehicle.armed:
                break
        self.wait(1.0)

    def close(self) -> None:
        self.vehicle.close()
