"""The mission protocol from the vehicle's side: an upload that asks for one item after the other, and a download.

As ArduPilot's (``MissionItemProtocol.cpp``): an item that does not come is asked for again, and an upload that stands
still is given up. Only missions; fences and rally points are not known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle.flight.items import FRAMES, WHOLE_DEGREE, Command, Item
from mavcal.service.simvehicle.flight.vehicle import FlyingVehicle
from mavcal.service.simvehicle.wire import Received

ASK_AGAIN_S, GIVE_UP_S = 1.0, 8.0
MOST_ITEMS = 700
Address = tuple[int, int]


class MissionLink:
    """Takes in and gives out the mission of `vehicle`; `send` sends one message."""

    def __init__(self, vehicle: FlyingVehicle, send: Callable[[Any], None]) -> None:
        self._vehicle, self._send = vehicle, send
        self._coming: list[Item] = []
        self._expected = 0
        self._from: Address | None = None
        self._asked = self._heard = 0.0
        self._handlers: Mapping[str, Callable[[Any, Address], None]] = {
            "MISSION_COUNT": self._begin,
            "MISSION_ITEM_INT": self._take,
            "MISSION_REQUEST_LIST": self._list,
            "MISSION_REQUEST_INT": self._give,
            "MISSION_REQUEST": self._give,
            "MISSION_CLEAR_ALL": self._clear,
        }
        vehicle.auto.reached = lambda number: send(dialect.MAVLink_mission_item_reached_message(number))

    def handle(self, received: Received) -> bool:
        """Take in one message; False: it is not one of this protocol."""
        handler = self._handlers.get(received.name)
        if handler is None:
            return False
        if received.message.mission_type != dialect.MAV_MISSION_TYPE_MISSION:
            self._answer((received.system, received.component), dialect.MAV_MISSION_UNSUPPORTED)
        else:
            handler(received.message, (received.system, received.component))
        return True

    def send_due(self) -> None:
        """Request an item again that did not arrive in time."""
        now = self._vehicle.time
        if self._from is None:
            return
        if now - self._heard > GIVE_UP_S:
            self._end(dialect.MAV_MISSION_OPERATION_CANCELLED)
        elif now - self._asked > ASK_AGAIN_S:
            self._ask()

    def current(self) -> Any:
        """MISSION_CURRENT: the item that is flown."""
        auto = self._vehicle.auto
        return dialect.MAVLink_mission_current_message(auto.current, len(auto.items), int(auto.state))

    def _begin(self, m: Any, sender: Address) -> None:
        if m.count > MOST_ITEMS:
            self._answer(sender, dialect.MAV_MISSION_NO_SPACE)
            return
        self._coming, self._expected, self._from = [], int(m.count), sender
        self._heard = self._vehicle.time
        self._next()

    def _take(self, m: Any, sender: Address) -> None:
        if self._from is None or sender != self._from or m.seq != len(self._coming):
            self._answer(sender, dialect.MAV_MISSION_INVALID_SEQUENCE)
            return
        fault = dialect.MAV_MISSION_ACCEPTED if m.seq == 0 else _result_of(m)
        if fault != dialect.MAV_MISSION_ACCEPTED:
            self._end(fault)
            return
        self._coming.append(_item(m))
        self._heard = self._vehicle.time
        self._next()

    def _next(self) -> None:
        if len(self._coming) < self._expected:
            self._ask()
            return
        self._vehicle.load_mission(self._coming)
        self._end(dialect.MAV_MISSION_ACCEPTED)

    def _ask(self) -> None:
        assert self._from is not None
        self._asked = self._vehicle.time
        self._send(dialect.MAVLink_mission_request_message(*self._from, len(self._coming)))

    def _end(self, result: int) -> None:
        if self._from is not None:
            self._answer(self._from, result)
        self._from = None

    def _answer(self, to: Address, result: int) -> None:
        self._send(dialect.MAVLink_mission_ack_message(*to, result))

    def _list(self, _m: Any, sender: Address) -> None:
        self._send(dialect.MAVLink_mission_count_message(*sender, len(self._vehicle.auto.items)))

    def _give(self, m: Any, sender: Address) -> None:
        items = self._vehicle.auto.items
        if m.seq >= len(items):
            self._answer(sender, dialect.MAV_MISSION_INVALID_SEQUENCE)
            return
        item = items[m.seq]
        place = round(WHOLE_DEGREE * item.latitude), round(WHOLE_DEGREE * item.longitude), item.altitude
        head = (m.seq, item.frame, item.command, int(m.seq == self._vehicle.auto.current), 1)
        self._send(dialect.MAVLink_mission_item_int_message(*sender, *head, *item.parameters, *place))

    def _clear(self, _m: Any, sender: Address) -> None:
        self._vehicle.load_mission([])
        self._answer(sender, dialect.MAV_MISSION_ACCEPTED)


def _result_of(m: Any) -> int:
    """MAV_MISSION_RESULT of an item: accepted, or why it cannot be flown."""
    if m.command not in set(Command):
        return int(dialect.MAV_MISSION_UNSUPPORTED)
    if m.frame not in FRAMES:
        return int(dialect.MAV_MISSION_UNSUPPORTED_FRAME)
    whole = all(math.isfinite(value) for value in (m.param1, m.param2, m.param3, m.param4, m.z))
    return int(dialect.MAV_MISSION_ACCEPTED if whole else dialect.MAV_MISSION_INVALID)


def _item(m: Any) -> Item:
    given = (float(m.param1), float(m.param2), float(m.param3), float(m.param4))
    return Item(int(m.command), int(m.frame), given, m.x / WHOLE_DEGREE, m.y / WHOLE_DEGREE, float(m.z))
