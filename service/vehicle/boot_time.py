"""The times that messages carry: since boot, or by any clock of the vehicle."""

from __future__ import annotations

import struct

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire import Frame, padded_payload


def _offsets(field: str) -> dict[int, int]:
    """Where this field is in the payload of each message that has it."""
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
