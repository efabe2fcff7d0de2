"""Has a vehicle fly the mission of a log by itself, and follows it item by item on its own clock.

The mission is uploaded first: the vehicle requests one item after the other, then acknowledges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import CalibError
from mavcal.calib.logs.missions.course import Place, durations, moved
from mavcal.calib.logs.missions.items import LANDINGS, LoggedMission, MissionItem
from mavcal.calib.wire.codec import Message
from mavcal.service.closing import autopilot as ways
from mavcal.service.closing.conversation import HINT, TRY_S, Conversation
from mavcal.service.closing.errors import MissionLeft, MissionRefused, SimulatorUnarmed
from mavcal.service.closing.mission import SPEED, LogMission
from mavcal.service.closing.pilot import ARM_S, arm, begin, land

LONGER, MORE_S = 3.0, 45.0
"""Time allowed for an item: a multiple of its length, and seconds more. Chosen, not measured, for weak vehicles."""
_CURRENT_HZ = 5.0
_LIFTED_M = 0.5
_LIFT_S = 30.0
_STARTS = 3
_SLOWEST = 0.1
"""Lowest speed at which ArduPilot flies to a place, m/s (``AC_WPNav.cpp``)."""
_NO_ITEM = -1
_CALLED = {way.name: way.called for way in (ways.ArduPilot, ways.Px4)}
_HOME_ASK = dialect.MAVLINK_MSG_ID_HOME_POSITION


class Follower:
    """Flies `mission` with the vehicle of a conversation."""

    def __init__(self, vehicle: Conversation, mission: LogMission) -> None:
        self._vehicle, self._mission = vehicle, mission
        self._home: Place | None = None
        self._items: tuple[MissionItem, ...] = ()
        self._last = 0
        self._current, self._reached, self._complete = _NO_ITEM, _NO_ITEM, False

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
        way = vehicle.way
        if way.name != self._mission.flown.autopilot:
            raise MissionRefused(
                f"the mission is that of a log of {_CALLED[self._mission.flown.autopilot]}, and the simulator is "
                f"{way.called}, which would fly other ways. Fly the standard one: --mission standard."
            )
        begin(vehicle, settings)
        vehicle.listeners.append(self._listen)
        flown = self._moved(self._find_home())
        Upload(vehicle, way.items(flown)).run()
        self._items, self._last = flown.items, flown.last
        name, unit = way.speed
        speed = min(max(unit * vehicle.parameter(name, SPEED / unit), _SLOWEST), SPEED)
        vehicle.doing = "resting"
        vehicle.run(self._mission.rest_s)
        self._start()
        self._follow(flown, speed)
        if vehicle.state.armed:
            land(vehicle)
        vehicle.doing = "resting"
        vehicle.run(self._mission.rest_after_s)

    def _find_home(self) -> Place:
        """The vehicle's home position, waited for until the vehicle states it."""
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
            arm(vehicle, way.ready(vehicle.to))
            vehicle.doing, began = "starting the mission", vehicle.state.t
            while vehicle.state.armed and not self._lifted and vehicle.state.t - began < _LIFT_S:
                if vehicle.state.mode != way.auto:
                    vehicle.send(way.follow_mission(vehicle.to))
                    vehicle.send(way.start_mission(vehicle.to))
                vehicle.run(TRY_S, until=lambda: self._lifted or not vehicle.state.armed)
            if self._lifted:
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
        """Follow the mission until the last item is done, or the vehicle has landed and disarmed."""
        vehicle = self._vehicle
        limits = [LONGER * seconds + MORE_S for seconds in durations(flown, speed)]
        began = since = vehicle.state.t
        at = _NO_ITEM
        while not self._done:
            now = vehicle.state.t
            if self._current != at:
                at, since = self._current, now
            if at != _NO_ITEM and now - since > limits[at]:
                self._stands(flown.items[at].name, now - since, limits[at])
            if now - began > sum(limits):
                self._stands("the mission", now - began, sum(limits))
            vehicle.pump()

    @property
    def _done(self) -> bool:
        if not self._vehicle.state.armed:
            return True
        landing = self._items[self._last].command in LANDINGS
        return not landing and (self._complete or self._reached >= self._last)

    def _stands(self, what: str, seconds: float, limit: float) -> None:
        vehicle = self._vehicle
        raise MissionLeft(
            f"the vehicle has flown {what} for {seconds:.0f} s, and by its length {limit:.0f} s are the most. It is at "
            f"{vehicle.state.height:.1f} m.{vehicle.said()} {HINT}"
        )

    def _listen(self, message: Message) -> None:
        name = message.get_type()
        if name == "MISSION_CURRENT":
            self._is_at(int(message.seq) - self._vehicle.way.first)
            self._complete = message.mission_state == dialect.MISSION_STATE_COMPLETE
        elif name == "MISSION_ITEM_REACHED":
            self._has_reached(int(message.seq) - self._vehicle.way.first)
        elif name == "HOME_POSITION":
            self._home = Place(1e-7 * message.latitude, 1e-7 * message.longitude, 1e-3 * message.altitude)

    def _is_at(self, index: int) -> None:
        """Take in the present item at once: a landing vehicle may disarm in the next message."""
        if index != self._current and 0 <= index < len(self._items):
            self._current = index
            if self._vehicle.flying:
                self._begun()

    def _has_reached(self, index: int) -> None:
        """Take in a reached item; after its last one PX4 holds, or returns without a message, in another mode."""
        self._reached = max(self._reached, index)
        left = [item for item in self._items[self._reached + 1 :] if item.flies]
        if self._items and (not left or left[0].command in LANDINGS):
            self._vehicle.flying = False

    def _begun(self) -> None:
        """Report the present item as the activity; a vehicle may disarm only in a landing."""
        if self._current != _NO_ITEM:
            item = self._items[self._current]
            self._vehicle.doing = f"flying {item.name}"
            self._vehicle.flying = item.command not in LANDINGS


