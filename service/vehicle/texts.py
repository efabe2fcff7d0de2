"""STATUSTEXT: long texts come in chunks, by id and number."""

from __future__ import annotations

from dataclasses import dataclass

from mavcal.calib.wire.codec import Message
from mavcal.calib.wire.texts import CHUNK_BYTES, joined_text, text_bytes

_WAIT_S = 5.0
_MOST_WAITING = 8


@dataclass(frozen=True)
class StatusText:
    """A complete text; severity 0 (emergency) to 7 (debug), time of the monotonic clock."""

    text: str
    severity: int
    at: float


@dataclass(frozen=True)
class ChunkedText:
    """A text whose end has not come yet."""

    id: int
    severity: int
    at: float
    pieces: tuple[tuple[int, bytes], ...]

    def complete(self) -> bool:
        """True if the last chunk, which is shorter, and all before it are there."""
        numbers = [number for number, _ in self.pieces]
        last = max(self.pieces)
        return len(last[1]) < CHUNK_BYTES and numbers == list(range(len(numbers)))

    def text(self, at: float) -> StatusText:
        """The chunks that came, with a mark where one is missing."""
        pieces = dict(self.pieces)
        gap = "…".encode()
        joined = joined_text(pieces.get(number, gap) for number in range(max(pieces) + 1))
        return StatusText(joined, self.severity, at)


def add_chunk(
    waiting: tuple[ChunkedText, ...], message: Message, now: float
) -> tuple[tuple[ChunkedText, ...], tuple[StatusText, ...]]:
    """Take a STATUSTEXT; return the texts still waiting, and those now as complete as they will ever be."""
    done = [chunked.text(now) for chunked in waiting if now - chunked.at > _WAIT_S]
    waiting = tuple(chunked for chunked in waiting if now - chunked.at <= _WAIT_S)
    if message.id == 0:
        return waiting, (*done, StatusText(joined_text([text_bytes(message)]), message.severity, now))
    before = next((chunked for chunked in waiting if chunked.id == message.id), None)
    others = tuple(chunked for chunked in waiting if chunked.id != message.id)
    pieces = dict(before.pieces if before else ())
    pieces[message.chunk_seq] = text_bytes(message)
    chunked = ChunkedText(message.id, message.severity, before.at if before else now, tuple(sorted(pieces.items())))
    if chunked.complete():
        return others, (*done, chunked.text(now))
    return (*others, chunked)[-_MOST_WAITING:], tuple(done)
