"""STATUSTEXT on the wire: UTF-8 in chunks of 50 bytes, which may be cut in the middle of a character."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from mavcal.calib.wire.codec import Message

CHUNK_BYTES: Final = 50
"""A chunk that is not full is the last one of its text."""


def text_bytes(message: Message) -> bytes:
    """The bytes of a STATUSTEXT up to their end; its ``text`` is decoded already, chunk by chunk."""
    raw = getattr(message, "_text_raw", None)
    text = message.text.encode() if raw is None else bytes(raw)
    return text.split(b"\0", 1)[0][:CHUNK_BYTES]


def joined_text(pieces: Iterable[bytes]) -> str:
    """The text of its chunks in order, decoded as a whole without an incomplete last character.

    Vehicles cut a text at its greatest length, even within a character. Bytes that are no UTF-8 become U+FFFD.
    """
    raw = b"".join(pieces)
    return raw[: len(raw) - _cut_off(raw)].decode("utf-8", "replace")


def _cut_off(raw: bytes) -> int:
    """Number of bytes at the end that belong to an incomplete character."""
    for back in range(1, min(3, len(raw)) + 1):
        byte = raw[-back]
        if byte & 0xC0 == 0x80:  # a later byte of a character: look for its first
            continue
        needed = 2 if byte >> 5 == 0b110 else 3 if byte >> 4 == 0b1110 else 4 if byte >> 3 == 0b11110 else 1
        return back if needed > back else 0
    return 0
