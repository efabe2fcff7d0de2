"""The unique id of a flight controller, as AUTOPILOT_VERSION gives it."""

from __future__ import annotations

from typing import Final


def _uid(text: bytes) -> int:
    """Words 1 and 2 of a BOARD_OVERRIDE_UUID."""
    return int.from_bytes(text[4:8], "little") << 32 | int.from_bytes(text[8:12], "little")


SIMULATION_UID: Final = _uid(b"SIMULATIONID0000")
SHARED_UIDS: Final = (
    SIMULATION_UID,
    *map(_uid, (b"RPIID00000000000", b"MODALAIVOXL20000", b"BBBLUEID00000000", b"BRNAVID000000000")),
)
"""The uid that PX4 gives where a board has none of its own (boards/*/src/board_config.h, mavlink_main.cpp)."""
_SYSTEMS: Final = 0xFF


def is_simulation_id(uid: int) -> bool:
    """Whether it is the uid of PX4's simulator, which adds its system id less one (mavlink_main.cpp)."""
    return 0 <= uid - SIMULATION_UID <= _SYSTEMS


def unit_id(autopilot: str | None, uid2: bytes, uid: int) -> str | None:
    """Hexadecimal, trailing zeros cut; None for what is no unit's own: zero, ones, an id that boards of a kind share.

    PX4's simulator adds its system id less one to both numbers (mavlink_main.cpp, send_autopilot_capabilities): two of
    them with one system id say the same.
    """
    significant = uid2[1:] if autopilot == "px4" else uid2
    if any(significant) and set(uid2) != {0xFF}:
        return uid2.rstrip(b"\0").hex()
    shared = any(0 <= uid - base <= _SYSTEMS for base in SHARED_UIDS)
    return f"{uid:016x}" if uid and not shared else None
