"""Messages that fly each firmware: ArduPilot in GUIDED and AUTO, PX4 in offboard and AUTO.MISSION.

ArduPilot takes the thrust of SET_ATTITUDE_TARGET as a climb rate about 0.5, PX4 as thrust. PX4 enters offboard only
while targets arrive, and has no take-off there: it is flown up. Item 0 of a mission is home to ArduPilot, and the first
one to PX4. ArduPilot refuses a number that is none; to PX4 it says that the heading of an item is free.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.logs.missions.items import LoggedMission, MissionItem

VELOCITY_AND_YAW = 0b1001_1100_0111
"""type_mask: position, acceleration and yaw rate are to be ignored."""
ATTITUDE_ONLY = 0b0000_0111
"""type_mask: body rates are to be ignored."""
_PX4_MAIN_AUTO, _PX4_MAIN_OFFBOARD, _PX4_SUB_MISSION = 4, 6, 4
_BY_FORCE = 21196.0
"""Param 2 of MAV_CMD_COMPONENT_ARM_DISARM that skips the firmware's checks. Source: MAVLink's common.xml."""
_CUSTOM = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
Target = tuple[int, int]


def velocity_target(ms: int, to: Target, north: float, east: float, down: float, *, yaw: float) -> Any:
    """SET_POSITION_TARGET_LOCAL_NED of a velocity, m/s, and a heading, rad."""
    zeros = (0.0, 0.0, 0.0)
    return dialect.MAVLink_set_position_target_local_ned_message(
        ms, *to, dialect.MAV_FRAME_LOCAL_NED, VELOCITY_AND_YAW, *zeros, north, east, down, *zeros, yaw, 0.0
    )


def attitude_target(ms: int, to: Target, euler: tuple[float, float, float], thrust: float) -> Any:
    """SET_ATTITUDE_TARGET of roll, pitch, yaw, rad."""
    cr, cp, cy = (math.cos(0.5 * angle) for angle in euler)
    sr, sp, sy = (math.sin(0.5 * angle) for angle in euler)
    q = [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
    return dialect.MAVLink_set_attitude_target_message(ms, *to, ATTITUDE_ONLY, q, 0.0, 0.0, 0.0, thrust)


def command(to: Target, number: int, *parameters: float) -> Any:
    """COMMAND_LONG."""
    padded = (*parameters, *(0.0,) * (7 - len(parameters)))
    return dialect.MAVLink_command_long_message(*to, number, 0, *padded)


class Autopilot(ABC):
    """How one firmware is flown; every method gives the message to send."""

    name: str
    """Name as in `LoggedMission.autopilot`."""
    called: str
    """Name for people."""
    guided: int
    """Custom mode of its heartbeat while a program flies it."""
    auto: int
    """Custom mode while it flies a mission."""
    first: int
    """Number of a mission's first item behind home."""
    speed: tuple[str, float]
    """Parameter of the mission speed, and its unit in m/s."""
    climbs_by_itself: bool
    """Whether it takes off by a command; otherwise by a velocity target."""
    hover_thrust: float
    """Thrust of an attitude target that holds the height."""
    thrust_parameter: str
    """Parameter with the hover thrust; empty: it is constant."""
    quiet: Mapping[str, float]
    """Parameters that end the log of a vehicle that is disarmed."""

    @abstractmethod
    def guide(self, to: Target) -> Any:
        """Change to the mode that obeys a program."""

    def arm(self, to: Target) -> Any:
        """Arm."""
        return command(to, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    def disarm(self, to: Target) -> Any:
        """Disarm at once, also where the firmware believes itself in the air: for a simulator that stands."""
        return command(to, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, _BY_FORCE)

    def take_off(self, to: Target, height: float) -> Any:
        """Take off to `height`, m; only where it :attr:`climbs_by_itself`."""
        return command(to, dialect.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height)

    @abstractmethod
    def follow_mission(self, to: Target) -> Any:
        """Change to the mode that flies a mission."""

    @abstractmethod
    def ready(self, to: Target) -> Any:
        """Change to the mode in which it is armed for a mission."""

    @abstractmethod
    def items(self, mission: LoggedMission) -> tuple[MissionItem, ...]:
        """The mission items to upload, from item 0 on."""

    def start_mission(self, to: Target) -> Any:
        """Begin the mission with its first item."""
        return command(to, dialect.MAV_CMD_MISSION_START)

    def land(self, to: Target) -> Any:
        """Land where it is."""
        return command(to, dialect.MAV_CMD_NAV_LAND)


class ArduPilot(Autopilot):
    """ArduCopter."""

    name, called = "ardupilot", "ArduPilot"
    guided, auto, first = 4, 3, 1
    speed = ("WPNAV_SPEED", 0.01)
    climbs_by_itself = True
    hover_thrust, thrust_parameter = 0.5, ""
    quiet: Mapping[str, float] = {"LOG_DISARMED": 0.0}

    def guide(self, to: Target) -> Any:
        """GUIDED."""
        return command(to, dialect.MAV_CMD_DO_SET_MODE, _CUSTOM, self.guided)

    def follow_mission(self, to: Target) -> Any:
        """AUTO."""
        return command(to, dialect.MAV_CMD_DO_SET_MODE, _CUSTOM, self.auto)

    def ready(self, to: Target) -> Any:
        """GUIDED, since it does not arm in AUTO."""
        return self.guide(to)

    def items(self, mission: LoggedMission) -> tuple[MissionItem, ...]:
        """Home and the items, with a number everywhere."""
        return (mission.home, *map(_with_numbers, mission.items))


class Px4(Autopilot):
    """PX4's multicopters."""

    name, called = "px4", "PX4"
    guided, first = _PX4_MAIN_OFFBOARD << 16, 0
    auto = _PX4_MAIN_AUTO << 16 | _PX4_SUB_MISSION << 24
    speed = ("MPC_XY_CRUISE", 1.0)
    climbs_by_itself = False
    hover_thrust, thrust_parameter = 0.5, "MPC_THR_HOVER"
    quiet: Mapping[str, float] = {}  # it logs from arming to disarming

    def guide(self, to: Target) -> Any:
        """Offboard."""
        return command(to, dialect.MAV_CMD_DO_SET_MODE, _CUSTOM, _PX4_MAIN_OFFBOARD)

    def follow_mission(self, to: Target) -> Any:
        """AUTO.MISSION."""
        return command(to, dialect.MAV_CMD_DO_SET_MODE, _CUSTOM, _PX4_MAIN_AUTO, _PX4_SUB_MISSION)

    def ready(self, to: Target) -> Any:
        """AUTO.MISSION, in which it begins once armed."""
        return self.follow_mission(to)

    def items(self, mission: LoggedMission) -> tuple[MissionItem, ...]:
        """The mission items without home, which is where it was armed."""
        return mission.items


def _with_numbers(item: MissionItem) -> MissionItem:
    first, second, third, heading = item.parameters
    return dataclasses.replace(item, parameters=(first, second, third, 0.0 if math.isnan(heading) else heading))


CLIMB = 1.5
"""Climb of a vehicle without a take-off of its own, m/s."""


def autopilot_of(heartbeat: Any) -> Autopilot:
    """The autopilot of a heartbeat: PX4, or ArduPilot for any other number."""
    return Px4() if heartbeat.autopilot == dialect.MAV_AUTOPILOT_PX4 else ArduPilot()
