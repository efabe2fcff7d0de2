"""Signatures: making and checking them, and refusing replayed ones (mavlink.io, "Message signing")."""

from __future__ import annotations

import hashlib
import hmac
from typing import NamedTuple

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.wire.frames import Frame


class Signing(NamedTuple):
    """What signs one outgoing frame: a key of 32 bytes, the link id and a time stamp in 10 us since 2015."""

    key: bytes
    link_id: int
    timestamp: int


EPOCH_2015 = 1_420_070_400
"""2015-01-01 GMT as Unix time, s: signatures count from there."""


def signing_time(unix_s: float) -> int:
    """The time stamp of a signature made at that time, in 10 us since 2015."""
    return int((unix_s - EPOCH_2015) * 1e5)


def sign(frame: bytes, key: bytes, link_id: int, timestamp: int) -> bytes:
    """Append the signature block: link id, 48-bit time stamp, first 48 bits of SHA-256(key + all before).

    The frame's header must carry the flag :data:`SIGNED` already, since the checksum covers it.
    """
    block = frame + bytes([link_id]) + timestamp.to_bytes(6, "little")
    return block + hashlib.sha256(key + block).digest()[:6]


def check_signature(frame: Frame, key: bytes) -> bool:
    """True if the frame carries a signature made with this key. Says nothing about its time stamp."""
    if frame.signature is None:
        return False
    expected = hashlib.sha256(key + frame.raw[:-6]).digest()[:6]
    return hmac.compare_digest(expected, frame.raw[-6:])


class SignatureState:
    """Accepts or refuses signed frames by key and time stamp (mavlink.io, "Message signing").

    A time stamp is stored only after the hash is verified: a forged frame from the future changes nothing. Time stamps
    are in units of 10 us since 2015-01-01 GMT.
    """

    NEW_STREAM_MARGIN = 6_000_000
    """Largest lag of the first frame of a stream: one minute."""

    def __init__(self, key: bytes, timestamp: int = 0) -> None:
        if len(key) != 32:
            raise InvalidInputError(f"a signing key has 32 bytes, this one has {len(key)}")
        self._key = key
        self._streams: dict[tuple[int, int, int], int] = {}
        self.timestamp = timestamp
        """The newest time stamp sent or accepted; persist it, and hand it in again after a restart."""
        self.accepted = 0
        self.rejected = 0

    def accept(self, frame: Frame) -> bool:
        """Check a frame; store its time stamp if, and only if, it is genuine and newer than its stream."""
        block = frame.signature
        genuine = block is not None and check_signature(frame, self._key) and self._newer(frame, block)
        if genuine:
            self.accepted += 1
        else:
            self.rejected += 1
        return genuine

    def _newer(self, frame: Frame, block: bytes) -> bool:
        stream = (block[0], frame.system, frame.component)
        stamp = int.from_bytes(block[1:7], "little")
        last = self._streams.get(stream)
        if stamp <= last if last is not None else stamp + self.NEW_STREAM_MARGIN < self.timestamp:
            return False
        self._streams[stream] = stamp
        self.timestamp = max(self.timestamp, stamp)
        return True

    def next_signing(self, link_id: int, now: int) -> Signing:
        """Signing of the next outgoing frame, with a time stamp not used before."""
        self.timestamp = max(self.timestamp + 1, now)
        return Signing(self._key, link_id, self.timestamp)