QUIET_S = 3.0
"""Vehicle seconds without a request after which the upload begins anew; vehicles repeat a request after one second."""
TRIES = 10
_PASSED = (dialect.MAV_MISSION_INVALID_SEQUENCE, dialect.MAV_MISSION_OPERATION_CANCELLED)
"""Answers to a repeated item and to an abandoned upload; neither is a refusal."""
_DEGREE = 1e7


class Upload:
    """Gives the vehicle of a conversation `items`, numbered from 0."""

    def __init__(self, vehicle: Conversation, items: Sequence[MissionItem]) -> None:
        self._vehicle, self._items = vehicle, items
        self._asked = -1
        self._furthest = -1
        self._heard = 0.0
        self._result: int | None = None

    def run(self) -> None:
        """Upload until the vehicle has taken every item.

        Raises
        ------
        MissionRefused
            If it refuses an item, or asks for none any more.
        SimulatorSilent
            If it falls silent.
        """
        vehicle, count = self._vehicle, len(self._items)
        vehicle.doing = "uploading the mission"
        vehicle.listeners.append(self._listen)
        try:
            for _ in range(TRIES):
                self._heard = vehicle.state.t
                vehicle.send(dialect.MAVLink_mission_count_message(*vehicle.to, count))
                while self._result is None and vehicle.state.t - self._heard < QUIET_S:
                    vehicle.pump()
                if self._result is not None:
                    break
        finally:
            vehicle.listeners.remove(self._listen)
        self._check()

    def _check(self) -> None:
        if self._result == dialect.MAV_MISSION_ACCEPTED:
            return
        said, last = self._vehicle.said(), self._items[self._asked].name
        if self._result is None:
            done = f"it asked for {self._furthest + 1} of {len(self._items)} items"
            raise MissionRefused(
                f"the vehicle did not take the mission in {TRIES} uploads: {done}.{said} {HINT} "
                "Or fly the standard mission: --mission standard."
            )
        names = dialect.enums["MAV_MISSION_RESULT"]
        why = names[self._result].name if self._result in names else f"result {self._result}"
        at = f"{last} of the log" if self._asked >= 0 else "its length"
        raise MissionRefused(
            f"the vehicle refused the mission at {at} ({why}).{said} Fly the standard mission: --mission standard."
        )

    def _listen(self, message: Message) -> None:
        name = message.get_type()
        if name in ("MISSION_REQUEST", "MISSION_REQUEST_INT") and message.mission_type == _MISSION:
            if message.seq < len(self._items):
                self._heard, self._asked = self._vehicle.state.t, int(message.seq)
                self._furthest = max(self._furthest, self._asked)
                self._vehicle.send(self._item(self._asked))
        elif name == "MISSION_ACK" and message.mission_type == _MISSION:
            whole = self._asked == len(self._items) - 1
            if message.type not in _PASSED and (whole or message.type != dialect.MAV_MISSION_ACCEPTED):
                self._result = int(message.type)

    def _item(self, number: int) -> Message:
        item = self._items[number]
        place = round(_DEGREE * item.latitude), round(_DEGREE * item.longitude), item.altitude
        head = (number, item.frame, item.command, 0, 1)
        return dialect.MAVLink_mission_item_int_message(*self._vehicle.to, *head, *item.parameters, *place)


_MISSION = dialect.MAV_MISSION_TYPE_MISSION
