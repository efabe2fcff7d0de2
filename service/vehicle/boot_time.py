"""Time stamps of messages: they show a restart, and whether two links lead to one vehicle."""

from __future__ import annotations

import statistics
import struct
from collections import deque

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import padded_payload
from mavcal.calib.wire.frames import Frame

_BACK_S = 1.0
_REBOOT_STAMPS = 3
"""Number of older stamps in a row; fewer are late messages."""
_KEPT = 8
_APART_S = 0.2
"""Least spacing of the time stamps kept for comparison, s."""
_LEAST_SPAN_S = 0.5
"""Shortest time over which the speed of a clock is judged, s; a simulated vehicle's may run faster than ours."""
_COMPARED = 3
_FAR_S = 5.0


def _offsets(field: str) -> dict[int, int]:
    """Byte offset of this field in the payload of each message that has it."""
    offsets = {}
    for message_id, cls in dialect.mavlink_map.items():
        names = cls.ordered_fieldnames
        if field in names:
            at = names.index(field)
            if not any(cls.array_lengths[:at]):
                offsets[message_id] = struct.calcsize("<" + cls.native_format.decode()[1 : 1 + at])
    return offsets


_OFFSETS = _offsets("time_boot_ms")
_OFFSETS_US = _offsets("time_usec")
BOOT_TIME_IDS = frozenset(_OFFSETS)


def boot_time(frame: Frame) -> float | None:
    """Seconds since the vehicle's start, or None if this message does not say."""
    offset = _OFFSETS.get(frame.message_id)
    if offset is None:
        return None
    return int.from_bytes(padded_payload(frame, offset + 4)[offset:], "little") / 1000.0


def own_time(frame: Frame) -> float | None:
    """Seconds by a clock of the vehicle, for differences between messages of one kind; None if it does not say.

    RAW_IMU and HIGHRES_IMU carry microseconds (FLIGHT_CONTROLLERS 2).
    """
    offset = _OFFSETS_US.get(frame.message_id)
    if offset is None:
        return boot_time(frame)
    return int.from_bytes(padded_payload(frame, offset + 8)[offset : offset + 8], "little") / 1e6


class BootClock:
    """A vehicle's time since its start, as it comes over one link.

    Links differ in delay: stamps of one link are compared with each other, never one by one with those of another.
    """

    def __init__(self) -> None:
        self.latest: float | None = None
        """The latest stamp, s; None: none has come."""
        self.restarts = 0
        """How many restarts this clock has seen."""
        self._backwards = 0
        self._stamps: deque[tuple[float, float]] = deque(maxlen=_KEPT)

    def see(self, stamp: float, at: float) -> bool:
        """Record a time stamp that arrived at `at`; True if it shows a restart.

        A single late message is no restart: several in a row must come from before.
        """
        restarted = False
        if self.latest is not None and stamp < self.latest - _BACK_S:
            self._backwards += 1
            if self._backwards < _REBOOT_STAMPS:
                return False
            self._stamps.clear()
            self.restarts += 1
            self.latest, restarted = stamp, True
        self.latest = stamp if self.latest is None else max(stamp, self.latest)
        self._backwards = 0
        if not self._stamps or at - self._stamps[-1][0] >= _APART_S:
            self._stamps.append((at, stamp))
        return restarted

    def forget(self) -> None:
        """Start anew with the next time stamp: after a long silence the vehicle may have restarted."""
        self.latest, self._backwards = None, 0
        self._stamps.clear()

    def ahead_of(self, other: BootClock) -> float | None:
        """Lead of this clock over another one of the same vehicle, s of our clock.

        None: too little was heard of one of them. The delay of the other link counts as well.
        """
        speeds = [clock._speed() for clock in (self, other)]
        if speeds[0] is None or speeds[1] is None:
            return None
        speed = max(speeds[0], speeds[1])
        found = []
        for at, stamp in list(self._stamps)[-_COMPARED:]:
            when, beside = min(other._stamps, key=lambda one: abs(one[0] - at))
            if abs(when - at) <= _FAR_S:
                found.append((stamp - beside) / speed - (at - when))
        return statistics.median(found) if found else None

    def _speed(self) -> float | None:
        """Seconds of the vehicle in one of ours; 1 but for simulated vehicles."""
        if len(self._stamps) < 2:
            return None
        (first, start), (last, end) = self._stamps[0], self._stamps[-1]
        if last - first < _LEAST_SPAN_S:
            return None
        return max((end - start) / (last - first), 0.1)
