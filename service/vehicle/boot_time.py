"""The time since boot that messages carry."""

from __future__ import annotations

import struct

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire import Frame, padded_payload


def _offsets() -> dict[int, int]:
    """Where ``time_boot_ms`` is in the payload of each message that has one."""
    offsets = {}
    for message_id, cls in dialect.mavlink_map.items():
        names = cls.ordered_fieldnames
        if "time_boot_ms" in names:
            at = names.index("time_boot_ms")
            if not any(cls.array_lengths[:at]):
                offsets[message_id] = struct.calcsize("<" + cls.native_format.decode()[1 : 1 + at])
    return offsets


_OFFSETS = _offsets()
BOOT_TIME_IDS = frozenset(_OFFSETS)


def boot_time(frame: Frame) -> float | None:
    """Seconds since the vehicle's start, or None if this message does not say."""
    offset = _OFFSETS.get(frame.message_id)
    if offset is None:
        return None
    return int.from_bytes(padded_payload(frame, offset + 4)[offset:], "little") / 1000.0
