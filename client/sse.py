"""Server-sent events, from the bytes of a stream (WHATWG HTML, section 9.2)."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any


class EventParser:
    """Takes a stream in pieces of any size.

    Lines end with a line feed, a carriage return, or both, and with nothing else: a text may hold every other
    character that Unicode calls a line separator.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._event: dict[str, Any] = {}
        self._data: list[str] = []

    def feed(self, piece: bytes) -> Iterator[dict[str, Any]]:
        """The messages that are complete now: ``event``, ``data`` decoded, and ``id`` if the message has one."""
        text = (self._rest + piece).replace(b"\r\n", b"\n")
        if text.endswith(b"\r"):  # its line feed may come with the next piece
            text, held = text[:-1], b"\r"
        else:
            held = b""
        *lines, rest = text.replace(b"\r", b"\n").split(b"\n")
        self._rest = rest + held
        for line in lines:
            if (message := self._take(line.decode())) is not None:
                yield message

    def _take(self, line: str) -> dict[str, Any] | None:
        if not line:
            message = {**self._event, "data": json.loads("\n".join(self._data))} if self._data else None
            self._event, self._data = {}, []
            return message
        field, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if field == "data":
            self._data.append(value)
        elif field in {"event", "id"}:
            self._event[field] = value
        return None
