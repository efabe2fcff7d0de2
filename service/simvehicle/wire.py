"""Frames in bytes: packing with a sequence number of each link, and reading what a ground station sends.

Only pymavlink's dialect module is used. Input without a valid checksum is silently dropped, as in the firmwares.
"""

from __future__ import annotations

import hashlib
import math
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

MAGIC_V1, MAGIC_V2 = 0xFE, 0xFD
SIGNATURE_LENGTH = 13
MAX_BUFFER = 4096
INT32_MAX = 2147483647
FORCED = 21196
"""Param 2 of MAV_CMD_COMPONENT_ARM_DISARM that skips the checks."""


@dataclass(frozen=True)
class Received:
    """One message that arrived intact: the decoded message, its full-length payload and where it came from."""

    message: Any
    payload: bytes
    system: int
    component: int
    frame: bytes = b""

    @property
    def name(self) -> str:
        """Message name such as PARAM_SET."""
        return str(self.message.get_type())


class Signer:
    """Signs outgoing frames with the vehicle's key, if it has one, and accepts newer frames signed with it.

    Format (mavlink.io, "Message signing"): 13 bytes follow the checksum. They are the link id, 48 bits of 10 us since
    2015, and the first 48 bits of the SHA-256 of key, frame, link id and time.
    """

    def __init__(self, key: bytes = b"") -> None:
        self.key = key
        self._time = int((time.time() - 1_420_070_400) * 1e5)
        self._heard: dict[tuple[int, int, int], int] = {}

    def signed(self, frame: bytes, crc_extra: int) -> bytes:
        """The frame with a signature, or unchanged while there is no key."""
        if not self.key:
            return frame
        head = frame[:2] + bytes([frame[2] | dialect.MAVLINK_IFLAG_SIGNED]) + frame[3:-2]
        crc = dialect.x25crc(head[1:] + bytes([crc_extra])).crc
        self._time = max(self._time + 1, int((time.time() - 1_420_070_400) * 1e5))
        whole = head + struct.pack("<H", crc) + b"\x01" + self._time.to_bytes(6, "little")
        return whole + hashlib.sha256(self.key + whole).digest()[:6]

    def believes(self, frame: bytes) -> bool:
        """Whether it is signed with the key, and newer than what the same sender signed before."""
        if not self.key:
            return True
        if len(frame) < 25 or frame[0] != MAGIC_V2 or not frame[2] & dialect.MAVLINK_IFLAG_SIGNED:
            return False
        if hashlib.sha256(self.key + frame[:-6]).digest()[:6] != frame[-6:]:
            return False
        stream, stamp = (frame[-13], frame[5], frame[6]), int.from_bytes(frame[-12:-6], "little")
        if stamp <= self._heard.get(stream, 0):
            return False
        self._heard[stream] = stamp
        return True


class Packer:
    """Packs messages of one vehicle for one link."""

    def __init__(self, system: int, component: int = 1, *, signer: Signer | None = None) -> None:
        self.system, self.component = system, component
        self._mav = dialect.MAVLink(None, system, component)
        self._signer = signer or Signer()

    def pack(self, message: Any) -> bytes:
        """One complete MAVLink 2 frame."""
        frame: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return self._signer.signed(frame, message.crc_extra)

    def pack_payload(self, message_class: Any, payload: bytes) -> bytes:
        """A frame from a payload in wire order, for values that a Python float would alter (int32 in a float field)."""
        body = payload.rstrip(b"\0") or b"\0"
        identifier = message_class.id
        header = struct.pack(
            "<BBBBBBBHB",
            MAGIC_V2,
            len(body),
            0,
            0,
            self._mav.seq,
            self.system,
            self.component,
            identifier & 0xFFFF,
            identifier >> 16,
        )
        self._mav.seq = (self._mav.seq + 1) % 256
        crc = dialect.x25crc(header[1:] + body + bytes([message_class.crc_extra])).crc
        return self._signer.signed(header + body + struct.pack("<H", crc), message_class.crc_extra)


class Splitter:
    """Finds intact frames in bytes. One per datagram, or one for the life of a TCP connection."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes, *, final: bool = False) -> Iterator[Received]:
        """Every intact message that the bytes so far complete; `final`: nothing will follow, so nothing is awaited."""
        self._buffer += data
        while True:
            start = self._next_magic()
            if start is None:
                return
            del self._buffer[:start]
            length = _frame_length(self._buffer)
            if length is None or len(self._buffer) < length:
                if not final and len(self._buffer) <= MAX_BUFFER:
                    return
                del self._buffer[0]
                continue
            received = decode_frame(bytes(self._buffer[:length]))
            # A false magic number inside damaged bytes must not swallow the good frame behind it.
            del self._buffer[: length if received is not None else 1]
            if received is not None:
                yield received

    def _next_magic(self) -> int | None:
        positions = [p for p in (self._buffer.find(MAGIC_V1), self._buffer.find(MAGIC_V2)) if p >= 0]
        if positions:
            return min(positions)
        self._buffer.clear()
        return None


def _frame_length(buffer: bytearray) -> int | None:
    if len(buffer) < 3:
        return None
    if buffer[0] == MAGIC_V1:
        return int(buffer[1]) + 8
    signed = SIGNATURE_LENGTH if buffer[2] & dialect.MAVLINK_IFLAG_SIGNED else 0
    return int(buffer[1]) + 12 + signed


def message_id_of(frame: bytes) -> int:
    """The message id in a frame's header."""
    return int.from_bytes(frame[7:10], "little") if frame[0] == MAGIC_V2 else frame[5]


def decode_frame(frame: bytes) -> Received | None:
    """One whole frame; None where its id is unknown or its checksum does not hold."""
    v2 = frame[0] == MAGIC_V2
    header = 10 if v2 else 6
    message_class = dialect.mavlink_map.get(message_id_of(frame))
    if message_class is None:
        return None
    end = header + frame[1]
    crc = dialect.x25crc(frame[1:end] + bytes([message_class.crc_extra])).crc
    if crc != int.from_bytes(frame[end : end + 2], "little"):
        return None
    full = message_class.unpacker.size
    payload = frame[header:end][:full].ljust(full, b"\0")
    try:
        message = dialect.MAVLink(None).decode(bytearray(frame))
    except (dialect.MAVError, struct.error, UnicodeDecodeError):
        return None
    system, component = (frame[5], frame[6]) if v2 else (frame[3], frame[4])
    return Received(message, payload, system, component, frame)


def split_datagram(data: bytes) -> list[Received]:
    """The intact messages of one datagram; a truncated last frame is lost, as on a real link."""
    return list(Splitter().feed(data, final=True))


def command_parameters(received: Received) -> list[float]:
    """The seven parameters of COMMAND_LONG or COMMAND_INT.

    NaN, "not given", becomes 0, and values beyond int32 are clipped: the firmwares' casts would be undefined.
    """
    m = received.message
    if received.name == "COMMAND_INT":
        values = [m.param1, m.param2, m.param3, m.param4, m.x, m.y, m.z]
    else:
        values = [m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7]
    return [0.0 if math.isnan(v) else float(min(max(v, -INT32_MAX), INT32_MAX)) for v in values]
