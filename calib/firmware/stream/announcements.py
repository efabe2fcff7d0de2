"""Messages of a vehicle about itself: identity, texts, arming, onboard calibrations."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, Final

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.device_ids import unit_id
from mavcal.calib.recording import Event, Identity
from mavcal.calib.wire.codec import decode
from mavcal.calib.wire.texts import CHUNK_BYTES, joined_text, text_bytes

if TYPE_CHECKING:
    from collections.abc import Callable

    from mavcal.calib.wire.frames import Frame

AUTOPILOTS: Final = {
    dialect.MAV_AUTOPILOT_ARDUPILOTMEGA: "ardupilot",
    dialect.MAV_AUTOPILOT_PX4: "px4",
}
CALIBRATION_TAG: Final = "[cal]"


class Announcements:
    """Takes single messages in their order and gives events; keeps the identity up to date."""

    def __init__(self, identity: Identity) -> None:
        self.identity = identity
        self._armed: bool | None = None
        self._calibrating = False
        self._chunks: dict[int, list[bytes]] = {}
        self._handlers: dict[int, Callable[[float, Any], list[Event]]] = {
            dialect.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._version,
            dialect.MAVLINK_MSG_ID_STATUSTEXT: self._text,
            dialect.MAVLINK_MSG_ID_MAG_CAL_PROGRESS: self._compass_calibration,
            dialect.MAVLINK_MSG_ID_MAG_CAL_REPORT: self._compass_calibration,
            dialect.MAVLINK_MSG_ID_COMMAND_LONG: self._command,
        }

    @property
    def message_ids(self) -> frozenset[int]:
        """Ids of the messages that it listens to."""
        return frozenset(self._handlers)

    def feed(self, t: float, frame: Frame) -> list[Event]:
        """The events in one frame that arrived at vehicle time `t`."""
        return self._handlers[frame.message_id](t, decode(frame))

    def _heartbeat(self, t: float, message: Any) -> list[Event]:
        if message.autopilot == dialect.MAV_AUTOPILOT_INVALID:
            return []
        autopilot = AUTOPILOTS.get(message.autopilot, "other")
        self.identity = dataclasses.replace(self.identity, autopilot=autopilot, vehicle_type=int(message.type))
        events = []
        armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
        if self._armed is not None and armed != self._armed:
            kind = "armed" if armed else "disarmed"
            events.append(Event(t, kind, f"the vehicle was {kind}"))
        self._armed = armed
        calibrating = message.system_status == dialect.MAV_STATE_CALIBRATING
        if calibrating and not self._calibrating:
            events.append(Event(t, "onboard_calibration", "the vehicle says that it is calibrating"))
        self._calibrating = calibrating
        return events

    def _version(self, t: float, message: Any) -> list[Event]:
        packed = int(message.flight_sw_version)
        uid = unit_id(self.identity.autopilot, bytes(message.uid2), message.uid)
        self.identity = dataclasses.replace(
            self.identity,
            firmware=(packed >> 24, packed >> 16 & 0xFF, packed >> 8 & 0xFF),
            uid=uid or self.identity.uid,
        )
        return []

    def _text(self, t: float, message: Any) -> list[Event]:
        pieces = [text_bytes(message)]
        if message.id:
            # a long text comes in chunks; the one that is not full is the last
            if message.chunk_seq == 0:
                self._chunks[message.id] = []
            parts = self._chunks.setdefault(message.id, [])
            parts += pieces
            if len(pieces[0]) == CHUNK_BYTES:
                return []
            pieces = self._chunks.pop(message.id)
        text = joined_text(pieces)
        kind = "onboard_calibration" if CALIBRATION_TAG in text else "text"
        return [Event(t, kind, text)]

    def _compass_calibration(self, t: float, message: Any) -> list[Event]:
        if self.identity.autopilot == "px4":
            return []  # PX4 sends MAG_CAL_REPORT on every parameter change
        return [Event(t, "onboard_calibration", f"{message.get_type()} of compass {message.compass_id + 1}")]

    def _command(self, t: float, message: Any) -> list[Event]:
        if message.command != dialect.MAV_CMD_ACCELCAL_VEHICLE_POS:
            return []
        return [Event(t, "onboard_calibration", "the vehicle asks for a pose of its own accelerometer calibration")]
