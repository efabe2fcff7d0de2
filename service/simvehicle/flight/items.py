"""The items of a mission as the vehicle holds them, by MAVLink's numbers."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from mavcal.service.simvehicle.flight.estimator import metres_from_degrees

RELATIVE = (3, 6)
"""Frames whose altitude counts from home."""
FRAMES = (0, 2, 3, 5, 6)
WHOLE_DEGREE = 1e7
"""Latitudes and longitudes travel as whole ten-millionths."""


class Command(IntEnum):
    """Commands of AUTO that this vehicle flies (MAV_CMD)."""

    WAYPOINT = 16
    LOITER_TIME = 19
    RETURN_TO_LAUNCH = 20
    LAND = 21
    TAKEOFF = 22
    SPLINE_WAYPOINT = 82
    DELAY = 93
    CONDITION_YAW = 115
    CHANGE_SPEED = 178


AT_ONCE = (Command.CONDITION_YAW, Command.CHANGE_SPEED)
"""Done as soon as they are begun."""
LANDINGS = (Command.RETURN_TO_LAUNCH, Command.LAND)


class MissionState(IntEnum):
    """State of the mission in AUTO (MISSION_STATE)."""

    NO_MISSION = 1
    NOT_STARTED = 2
    ACTIVE = 3
    COMPLETE = 5


@dataclass(frozen=True)
class Item:
    """One item; latitude and longitude 0, deg, mean where the vehicle is. Altitude in m of its frame."""

    command: int
    frame: int
    parameters: tuple[float, float, float, float]
    latitude: float
    longitude: float
    altitude: float

    def place(self, home: tuple[float, float]) -> tuple[float, float] | None:
        """Metres north and east of `home`, deg; None: where the vehicle is."""
        if (self.latitude, self.longitude) == (0.0, 0.0):
            return None
        return metres_from_degrees(*home, self.latitude, self.longitude)

    def height(self, altitude_home: float) -> float:
        """Metres above home."""
        return self.altitude if self.frame in RELATIVE else self.altitude - altitude_home
