"""A link without sockets and a clock that is set by hand, for vehicles under test."""

from __future__ import annotations

import asyncio
import math
import struct
from collections.abc import Callable, Coroutine, Iterable
from typing import Any, TypeVar, cast

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import RawMessage, decode, encode, param_bytes, raw_message
from mavcal.calib.wire.frames import FrameParser
from mavcal.service.link.endpoint import parse_endpoint
from mavcal.service.link.link import Link
from mavcal.service.link.types import Batch, LinkStatistics, OwnIdentity
from mavcal.service.vehicle.events import VehicleEvent, VehicleEventKind
from mavcal.service.vehicle.vehicle import Vehicle
from tests.clock import ManualClock

T = TypeVar("T")
Reply = RawMessage | Any
Responder = Callable[[Any], Iterable[Reply]]

AP_CAPABILITIES, PX4_CAPABILITIES = 2, 2 | 16


class FakeLink:
    """Keeps what is sent, decoded, and lets `respond` answer."""

    id = "fake"
    ids = OwnIdentity()
    heard_until = math.inf
    """Never late, unless a test sets this."""

    def __init__(self) -> None:
        self.endpoint = parse_endpoint("udpin:127.0.0.1:14550")
        self.received = self.lost = self.bytes_received = 0
        self.bytes_per_s = 0.0
        self.sent: list[Any] = []
        self.respond: Responder = lambda _message: ()
        self.vehicle: FakeVehicle | None = None

    def subscribe(self, _callback: object, _ids: object = None) -> Callable[[], None]:
        return lambda: None

    async def caught_up(self) -> None:
        await asyncio.sleep(0)

    def send(self, message: Any, _target: object = None) -> None:
        raw = raw_message(message)
        (frame,) = FrameParser().feed(encode(raw, 253, 190, 0))
        decoded = decode(frame)
        if decoded.get_type() == "PARAM_SET":
            decoded.bits = param_bytes(frame)
        self.sent.append(decoded)
        assert self.vehicle is not None
        for reply in self.respond(decoded):
            asyncio.get_running_loop().call_soon(self.vehicle.hear, reply)

    def statistics(self, _system: int, _component: int) -> LinkStatistics:
        return LinkStatistics(
            received=self.received,
            bytes_received=self.bytes_received,
            lost=self.lost,
            bytes_per_s=self.bytes_per_s,
        )

    def sent_of(self, kind: str) -> list[Any]:
        return [message for message in self.sent if message.get_type() == kind]


def heartbeat(autopilot: int = 3, *, armed: bool = False, status: int = 3) -> Any:
    return dialect.MAVLink_heartbeat_message(2, autopilot, 209 if armed else 81, 0, status, 3)


def version(uid2: bytes = b"\x01\x02", capabilities: int = AP_CAPABILITIES) -> Any:
    return dialect.MAVLink_autopilot_version_message(
        capabilities,
        4 << 24 | 7 << 16,
        0,
        0,
        9,
        list(b"abcdef12"),
        [0] * 8,
        [0] * 8,
        1,
        2,
        0,
        list(uid2.ljust(18, b"\0")),
    )


def landed(value: int = 1) -> Any:
    return dialect.MAVLink_extended_sys_state_message(0, value)


def param_value(name: str, bits: bytes, kind: int = 9, count: int = 3, index: int = 65535) -> RawMessage:
    return RawMessage(22, struct.pack("<4sHH16sB", bits, count, index, name.encode(), kind))


def real(value: float) -> bytes:
    return struct.pack("<f", value)


def ack(command: int, result: int) -> Any:
    return dialect.MAVLink_command_ack_message(command, result, 0, 0, 253, 190)


class FakeVehicle:
    """A :class:`Vehicle` with its link and clock; disarmed on the ground for long, unless told otherwise."""

    def __init__(self, autopilot: int = 3, capabilities: int = AP_CAPABILITIES, *, ready: bool = True) -> None:
        self.clock = ManualClock(1000.0)
        self.link = FakeLink()
        self.link.vehicle = self
        self.events: list[VehicleEvent] = []
        self.autopilot = autopilot
        self.alive = True
        self.vehicle = Vehicle(cast(Link, self.link), 1, 1, heartbeat(autopilot), clock=self.clock, announce=self.told)
        self._beat_at = 0.0
        self.hear(version(capabilities=capabilities))
        if ready:
            for _ in range(4):
                self.hear(heartbeat(autopilot), landed())
                self.clock.now += 1.0
            self.hear(heartbeat(autopilot), landed())

    def told(self, vehicle: Vehicle, kind: VehicleEventKind, text: str) -> None:
        self.events.append(VehicleEvent(kind, vehicle.id, text))

    def hear(self, *messages: Reply) -> None:
        frames = []
        for message in messages:
            data = encode(raw_message(message), 1, 1, 0)
            self.link.received += 1
            self.link.bytes_received += len(data)
            frames += FrameParser().feed(data)
        self.vehicle.feed(frames, Batch(tuple(frames), self.clock.now, 0, 0))

    def advance(self, seconds: float) -> None:
        self.clock.now += seconds
        if self.alive and self.clock.now - self._beat_at >= 1.0:
            self._beat_at = self.clock.now
            self.hear(heartbeat(self.autopilot), landed())
        self.vehicle.tick()

    async def run(self, work: Coroutine[Any, Any, T], *, step: float = 0.05, limit: float = 200.0) -> T:
        """Run to the end; time passes whenever nothing else happens."""
        task = asyncio.ensure_future(work)
        until = self.clock.now + limit
        while not task.done():
            for _ in range(12):
                await asyncio.sleep(0)
            if not task.done():
                assert self.clock.now < until, "it never ends"
                self.advance(step)
        return task.result()


def delay_answers(fake: FakeVehicle, delay: Callable[[], float]) -> None:
    """Have every answer come so late as `delay` says when it is asked for."""
    answering, advance = fake.link.respond, fake.advance
    waiting: list[tuple[float, Any]] = []

    def late(message: Any) -> Iterable[Any]:
        due = fake.clock.now + delay()
        waiting.extend((due, reply) for reply in answering(message))
        return ()

    def passing(seconds: float) -> None:
        advance(seconds)
        due = [reply for at, reply in waiting if at <= fake.clock.now]
        waiting[:] = [(at, reply) for at, reply in waiting if at > fake.clock.now]
        if due:
            fake.hear(*due)

    fake.link.respond = late
    fake.advance = passing  # type: ignore[method-assign]
