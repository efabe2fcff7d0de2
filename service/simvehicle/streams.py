"""Times at which a requested message is due, in vehicle time, by each firmware's rule."""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass

ARDUPILOT_LOOP_S = 0.0025  # a 400 Hz main loop
# Refused if the whole milliseconds are shorter than the main loop: measured at 400 Hz, where 3 ms is granted and 2 ms
# is denied. The source was read as 0.8 of that, which would deny 3 ms.
ARDUPILOT_FASTEST_US_PER_MS = 1000
PX4_LOOP_S = 0.004
PX4_LEAD_S = 0.0009  # 0.3 of PX4's main-loop delay of 3 ms: how much too early a message may go


@dataclass
class PeriodicMessage(abc.ABC):
    """One periodic message of one link.

    Attributes:
        message_id: what is sent.
        interval: seconds of vehicle time as the firmware keeps it, after its rounding.
        interval_us: what MESSAGE_INTERVAL reads back.
    """

    message_id: int
    interval: float
    interval_us: int
    anchor: float

    @abc.abstractmethod
    def due(self, until: float) -> list[float]:
        """The times up to and including `until` at which the message is sent; each is returned once."""


class ArduPilotStream(PeriodicMessage):
    """Interval in whole milliseconds; sent by the first main loop after it has passed, without drift."""

    def due(self, until: float) -> list[float]:
        """See PeriodicMessage."""
        times: list[float] = []
        while True:
            sent = math.ceil(self.anchor / ARDUPILOT_LOOP_S - 1e-6) * ARDUPILOT_LOOP_S
            if sent > until:
                return times
            times.append(sent)
            self.anchor += self.interval


class Px4Stream(PeriodicMessage):
    """MavlinkStream::update: polled every 4 ms; keeps its phase only while less than 1.5 intervals late."""

    def due(self, until: float) -> list[float]:
        """See PeriodicMessage."""
        times: list[float] = []
        # The first poll that can send: the rest would only be polls that refuse.
        while True:
            earliest = self.anchor + self.interval - PX4_LEAD_S
            poll = (math.floor(earliest / PX4_LOOP_S + 1e-6) + 1) * PX4_LOOP_S
            if poll > until + 1e-9:
                return times
            times.append(poll)
            late = poll - self.anchor
            self.anchor = self.anchor + self.interval if late < 1.5 * self.interval else poll


def ardupilot_interval_ms(interval_us: float, loop_rate_hz: float) -> int | None:
    """The whole milliseconds that ArduPilot keeps; None if it refuses the rate as too fast."""
    interval_ms = max(int(interval_us // 1000), 1)
    if interval_ms * ARDUPILOT_FASTEST_US_PER_MS < 1e6 / loop_rate_hz:
        return None
    return interval_ms


def ardupilot_stream(message_id: int, interval_ms: int, now: float) -> ArduPilotStream:
    """A stream whose phase is that of its bucket: all messages of one interval go together."""
    interval = interval_ms * 1e-3
    return ArduPilotStream(message_id, interval, interval_ms * 1000, (math.floor(now / interval) + 1) * interval)


def px4_stream(message_id: int, interval_us: float, now: float) -> Px4Stream:
    """A stream that begins at the next poll."""
    interval = interval_us * 1e-6
    return Px4Stream(message_id, interval, int(interval_us), now - interval)
