"""Frames in a stream of bytes: where they start and end, and whether their checksum is right.

Layout (mavlink.io, "Packet serialization"): MAVLink 1 is ``FE len seq sys comp id8 payload crc16``; MAVLink 2 is
``FD len incompat compat seq sys comp id24 payload crc16 [signature13]``. The checksum is CRC-16/MCRF4XX over
everything between the magic byte and the checksum, then over one byte that stands for the message's layout.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

MAGIC_V1 = 0xFE
MAGIC_V2 = 0xFD
SIGNED = 0x01
"""The only incompatibility flag that exists: a signature follows the checksum."""

HEADER_V1, HEADER_V2, CRC_LENGTH, SIGNATURE_LENGTH = 6, 10, 2, 13
_V1 = struct.Struct("<xBBBBB")
_V2 = struct.Struct("<xBBBBBBHB")

_FOREIGN_CRC_EXTRA = {8: 117, 380: 232, 410: 160, 411: 106, 435: 134, 436: 193, 437: 30, 441: 169}
"""Messages that PX4 streams and the dialect lacks; found right on recorded frames. Checked, never decoded."""
CRC_EXTRA: Mapping[int, int] = {
    **_FOREIGN_CRC_EXTRA,
    **{key: cls.crc_extra for key, cls in dialect.mavlink_map.items()},
}
EXTRA_BYTE = {key: bytes([extra]) for key, extra in CRC_EXTRA.items()}


def _crc_uncompiled(data: bytes, initial: int = 0xFFFF) -> int:
    """CRC-16/MCRF4XX for a pymavlink without its compiled one."""
    state = dialect.x25crc()
    state.crc = initial
    state.accumulate(data)
    return int(state.crc)


crc: Callable[..., int] = dialect.mcrf4xx or _crc_uncompiled


class Frame(NamedTuple):
    """One frame as it came over the wire.

    `known` is False for a message id whose checksum byte is unknown here: nothing vouches for its content.
    """

    version: int
    sequence: int
    system: int
    component: int
    message_id: int
    incompat_flags: int
    known: bool
    raw: bytes

    @property
    def payload(self) -> bytes:
        """The payload as sent, that is without the trailing zeros that MAVLink 2 leaves out."""
        start = HEADER_V2 if self.version == 2 else HEADER_V1
        return self.raw[start : start + self.raw[1]]

    @property
    def signature(self) -> bytes | None:
        """Link id (1 byte), time stamp (6) and hash (6), or None if the frame is not signed."""
        return self.raw[-SIGNATURE_LENGTH:] if self.incompat_flags & SIGNED else None


_NO_FRAME, _BAD_CRC, _INCOMPLETE = 0, 1, 2


def cut(buffer: bytes, at: int, end: int) -> Frame | int:
    """Cut the frame that starts at `at`, or say why there is none (one of the three constants above)."""
    magic = buffer[at]
    if magic == MAGIC_V2:
        if end - at < HEADER_V2:
            return _NO_FRAME if end - at > 2 and buffer[at + 2] & ~SIGNED else _INCOMPLETE
        length, flags, _, sequence, system, component, low, high = _V2.unpack_from(buffer, at)
        if flags & ~SIGNED:
            return _NO_FRAME
        version, body = 2, at + HEADER_V2 + length
        message_id = low | high << 16
        stop = body + (CRC_LENGTH + SIGNATURE_LENGTH if flags else CRC_LENGTH)
    elif magic == MAGIC_V1:
        if end - at < HEADER_V1:
            return _INCOMPLETE
        length, sequence, system, component, message_id = _V1.unpack_from(buffer, at)
        flags, version, body = 0, 1, at + HEADER_V1 + length
        stop = body + CRC_LENGTH
    else:
        return _NO_FRAME
    if stop > end:
        return _INCOMPLETE
    extra = EXTRA_BYTE.get(message_id)
    if extra is not None and crc(extra, crc(buffer[at + 1 : body])) != buffer[body] | buffer[body + 1] << 8:
        return _BAD_CRC
    raw = buffer[at:stop]
    return Frame(version, sequence, system, component, message_id, flags, extra is not None, raw)


def next_magic(buffer: bytes, start: int, end: int) -> int:
    """First place from `start` on that holds a magic byte, or `end`."""
    new = buffer.find(b"\xfd", start, end)
    old = buffer.find(b"\xfe", start, end if new < 0 else new)
    if old >= 0:
        return old
    return end if new < 0 else new


class Plausibility:
    """Decides whether a frame whose checksum cannot be verified is one, within one buffer.

    It must be MAVLink 2 from a real system. The stream must go on in step right behind it, and no frame with a right
    checksum may start inside it. The stretch already searched is remembered, so that hostile bytes cost linear time.
    """

    __slots__ = ("_buffer", "_searched")

    def __init__(self, buffer: bytes) -> None:
        self._buffer = buffer
        self._searched = 0

    def unverified(self, start: int, stop: int, next_magic: int) -> bool:
        """Judge the frame in ``start:stop``, behind which a magic byte is expected at `next_magic`."""
        buffer, end = self._buffer, len(self._buffer)
        if stop < end and not (next_magic < end and buffer[next_magic] in (MAGIC_V1, MAGIC_V2)):
            return False
        return buffer[start] == MAGIC_V2 and buffer[start + 5] != 0 and not self._holds_known(start + 1, stop)

    def _holds_known(self, start: int, stop: int) -> bool:
        buffer, end = self._buffer, len(self._buffer)
        at = next_magic(buffer, max(start, self._searched), end)
        while at < stop:
            inner = cut(buffer, at, end)
            if isinstance(inner, Frame) and inner.known:
                self._searched = at
                return True
            at = next_magic(buffer, at + 1, end)
        self._searched = max(self._searched, stop)
        return False


class FrameParser:
    """Finds frames in bytes that arrive in any pieces, and resynchronises after bytes that are no frame.

    A parser belongs to one stream. On a datagram link use :meth:`feed_datagram`: a truncated datagram then never takes
    bytes from the next one.
    """

    __slots__ = ("_rest", "crc_errors", "skipped_bytes", "unknown")

    def __init__(self) -> None:
        self._rest = b""
        self.crc_errors = 0
        """Places that looked like a known message of complete length with a wrong checksum."""
        self.skipped_bytes = 0
        """Bytes that belong to no frame."""
        self.unknown = 0
        """Frames kept although their checksum could not be verified."""

    def feed(self, data: bytes, keep_ids: frozenset[int] | None = None) -> list[Frame]:
        """Take more bytes and return the frames now complete, in order.

        `keep_ids` leaves out other messages (they are still verified and stepped over); None keeps all.
        """
        buffer = self._rest + data if self._rest else data
        return self._scan(buffer, keep_ids, final=False)

    def feed_datagram(self, data: bytes, keep_ids: frozenset[int] | None = None) -> list[Frame]:
        """Take one whole datagram; nothing of it is kept for the next, nothing of the last one is used."""
        if self._rest:
            self.reset()
        frame = cut(data, 0, len(data)) if data else _NO_FRAME
        if isinstance(frame, Frame) and frame.known and len(frame.raw) == len(data):  # nearly always
            return [frame] if keep_ids is None or frame.message_id in keep_ids else []
        return self._scan(data, keep_ids, final=True)

    def finish(self, keep_ids: frozenset[int] | None = None) -> list[Frame]:
        """Return the frames hidden behind an incomplete one that will never be completed; forget the rest."""
        buffer, self._rest = self._rest, b""
        return self._scan(buffer, keep_ids, final=True)

    def reset(self) -> None:
        """Forget the bytes of an incomplete frame (counted as skipped); the counters stay."""
        self.skipped_bytes += len(self._rest)
        self._rest = b""

    @property
    def pending(self) -> int:
        """Bytes kept of a frame whose end has not come yet."""
        return len(self._rest)

    def _scan(self, buffer: bytes, keep_ids: frozenset[int] | None, *, final: bool) -> list[Frame]:
        frames: list[Frame] = []
        plausibility = Plausibility(buffer)
        at, end = 0, len(buffer)
        while at < end:
            frame = cut(buffer, at, end)
            if isinstance(frame, Frame):
                stop = at + len(frame.raw)
                if frame.known or plausibility.unverified(at, stop, stop):
                    self.unknown += not frame.known
                    if keep_ids is None or frame.message_id in keep_ids:
                        frames.append(frame)
                    at = stop
                    continue
            elif frame == _INCOMPLETE and not final:
                break
            elif frame == _BAD_CRC:
                self.crc_errors += 1
            step = next_magic(buffer, at + 1, end)
            self.skipped_bytes += step - at
            at = step
        self._rest = buffer[at:]
        return frames
