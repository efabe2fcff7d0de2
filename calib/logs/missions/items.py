"""Items of a mission by MAVLink's numbers, and which of them a multicopter of a simulator can fly."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from mavcal.calib.errors import InvalidInputError

INSTEAD: Final = "Fly the standard mission: --mission standard."


class Frame(IntEnum):
    """What an altitude counts from (MAV_FRAME)."""

    GLOBAL = 0  # sea level
    MISSION = 2  # no place
    RELATIVE = 3  # home
    GLOBAL_INT = 5
    RELATIVE_INT = 6


ABSOLUTE: Final = (Frame.GLOBAL, Frame.GLOBAL_INT)


class NavCommand(IntEnum):
    """Commands of a mission that move a multicopter (MAV_CMD_NAV)."""

    WAYPOINT = 16
    LOITER_TURNS = 18
    LOITER_TIME = 19
    RETURN_TO_LAUNCH = 20
    LAND = 21
    TAKEOFF = 22
    SPLINE_WAYPOINT = 82
    DELAY = 93


LANDINGS: Final = (NavCommand.RETURN_TO_LAUNCH, NavCommand.LAND)
PLACED: Final = (
    NavCommand.WAYPOINT, NavCommand.LOITER_TURNS, NavCommand.LOITER_TIME, NavCommand.LAND, NavCommand.TAKEOFF,
    NavCommand.SPLINE_WAYPOINT,
)  # fmt: skip
"""Those that may have a place."""

PASSED_ON: Final[Mapping[int, str]] = {
    112: "CONDITION_DELAY", 114: "CONDITION_DISTANCE", 115: "CONDITION_YAW", 178: "DO_CHANGE_SPEED",
    189: "DO_LAND_START", 195: "DO_SET_ROI_LOCATION", 197: "DO_SET_ROI_NONE", 201: "DO_SET_ROI",
    203: "DO_DIGICAM_CONTROL", 205: "DO_MOUNT_CONTROL", 206: "DO_SET_CAM_TRIGG_DIST",
}  # fmt: skip
"""Commands without a flight of their own that are passed on as they are."""
REGARDED: Final = (195, 201)
"""Those of them that have a place."""
_REFUSED: Final[Mapping[int, str]] = {
    17: "LOITER_UNLIM", 30: "CONTINUE_AND_CHANGE_ALT", 31: "LOITER_TO_ALT", 84: "VTOL_TAKEOFF", 85: "VTOL_LAND",
    92: "GUIDED_ENABLE", 94: "PAYLOAD_PLACE", 177: "DO_JUMP", 179: "DO_SET_HOME", 181: "DO_SET_RELAY",
    183: "DO_SET_SERVO", 208: "DO_PARACHUTE", 211: "DO_GRIPPER", 601: "DO_JUMP_TAG",
}  # fmt: skip
"""Names for what is refused."""
_HIGHEST_M: Final = 10_000.0
"""Altitudes beyond are damage. Chosen, not measured: no multicopter flies there."""


@dataclass(frozen=True)
class MissionItem:
    """One item: a command, what it is given, and where.

    Parameters
    ----------
    number
        That of the log; home is 0. An item that was added has -1.
    command, frame
        By MAVLink's numbers (MAV_CMD, MAV_FRAME).
    parameters
        The first four of the command, in its own units.
    latitude, longitude, altitude
        deg, deg, m; latitude and longitude 0: where the vehicle is then.
    """

    number: int
    command: int
    frame: int
    parameters: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    latitude: float = 0.0
    longitude: float = 0.0
    altitude: float = 0.0

    @property
    def flies(self) -> bool:
        """Whether it moves the vehicle."""
        return self.command in set(NavCommand)

    @property
    def placed(self) -> bool:
        """Whether it has a place of its own."""
        return (self.command in PLACED or self.command in REGARDED) and (self.latitude, self.longitude) != (0.0, 0.0)

    @property
    def name(self) -> str:
        """Number and command, as one says them."""
        said = NavCommand(self.command).name if self.flies else PASSED_ON.get(self.command)
        said = said or _REFUSED.get(self.command) or f"command {self.command}"
        return f"item {self.number} ({said})" if self.number >= 0 else f"added {said}"


@dataclass(frozen=True)
class LoggedMission:
    """The items that follow `home`, in their order; home is an item of the absolute frame.

    Raises
    ------
    InvalidInputError
        If an item is not one that a simulated multicopter can fly. The message names it.
    """

    home: MissionItem
    items: tuple[MissionItem, ...]

    def __post_init__(self) -> None:
        _check_place(self.home)
        for item in self.items:
            _check(item)
        if not any(item.flies for item in self.items):
            raise InvalidInputError(f"none of the mission's {len(self.items)} items moves the vehicle. {INSTEAD}")

    @property
    def last(self) -> int:
        """Index in `items` of the last one that moves the vehicle."""
        return max(k for k, item in enumerate(self.items) if item.flies)


def _check(item: MissionItem) -> None:
    if not item.flies and item.command not in PASSED_ON:
        known = ", ".join(command.name for command in NavCommand)
        raise InvalidInputError(
            f"{item.name} of the log's mission cannot be flown in a simulator. These can: {known}. {INSTEAD}"
        )
    if not all(math.isfinite(value) for value in item.parameters):
        raise InvalidInputError(f"{item.name} has a parameter that is no number. {INSTEAD}")
    if item.command == NavCommand.DELAY and item.parameters[0] < 0.0:
        raise InvalidInputError(f"{item.name} waits for a time of day, which a simulator does not have. {INSTEAD}")
    if (item.flies or item.placed) and item.frame not in set(Frame):
        raise InvalidInputError(
            f"{item.name} has frame {item.frame}; its altitude must count from home or the sea (frames 0, 3, 5, 6). "
            f"{INSTEAD}"
        )
    _check_place(item)


def _check_place(item: MissionItem) -> None:
    inside = abs(item.latitude) < 90.0 and abs(item.longitude) <= 180.0 and abs(item.altitude) <= _HIGHEST_M
    if not inside and (item.placed or item.command == NavCommand.TAKEOFF or item.number == 0):
        raise InvalidInputError(
            f"{item.name} lies at {item.latitude:g} deg, {item.longitude:g} deg, {item.altitude:g} m: no place within "
            f"{_HIGHEST_M:g} m of sea level. {INSTEAD}"
        )
