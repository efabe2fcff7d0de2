"""Where a mission flies from a home, and how long each item takes.

Distances are those of a flat Earth at the mean latitude of two places, as in ArduPilot (``Location.cpp``).
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Final

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.logs.missions.items import (
    ABSOLUTE,
    INSTEAD,
    PLACED,
    REGARDED,
    Frame,
    LoggedMission,
    MissionItem,
    NavCommand,
    OtherCommand,
)

METRES_PER_DEGREE: Final = 111_318.845
_LEAST_COS: Final = 0.01
"""Least cosine of the latitude; nearer the poles the length of a degree of longitude is held."""
_CLIMB, _SINK, _TOUCH = 1.5, 1.0, 0.4
"""Speeds, m/s, of climbs, of descents, and of the last metres; below ArduPilot's defaults."""
_LAST_M: Final = 10.0
"""LAND_ALT_LOW."""
_RETURN_M: Final = 15.0
_RETURN_WAIT_S: Final = 5.0
"""RTL_ALT, RTL_LOIT_TIME."""
_TURN_S: Final = 20.0
"""Time of one circle at CIRCLE_RATE 20 deg/s, about."""
_EDGE_S: Final = 3.0
"""Time to start and stop, for each item, s."""
LEAST_TAKE_OFF_M: Final = 3.0
"""Least height of a take-off, m. Chosen, not measured: lower, a multicopter is in its own downwash."""


@dataclass(frozen=True)
class Place:
    """Latitude and longitude in deg, altitude above the sea in m."""

    latitude: float
    longitude: float
    altitude: float

    def offset(self, latitude: float, longitude: float) -> tuple[float, float]:
        """Distance of a place to the north and to the east of here, m."""
        north = (latitude - self.latitude) * METRES_PER_DEGREE
        east = _wrapped(longitude - self.longitude) * METRES_PER_DEGREE * self._shrunk(latitude)
        return north, east

    def at(self, north: float, east: float) -> tuple[float, float]:
        """Latitude and longitude so many m north and east of here; the inverse of `offset`."""
        latitude = self.latitude + north / METRES_PER_DEGREE
        return latitude, _wrapped(self.longitude + east / (METRES_PER_DEGREE * self._shrunk(latitude)))

    def _shrunk(self, latitude: float) -> float:
        return max(math.cos(math.radians(0.5 * (latitude + self.latitude))), _LEAST_COS)


def _wrapped(degrees: float) -> float:
    return (degrees + 180.0) % 360.0 - 180.0


def home_of(mission: LoggedMission) -> Place:
    """Origin of the mission's heights and places."""
    return Place(mission.home.latitude, mission.home.longitude, mission.home.altitude)


def moved(mission: LoggedMission, home: Place) -> LoggedMission:
    """The same mission around another home: every item keeps its metres north, east and up from home.

    Raises
    ------
    InvalidInputError
        If an item would lie beyond a pole.
    """
    before = home_of(mission)
    items = tuple(_moved(item, before, home) for item in mission.items)
    at_home = dataclasses.replace(
        mission.home, latitude=home.latitude, longitude=home.longitude, altitude=home.altitude, frame=Frame.GLOBAL
    )
    return dataclasses.replace(mission, home=at_home, items=items)


def _moved(item: MissionItem, before: Place, home: Place) -> MissionItem:
    altitude = item.altitude
    if item.frame in ABSOLUTE and item.command in (*PLACED, *REGARDED):
        altitude += home.altitude - before.altitude
    if not item.placed:
        return dataclasses.replace(item, altitude=altitude)
    latitude, longitude = home.at(*before.offset(item.latitude, item.longitude))
    return dataclasses.replace(item, latitude=latitude, longitude=longitude, altitude=altitude)


def with_take_off(mission: LoggedMission) -> LoggedMission:
    """The mission with a take-off to the height of its first place, if it begins in the air.

    Raises
    ------
    InvalidInputError
        If its first item that moves the vehicle has no height to take off to.
    """
    first = next(item for item in mission.items if item.flies)
    if first.command == NavCommand.TAKEOFF:
        return mission
    if first.command not in (NavCommand.WAYPOINT, NavCommand.SPLINE_WAYPOINT, *_LOITERS):
        raise InvalidInputError(f"{first.name} is the first that moves the vehicle, and no take-off. {INSTEAD}")
    height = max(height_of(first, home_of(mission)), LEAST_TAKE_OFF_M)
    home, free = mission.home, (0.0, 0.0, 0.0, math.nan)
    added = MissionItem(-1, NavCommand.TAKEOFF, Frame.RELATIVE, free, home.latitude, home.longitude, height)
    return dataclasses.replace(mission, items=(added, *mission.items))


_LOITERS: Final = (NavCommand.LOITER_TIME, NavCommand.LOITER_TURNS)


def height_of(item: MissionItem, home: Place) -> float:
    """Height above home, m."""
    return item.altitude - (home.altitude if item.frame in ABSOLUTE else 0.0)


def durations(mission: LoggedMission, speed: float) -> tuple[float, ...]:
    """Approximate duration of each item, s, at a horizontal `speed` in m/s until the mission changes it.

    Conditions that wait during the flight (CONDITION_DELAY, CONDITION_YAW) count as if the vehicle stopped for them.
    """
    course = _Course(home_of(mission), speed)
    return tuple(course.fly(item) for item in mission.items)


class _Course:
    """Position of a vehicle after each item."""

    def __init__(self, home: Place, speed: float) -> None:
        self._home, self._speed = home, speed
        self._north = self._east = self._height = 0.0

    def fly(self, item: MissionItem) -> float:
        """Duration of one item, s; moves the vehicle to its end."""
        first, second, third, _ = item.parameters
        if not item.flies:
            if item.command == OtherCommand.DO_CHANGE_SPEED and first in (0.0, 1.0) and second > 0.0:
                self._speed = second
            waiting: dict[int, float] = {OtherCommand.CONDITION_DELAY: first, OtherCommand.CONDITION_YAW: _TURN_S}
            return waiting.get(item.command, 0.0)
        if item.command == NavCommand.DELAY:
            return first + _EDGE_S
        if item.command == NavCommand.RETURN_TO_LAUNCH:
            up = self._go(self._north, self._east, max(self._height, _RETURN_M))
            return up + self._go(0.0, 0.0, self._height) + _RETURN_WAIT_S + self._sink()
        north, east = self._home.offset(item.latitude, item.longitude) if item.placed else (self._north, self._east)
        if item.command == NavCommand.LAND:
            return self._go(north, east, self._height) + self._sink()
        if item.command == NavCommand.TAKEOFF:
            north, east = self._north, self._east
        waits = max(first, 0.0)
        if item.command == NavCommand.LOITER_TURNS:
            waits = abs(first) * max(_TURN_S, 2.0 * math.pi * abs(third) / self._speed)
        return self._go(north, east, height_of(item, self._home)) + waits

    def _go(self, north: float, east: float, height: float) -> float:
        across = math.hypot(north - self._north, east - self._east) / self._speed
        up = height - self._height
        self._north, self._east, self._height = north, east, height
        return max(across, up / _CLIMB if up > 0.0 else -up / _SINK) + _EDGE_S

    def _sink(self) -> float:
        height, self._height = max(self._height, 0.0), 0.0
        last = min(height, _LAST_M)
        return last / _TOUCH + (height - last) / _SINK + _EDGE_S
