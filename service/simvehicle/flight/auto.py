"""AUTO: the items of a mission in their order, as velocities to follow.

A place is reached within the radius of WPNAV_RADIUS; then the vehicle waits as long as the item says.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from mavcal.service.simvehicle.flight.frame import Vector
from mavcal.service.simvehicle.flight.items import AT_ONCE, LANDINGS, Command, Item, MissionState
from mavcal.service.simvehicle.flight.modes import CLOSE_ENOUGH, landing_climb, takeoff_climb
from mavcal.service.simvehicle.flight.parameters import FlightParameters

_BRAKING = 1.0
"""Deceleration towards a place, m/s2. Chosen: below WPNAV_ACCEL, so that it does not overshoot."""
_TURN_BEYOND_M = 3.0
"""Distance to a place within which the heading is kept."""
_HEIGHT_OFF_M = 0.7


class AutoFlight:
    """Flies `items`; the first one is home. `reached` is called with the number of every item that is done."""

    def __init__(self, parameters: FlightParameters) -> None:
        self._parameters = parameters
        self.items: tuple[Item, ...] = ()
        self.current = 0
        self.state = MissionState.NO_MISSION
        self.reached: Callable[[int], None] = lambda _number: None
        self.yaw: float | None = None
        """Desired heading, rad; None: the present one."""
        self._target: list[float] | None = None  # north, east, height
        self._waited = 0.0
        self._speed = 0.0
        self._over = False

    def load(self, items: Sequence[Item]) -> None:
        """Take a new mission, to be flown from its first item."""
        self.items = tuple(items)
        self.current = 0
        self.state = MissionState.NOT_STARTED if len(self.items) > 1 else MissionState.NO_MISSION

    def start(self) -> None:
        """Begin with the first item behind home, unless the mission is under way."""
        if self.state is MissionState.ACTIVE:
            return
        self._speed = 0.01 * self._parameters["WPNAV_SPEED"]
        self.state, self.yaw = MissionState.ACTIVE, None
        self._begin(1)

    @property
    def command(self) -> int | None:
        """The command that is flown now."""
        return self.items[self.current].command if self.state is MissionState.ACTIVE else None

    @property
    def lifting(self) -> bool:
        """Whether the present item takes off."""
        return self.command == Command.TAKEOFF

    @property
    def landing(self) -> bool:
        """Whether the vehicle descends at the place where it lands."""
        return self.command in LANDINGS and self._over

    @property
    def down(self) -> bool:
        """Whether a vehicle on the ground is to disarm."""
        return self.landing or self.state is MissionState.COMPLETE

    def landed(self) -> None:
        """Note that the vehicle has landed."""
        if self.command in LANDINGS:
            self._done()

    def steer(self, place: Sequence[float], yaw: float, dt: float) -> Vector:
        """Velocity north and east, and climb, m/s, from `place` north east down; `dt` since the last one."""
        north, east, height = place[0], place[1], -place[2]
        command = self.command
        if command is None:
            return self._towards(self._target or [north, east, height], north, east, height)
        if self._target is None:
            self._target = self._aim(north, east, height)
        if command == Command.TAKEOFF:
            target = self._target[2]
            if height > target - CLOSE_ENOUGH:
                self._done()
            return 0.0, 0.0, takeoff_climb(height, target)
        wanted = self._towards(self._target, north, east, height)
        if self.landing:
            return wanted[0], wanted[1], landing_climb(height, self._parameters)
        self._turn(north, east, yaw)
        if self._is_there(north, east, height):
            self._arrived(dt)
        return wanted

    def _arrived(self, dt: float) -> None:
        item = self.items[self.current]
        if item.command in LANDINGS:
            self._over = True
            return
        self._waited += dt
        if self._waited >= item.parameters[0]:
            self._done()

    def _aim(self, north: float, east: float, height: float) -> list[float]:
        """Target of the present item."""
        item, parameters = self.items[self.current], self._parameters
        if item.command == Command.RETURN_TO_LAUNCH:
            return [0.0, 0.0, max(height, 0.01 * parameters["RTL_ALT"])]
        home = parameters["SIM_OPOS_LAT"], parameters["SIM_OPOS_LNG"]
        to = item.place(home) or (north, east)
        if item.command in (Command.LAND, Command.DELAY):
            return [*to, height]
        return [*to, item.height(parameters["SIM_OPOS_ALT"])]

    def _is_there(self, north: float, east: float, height: float) -> bool:
        assert self._target is not None
        radius = 0.01 * self._parameters["WPNAV_RADIUS"]
        off = math.hypot(self._target[0] - north, self._target[1] - east)
        return off < radius and abs(self._target[2] - height) < _HEIGHT_OFF_M

    def _towards(self, target: Sequence[float], north: float, east: float, height: float) -> Vector:
        dn, de, up = target[0] - north, target[1] - east, target[2] - height
        off = math.hypot(dn, de)
        speed = min(self._speed, off, math.sqrt(2.0 * _BRAKING * off)) / max(off, 1e-6)
        most, least = 0.01 * self._parameters["WPNAV_SPEED_UP"], -0.01 * self._parameters["WPNAV_SPEED_DN"]
        return dn * speed, de * speed, min(max(up, least), most)

    def _turn(self, north: float, east: float, yaw: float) -> None:
        assert self._target is not None
        dn, de = self._target[0] - north, self._target[1] - east
        if math.hypot(dn, de) > _TURN_BEYOND_M:
            self.yaw = math.atan2(de, dn)
        elif self.yaw is None:
            self.yaw = yaw

    def _done(self) -> None:
        self.reached(self.current)
        self._begin(self.current + 1)

    def _begin(self, number: int) -> None:
        """Begin the item of that number, or the next one that is not done at once; hold after the last one."""
        self._waited, self._over = 0.0, False
        while number < len(self.items):
            item = self.items[number]
            self.current = number
            if item.command not in AT_ONCE:
                self._target = None
                return
            self._do(item)
            number += 1
        self.state = MissionState.COMPLETE

    def _do(self, item: Item) -> None:
        first, second, _, relative = item.parameters
        if item.command == Command.CHANGE_SPEED and second > 0.0:
            self._speed = second
        elif item.command == Command.CONDITION_YAW:
            self.yaw = math.radians(first) + (relative * (self.yaw or 0.0))
