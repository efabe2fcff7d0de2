"""STATUSTEXT: long texts come in chunks of 50 bytes."""

from __future__ import annotations

from dataclasses import dataclass

from calib.wire import Message

_CHUNK = 50
_WAIT_S = 5.0


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
    pieces: tuple[tuple[int, str], ...]

    def complete(self) -> bool:
        """True if the last chunk, which is shorter, and all before it are there."""
        numbers = [number for number, _ in self.pieces]
        last = max(self.pieces)
        return len(last[1]) < _CHUNK and numbers == list(range(len(numbers)))

    def text(self, at: float) -> StatusText:
        """What has come, with a mark where a chunk is missing."""
        pieces = dict(self.pieces)
        joined = "".join(pieces.get(number, "…") for number in range(max(pieces) + 1))
        return StatusText(joined, self.severity, at)


def add_chunk(
    waiting: tuple[ChunkedText, ...], message: Message, now: float
) -> tuple[tuple[ChunkedText, ...], StatusText | None]:
    """Take a STATUSTEXT; return the texts still waiting, and a text that is now as complete as it will be."""
    overdue = next((chunked for chunked in waiting if now - chunked.at > _WAIT_S), None)
    if message.id == 0:
        return waiting, StatusText(message.text, message.severity, now)
    if overdue is not None and overdue.id != message.id:
        waiting = tuple(chunked for chunked in waiting if chunked is not overdue)
        kept, text = add_chunk(waiting, message, now)
        return (kept, text) if text else (kept, overdue.text(now))
    before = next((chunked for chunked in waiting if chunked.id == message.id and now - chunked.at <= _WAIT_S), None)
    others = tuple(chunked for chunked in waiting if chunked.id != message.id)
    pieces = dict(before.pieces if before else ())
    pieces[message.chunk_seq] = message.text
    chunked = ChunkedText(message.id, message.severity, before.at if before else now, tuple(sorted(pieces.items())))
    if chunked.complete():
        return others, chunked.text(now)
    return (*others, chunked)[-8:], None
