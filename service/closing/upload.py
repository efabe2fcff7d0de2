"""The mission protocol from the ground's side: the vehicle asks for one item after the other, then answers."""

from __future__ import annotations

from collections.abc import Sequence

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.logs.missions import MissionItem
from mavcal.calib.wire import Message
from mavcal.service.closing.conversation import HINT, Conversation
from mavcal.service.closing.errors import MissionRefused

QUIET_S = 3.0
"""Vehicle seconds without a question after which the upload begins anew: vehicles ask again after one second."""
TRIES = 10
_PASSED = (dialect.MAV_MISSION_INVALID_SEQUENCE, dialect.MAV_MISSION_OPERATION_CANCELLED)
"""Answers to an item that came twice, and to an upload that was given up: neither is a refusal."""
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
        """Until the vehicle has taken all of them.

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
