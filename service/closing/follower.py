"""Has a vehicle fly the mission of a log in AUTO, and follows it item by item by its own clock."""

from __future__ import annotations

from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import CalibError
from mavcal.calib.logs.missions import LANDINGS, LoggedMission, MissionItem, Place, durations, moved
from mavcal.calib.wire import Message
from mavcal.service.closing import autopilot as ways
from mavcal.service.closing.conversation import HINT, TRY_S, Conversation
from mavcal.service.closing.errors import MissionLeft, MissionRefused, SimulatorUnarmed
from mavcal.service.closing.logged import SPEED, LogMission
from mavcal.service.closing.pilot import ARM_S, arm, begin, land
from mavcal.service.closing.upload import Upload

LONGER, MORE_S = 3.0, 45.0
"""An item may take so many times its length, and so many seconds more. Chosen, not measured: for weak vehicles."""
_CURRENT_HZ = 5.0
_LIFTED_M = 0.5
_LIFT_S = 30.0
_STARTS = 3
_SPEED_NAME, _CM, _SLOWEST = "WPNAV_SPEED", 0.01, 0.1
"""cm/s; slower than 0.1 m/s ArduPilot does not fly to a place (``AC_WPNav.cpp``)."""
_HOME_ASK = dialect.MAVLINK_MSG_ID_HOME_POSITION


class Follower:
    """Flies `mission` with the vehicle of a conversation."""

    def __init__(self, vehicle: Conversation, mission: LogMission) -> None:
        self._vehicle, self._mission = vehicle, mission
        self._home: Place | None = None
        self._items: tuple[MissionItem, ...] = ()
        self._current, self._reached, self._complete = 0, 0, False

    def fly(self, settings: Mapping[str, float] | None = None) -> None:
        """The whole mission; `settings` are parameters that are set first, over MAVLink.

        Raises
        ------
        SimulatorSilent
            If the vehicle falls silent.
        SimulatorUnarmed
            If it refuses to arm, or a parameter, or does not know where it is.
        MissionRefused
            If it does not take the mission.
        MissionLeft
            If it does something else, or takes too long.
        """
        vehicle = self._vehicle
        begin(vehicle, settings)
        if vehicle.way.auto is None:
            raise MissionRefused(
                "only ArduPilot's simulator flies a log's mission, and this is PX4. Fly the standard one: "
                "--mission standard."
            )
        vehicle.listeners.append(self._listen)
        flown = self._moved(self._find_home())
        Upload(vehicle, (flown.home, *flown.items)).run()
        self._items = flown.items
        speed = min(max(_CM * vehicle.parameter(_SPEED_NAME, SPEED / _CM), _SLOWEST), SPEED)
        vehicle.doing = "resting"
        vehicle.run(self._mission.rest_s)
        self._start()
        self._follow(flown, speed)
        if vehicle.state.armed:
            land(vehicle)
        vehicle.doing = "resting"
        vehicle.run(self._mission.rest_after_s)

    def _find_home(self) -> Place:
        """Where the vehicle's home is, as soon as it knows."""
        vehicle = self._vehicle
        vehicle.doing = "waiting for a position"
        ask = ways.command(vehicle.to, dialect.MAV_CMD_REQUEST_MESSAGE, _HOME_ASK)
        vehicle.run(ARM_S, lambda: ask, until=lambda: self._home is not None)
        if self._home is None:
            raise SimulatorUnarmed(
                f"the vehicle named no home position within {ARM_S:g} s of its clock.{vehicle.said()} Give the "
                "simulator a GPS, or fly the standard mission: --mission standard."
            )
        return self._home

    def _moved(self, home: Place) -> LoggedMission:
        try:
            return moved(self._mission.flown, home)
        except CalibError as error:
            raise MissionRefused(f"the mission cannot be moved to the simulator's home: {error}") from error

    def _start(self) -> None:
        """Arm, and have it fly the mission until it has left the ground; again where it disarmed itself before."""
        vehicle, way = self._vehicle, self._vehicle.way
        hz = 1e6 / _CURRENT_HZ
        current = dialect.MAVLINK_MSG_ID_MISSION_CURRENT
        vehicle.send(ways.command(vehicle.to, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, current, hz))
        for _ in range(_STARTS):
            arm(vehicle)
            vehicle.doing, began = "starting the mission", vehicle.state.t
            while vehicle.state.armed and not self._lifted and vehicle.state.t - began < _LIFT_S:
                if vehicle.state.mode != way.auto:
                    vehicle.send(way.follow_mission(vehicle.to))
                    vehicle.send(way.start_mission(vehicle.to))
                vehicle.run(TRY_S, until=lambda: self._lifted or not vehicle.state.armed)
            if self._lifted:
                assert way.auto is not None
                vehicle.obeys, vehicle.flying = way.auto, True
                self._begun()
                return
            if vehicle.state.armed:
                break
        raise MissionLeft(
            f"the vehicle is at {vehicle.state.height:.1f} m {_LIFT_S:g} s after the mission's start, in mode "
            f"{vehicle.state.mode}.{vehicle.said()} Can it carry its weight with these settings?"
        )

    @property
    def _lifted(self) -> bool:
        state = self._vehicle.state
        return state.mode == self._vehicle.way.auto and state.height > _LIFTED_M

    def _follow(self, flown: LoggedMission, speed: float) -> None:
        """Until the last item is done, or the vehicle has landed and disarmed."""
        vehicle = self._vehicle
        limits = [LONGER * seconds + MORE_S for seconds in durations(flown, speed)]
        began = since = vehicle.state.t
        number = 0
        while not self._done(flown):
            now = vehicle.state.t
            if self._current != number:
                number, since = self._current, now
            if number and now - since > limits[number - 1]:
                self._stands(self._items[number - 1].name, now - since, limits[number - 1])
            if now - began > sum(limits):
                self._stands("the mission", now - began, sum(limits))
            vehicle.pump()

    def _done(self, flown: LoggedMission) -> bool:
        last = flown.last
        if not self._vehicle.state.armed:
            return True
        landing = flown.items[last].command in LANDINGS
        return not landing and (self._complete or self._reached > last)

    def _stands(self, what: str, seconds: float, limit: float) -> None:
        vehicle = self._vehicle
        raise MissionLeft(
            f"the vehicle has flown {what} for {seconds:.0f} s, and by its length {limit:.0f} s are the most. It is at "
            f"{vehicle.state.height:.1f} m.{vehicle.said()} {HINT}"
        )

    def _listen(self, message: Message) -> None:
        name = message.get_type()
        if name == "MISSION_CURRENT":
            self._is_at(int(message.seq))
            self._complete = message.mission_state == dialect.MISSION_STATE_COMPLETE
        elif name == "MISSION_ITEM_REACHED":
            self._reached = max(self._reached, int(message.seq))
        elif name == "HOME_POSITION":
            self._home = Place(1e-7 * message.latitude, 1e-7 * message.longitude, 1e-3 * message.altitude)

    def _is_at(self, number: int) -> None:
        """At once, not when all that has arrived is taken in: a vehicle that lands may disarm right behind it."""
        if number != self._current and 0 < number <= len(self._items):
            self._current = number
            if self._vehicle.flying:
                self._begun()

    def _begun(self) -> None:
        """Name the present item as what is being done; a vehicle may disarm only in a landing."""
        if self._current > 0:
            item = self._items[self._current - 1]
            self._vehicle.doing = f"flying {item.name}"
            self._vehicle.flying = item.command not in LANDINGS
