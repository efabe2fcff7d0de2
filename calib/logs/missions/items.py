"""Mission items by MAVLink's numbers, and those that a simulated multicopter can fly."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import InvalidInputError

INSTEAD: Final = "Fly the standard mission: --mission standard."


class Frame(IntEnum):
    """Datum of an altitude (MAV_FRAME)."""

    GLOBAL = dialect.MAV_FRAME_GLOBAL  # sea level
    MISSION = dialect.MAV_FRAME_MISSION  # no place
    RELATIVE = dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT  # home
    GLOBAL_INT = dialect.MAV_FRAME_GLOBAL_INT
    RELATIVE_INT = dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT


ABSOLUTE: Final = (Frame.GLOBAL, Frame.GLOBAL_INT)


class NavCommand(IntEnum):
    """Commands of a mission that move a multicopter (MAV_CMD_NAV)."""

    WAYPOINT = dialect.MAV_CMD_NAV_WAYPOINT
    LOITER_TURNS = dialect.MAV_CMD_NAV_LOITER_TURNS
    LOITER_TIME = dialect.MAV_CMD_NAV_LOITER_TIME
    RETURN_TO_LAUNCH = dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH
    LAND = dialect.MAV_CMD_NAV_LAND
    TAKEOFF = dialect.MAV_CMD_NAV_TAKEOFF
    SPLINE_WAYPOINT = dialect.MAV_CMD_NAV_SPLINE_WAYPOINT
    DELAY = dialect.MAV_CMD_NAV_DELAY


LANDINGS: Final = (NavCommand.RETURN_TO_LAUNCH, NavCommand.LAND)
PLACED: Final = (
    NavCommand.WAYPOINT, NavCommand.LOITER_TURNS, NavCommand.LOITER_TIME, NavCommand.LAND, NavCommand.TAKEOFF,
    NavCommand.SPLINE_WAYPOINT,
)  # fmt: skip
"""Those that may have a place."""


class OtherCommand(IntEnum):
    """Commands that do not move the vehicle and are passed on unchanged (MAV_CMD)."""

    CONDITION_DELAY = dialect.MAV_CMD_CONDITION_DELAY
    CONDITION_DISTANCE = dialect.MAV_CMD_CONDITION_DISTANCE
    CONDITION_YAW = dialect.MAV_CMD_CONDITION_YAW
    DO_CHANGE_SPEED = dialect.MAV_CMD_DO_CHANGE_SPEED
    DO_LAND_START = dialect.MAV_CMD_DO_LAND_START
    DO_SET_ROI_LOCATION = dialect.MAV_CMD_DO_SET_ROI_LOCATION
    DO_SET_ROI_NONE = dialect.MAV_CMD_DO_SET_ROI_NONE
    DO_SET_ROI = dialect.MAV_CMD_DO_SET_ROI
    DO_DIGICAM_CONTROL = dialect.MAV_CMD_DO_DIGICAM_CONTROL
    DO_MOUNT_CONTROL = dialect.MAV_CMD_DO_MOUNT_CONTROL
    DO_SET_CAM_TRIGG_DIST = dialect.MAV_CMD_DO_SET_CAM_TRIGG_DIST


REGARDED: Final = (OtherCommand.DO_SET_ROI_LOCATION, OtherCommand.DO_SET_ROI)
"""Those of these commands that have a place."""
_REFUSED: Final = (
    *("NAV_LOITER_UNLIM", "NAV_CONTINUE_AND_CHANGE_ALT", "NAV_LOITER_TO_ALT", "NAV_VTOL_TAKEOFF", "NAV_VTOL_LAND"),
    *("NAV_GUIDED_ENABLE", "NAV_PAYLOAD_PLACE", "DO_JUMP", "DO_SET_HOME", "DO_SET_RELAY", "DO_SET_SERVO"),
    *("DO_PARACHUTE", "DO_GRIPPER", "DO_JUMP_TAG"),
)
_NAMES: Final[Mapping[int, str]] = {
    **{int(command): command.name for command in (*NavCommand, *OtherCommand)},
    **{getattr(dialect, f"MAV_CMD_{name}"): name.removeprefix("NAV_") for name in _REFUSED},
}
_HIGHEST_M: Final = 10_000.0
"""Highest plausible altitude, m. Chosen, not measured: no multicopter flies higher."""


@dataclass(frozen=True)
class MissionItem:
    """One item: a command, its parameters and its place.

    Parameters
    ----------
    number
        That of the log; home is 0. An item that was added has -1.
    command, frame
        By MAVLink's numbers (MAV_CMD, MAV_FRAME).
    parameters
        The first four of the command, in its own units. The fourth may be NaN for a command that flies: any heading.
    latitude, longitude, altitude
        deg, deg, m; latitude and longitude 0: the present place of the vehicle.
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
        """Number and command, for display."""
        name = _NAMES.get(self.command, f"command {self.command}")
        return f"item {self.number} ({name})" if self.number >= 0 else f"added {name}"


@dataclass(frozen=True)
class LoggedMission:
    """The items that follow `home`, in their order; home is an item of the absolute frame.

    `autopilot` is "ardupilot" or "px4", which interpret some parameters differently.

    Raises
    ------
    InvalidInputError
        If an item is not one that a simulated multicopter can fly. The message names it.
    """

    home: MissionItem
    items: tuple[MissionItem, ...]
    autopilot: str = "ardupilot"

    def __post_init__(self) -> None:
        _check_place(self.home)
        for item in self.items:
            _check(item)
        if not any(item.flies for item in self.items):
            raise InvalidInputError(f"none of the mission's {len(self.items)} items moves the vehicle. {INSTEAD}")

    @property
    def last(self) -> int:
        """Index of the last item that moves the vehicle."""
        return max(k for k, item in enumerate(self.items) if item.flies)


def _check(item: MissionItem) -> None:
    if not item.flies and item.command not in set(OtherCommand):
        known = ", ".join(command.name for command in NavCommand)
        raise InvalidInputError(
            f"{item.name} of the log's mission cannot be flown in a simulator. These can: {known}. {INSTEAD}"
        )
    if not all(math.isfinite(value) for value in item.parameters[: 3 if item.flies else 4]):
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
