"""A small MAVLink client for one simulated vehicle: synchronous, for a loop that has nothing else to do."""

from __future__ import annotations

import selectors
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import Message, decode, encode
from mavcal.calib.wire.frames import FrameParser
from mavcal.service.closing.errors import OtherVehicle, SimulatorSilent
from mavcal.service.errors import LinkDown, ServiceError
from mavcal.service.link.endpoint import Endpoint
from mavcal.service.link.link import transport_of
from mavcal.service.link.transports import Disconnected, Transport
from mavcal.service.link.types import Address, OwnIdentity

HEARTBEAT_S = 1.0
NOBODY_S = 2.5
"""Silence required before the simulator is started, wall seconds: two heartbeats of a vehicle."""
_AGAIN_S = 0.2
_WAIT_S = 0.05
IDS = frozenset(
    {
        dialect.MAVLINK_MSG_ID_HEARTBEAT,
        dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
        dialect.MAVLINK_MSG_ID_ATTITUDE,
        dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        dialect.MAVLINK_MSG_ID_COMMAND_ACK,
        dialect.MAVLINK_MSG_ID_STATUSTEXT,
        dialect.MAVLINK_MSG_ID_PARAM_VALUE,
        dialect.MAVLINK_MSG_ID_HOME_POSITION,
        dialect.MAVLINK_MSG_ID_MISSION_REQUEST,
        dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT,
        dialect.MAVLINK_MSG_ID_MISSION_ACK,
        dialect.MAVLINK_MSG_ID_MISSION_CURRENT,
        dialect.MAVLINK_MSG_ID_MISSION_ITEM_REACHED,
    }
)
"""Messages that are decoded; all others are skipped."""


class VehicleLink:
    """A connection to the vehicle behind `endpoint`; a context manager that closes it.

    It is that of the first heartbeat: whoever else is heard there ends the conversation, since what is sent might reach
    the wrong one.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self._own = OwnIdentity()
        self._transport: Transport | None = None
        self._selector = selectors.DefaultSelector()
        self._parser = FrameParser()
        self._peer: Address | None = None
        self._sequence = 0
        self._beat = -HEARTBEAT_S
        self.heartbeat: Message | None = None
        """The vehicle's last heartbeat."""
        self.target = (0, 0)
        """The vehicle's system and component ids."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()
        self._selector.close()

    def connect(self, limit_s: float, check: Callable[[], None]) -> None:
        """Connect, again and again, until the vehicle's heartbeat is heard; `check` may raise meanwhile.

        Raises
        ------
        SimulatorSilent
            If none is heard within `limit_s` of the wall clock.
        """
        end = time.monotonic() + limit_s
        why = "nothing was heard"
        while self.heartbeat is None:
            check()
            if time.monotonic() > end:
                raise SimulatorSilent(
                    f"no heartbeat at {self.endpoint} within {limit_s:g} s ({why}). Does the simulator serve MAVLink "
                    "there? Give its port by {port}, or its address by --connect"
                )
            try:
                if self._transport is None:
                    self._open()
                self.poll()
            except LinkDown as error:
                why = str(error)
                time.sleep(_AGAIN_S)
            except ServiceError as error:
                raise SimulatorSilent(str(error)) from error

    def _open(self) -> None:
        made = transport_of(self.endpoint)
        made.open(self._selector)
        self._transport, self._parser = made, FrameParser()

    def send(self, message: Message) -> None:
        """Send one message. Raises LinkDown if the connection has broken."""
        if self._transport is None:
            raise LinkDown(f"{self.endpoint}: not connected")
        frame = encode(message, self._own.system, self._own.component, self._sequence)
        self._sequence = (self._sequence + 1) % 256
        try:
            self._transport.send(frame, self._peer)
        except Disconnected as error:
            self._close()
            raise LinkDown(f"{self.endpoint}: {error}") from error

    def poll(self) -> list[Message]:
        """The vehicle's messages of :data:`IDS` that have arrived within a short wait; our heartbeat goes out.

        Raises
        ------
        LinkDown
            If the connection has broken.
        OtherVehicle
            If a second vehicle is heard.
        """
        now = time.monotonic()
        if now - self._beat >= HEARTBEAT_S:
            self._beat = now
            self.send(dialect.MAVLink_heartbeat_message(self._own.type, dialect.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3))
        self._selector.select(_WAIT_S)
        assert self._transport is not None
        try:
            chunks = self._transport.receive()
        except Disconnected as error:
            self._close()
            raise LinkDown(f"{self.endpoint}: {error}") from error
        feed = self._parser.feed_datagram if self._transport.datagrams else self._parser.feed
        found = []
        for chunk in chunks:
            for frame in feed(chunk.data, IDS):
                message = decode(frame)
                if frame.message_id == dialect.MAVLINK_MSG_ID_HEARTBEAT:
                    if message.autopilot == dialect.MAV_AUTOPILOT_INVALID:
                        continue  # a ground station, a gimbal, ourselves
                    self._meet(message, (frame.system, frame.component), chunk.peer)
                if frame.system == self.target[0] and chunk.peer == self._peer:
                    found.append(message)
        return found

    def _meet(self, heartbeat: Message, sender: tuple[int, int], peer: Address) -> None:
        """Keep to the vehicle that was heard first. Raises OtherVehicle at another one."""
        if self.heartbeat is None:
            self.target, self._peer = sender, peer
        elif sender[0] != self.target[0] or peer != self._peer:
            where = "" if self._peer is None or peer == self._peer else f" ({_named(self._peer)} and {_named(peer)})"
            raise OtherVehicle(
                f"two vehicles speak at {self.endpoint}{where}: system {self.target[0]} and system {sender[0]}. Take "
                "the other one off this address, or give the simulator an address of its own by --connect"
            )
        if sender == self.target:  # not that of a companion computer of the same vehicle
            self.heartbeat = heartbeat

    def _close(self) -> None:
        if self._transport is not None:
            self._transport.close()
            self._transport = None


def require_nobody(endpoint: Endpoint) -> None:
    """Check that no vehicle is heard at the simulator's address. Raises OtherVehicle otherwise."""
    with VehicleLink(endpoint) as link:
        try:
            link.connect(NOBODY_S, lambda: None)
        except SimulatorSilent:
            return
        raise OtherVehicle(
            f"system {link.target[0]} speaks at {endpoint} although the simulator is not started yet. End what runs "
            "there, take the vehicle off this address, or give the simulator an address of its own by --connect"
        )


def text_of(value: bytes | str) -> str:
    """The text in a field of characters."""
    raw = value.encode() if isinstance(value, str) else value
    return raw.split(b"\0")[0].decode("utf-8", "replace")


def _named(peer: Address) -> str:
    return f"{peer[0]}:{peer[1]}"
