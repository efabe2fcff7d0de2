"""A port between a vehicle and us that carries so much and holds so much: samples and answers go through one queue."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import encode, raw_message
from tests.unit.vehicle.fake import FakeVehicle, ack

IMU, IMU2, RAW = 26, 116, 27

_MAKE: dict[int, Callable[[float], Any]] = {
    IMU: lambda t: dialect.MAVLink_scaled_imu_message(round(t * 1e3), *[1] * 10),
    IMU2: lambda t: dialect.MAVLink_scaled_imu2_message(round(t * 1e3), *[1] * 10),
    RAW: lambda t: dialect.MAVLink_raw_imu_message(round(t * 1e6), *[1] * 11),
}


class Ported:
    """A vehicle behind a port. `bytes_per_s` 0: all is carried at once.

    Streams begin `start_s` after they are asked for, and only every one in `1 - share` is sent. `loss` is lost on the
    way, whatever is asked for. Our own process runs only in the first `awake` of every half second.
    """

    def __init__(
        self,
        fake: FakeVehicle,
        *,
        bytes_per_s: float = 0.0,
        buffer_bytes: float = 512.0,
        start_s: float = 0.0,
        share: float = 1.0,
        loss: float = 0.0,
        awake: float = 1.0,
        speed: float = 1.0,
    ) -> None:
        self.fake = fake
        self.bytes_per_s, self.buffer_bytes, self.start_s = bytes_per_s, buffer_bytes, start_s
        self.share, self.loss, self.awake, self.speed = share, loss, awake, speed
        self.intervals = {IMU: -1, IMU2: -1, RAW: -1}
        self._due: dict[int, float] = {}
        self._free = 0.0
        self._coming: list[tuple[float, Any]] = []
        self._heard: list[Any] = []
        self._random = random.Random(5)
        self._pass = fake.advance
        fake.link.respond = self.respond
        fake.advance = self.advance  # type: ignore[method-assign]

    def respond(self, message: Any) -> Iterable[Any]:
        if message.get_type() != "COMMAND_LONG" or message.command not in (510, 511):
            return []
        number, now = int(message.param1), self.fake.clock.now
        if message.command == 510:
            told = [ack(510, 0), dialect.MAVLink_message_interval_message(number, self.intervals.get(number, 0))]
        else:
            if self.intervals[number] <= 0:
                self._due[number] = now + self.start_s
            self.intervals[number] = int(message.param2)
            told = [ack(511, 0)]
        for one in told:
            self._send(one, now)
        return []

    def _send(self, message: Any, now: float) -> None:
        size = len(encode(raw_message(message), 1, 1, 0))
        at = now
        if self.bytes_per_s:
            self._free = at = max(self._free, now) + size / self.bytes_per_s
        self._coming.append((at, message))

    def _full(self, now: float) -> bool:
        return self.bytes_per_s > 0 and (self._free - now) * self.bytes_per_s > self.buffer_bytes

    def advance(self, seconds: float) -> None:
        now = self.fake.clock.now + seconds
        due = sorted(
            (at, number)
            for number, interval in self.intervals.items()
            if interval > 0
            for at in self._times(number, interval / 1e6 / self.share / self.speed, now)
        )
        room = {}
        for at, number in due:  # all of an instant or none: no stream is served before the others
            if room.setdefault(at, not self._full(at)):
                self._send(_MAKE[number](at * self.speed), at)
        self._pass(seconds)
        if now % 0.5 < 0.5 * self.awake or self.awake >= 1:
            come = sorted((one for one in self._coming if one[0] <= now), key=lambda one: one[0])
            self._coming = [one for one in self._coming if one[0] > now]
            for _, message in come:
                if self._random.random() < self.loss:
                    self.fake.link.lost += 1
                else:
                    self.fake.hear(message)

    def _times(self, number: int, step: float, until: float) -> Iterable[float]:
        due = self._due[number]
        while due <= until:
            yield due
            due += step
        self._due[number] = due


def requests(fake: FakeVehicle) -> list[tuple[int, int]]:
    """Message and interval of every request for a stream."""
    return [(int(m.param1), int(m.param2)) for m in fake.link.sent_of("COMMAND_LONG") if m.command == 511]
