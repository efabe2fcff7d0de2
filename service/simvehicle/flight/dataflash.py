"""A DataFlash log, message by message: definitions (FMT) first, then two magic bytes, a type and the packed values.

``LogStructure.h``; the letters c C e E L hold whole hundredths (of degrees, metres ...) and ten-millionths.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

_MAGIC = b"\xa3\x95"
_FMT = 128
_LETTERS: Mapping[str, str] = {
    "b": "b", "B": "B", "h": "h", "H": "H", "i": "i", "I": "I", "f": "f", "d": "d", "n": "4s", "N": "16s", "Z": "64s",
    "c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "M": "B", "q": "q", "Q": "Q",
}  # fmt: skip
_SCALED: Mapping[str, float] = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}
_TEXTS = "nNZ"


class Message:
    """One kind of message: its number, name, letters and columns."""

    def __init__(self, number: int, name: str, letters: str, columns: str) -> None:
        self.number, self.name, self.letters, self.columns = number, name, letters, columns
        self._packer = struct.Struct("<" + "".join(_LETTERS[letter] for letter in letters))
        self._head = _MAGIC + bytes([number])
        self._scaled = tuple((k, _SCALED[letter]) for k, letter in enumerate(letters) if letter in _SCALED)
        self._texts = tuple(k for k, letter in enumerate(letters) if letter in _TEXTS)

    def packed(self, *values: Any) -> bytes:
        """The bytes of one message; scaled letters take the value itself."""
        if self._scaled or self._texts:
            row = list(values)
            for k, factor in self._scaled:
                row[k] = round(row[k] * factor)
            for k in self._texts:
                row[k] = row[k].encode("ascii", "replace")
            values = tuple(row)
        return self._head + self._packer.pack(*values)

    @property
    def definition(self) -> tuple[int, int, str, str, str]:
        """The values of its FMT message."""
        return self.number, 3 + self._packer.size, self.name, self.letters, self.columns


FMT = Message(_FMT, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")


class DataFlashWriter:
    """A file that begins with the definitions of `messages`."""

    def __init__(self, path: Path, messages: tuple[Message, ...]) -> None:
        self._file: BinaryIO = path.open("wb")
        for message in (FMT, *messages):
            self._file.write(FMT.packed(*message.definition))

    def write(self, message: Message, *values: Any) -> None:
        """One message."""
        self._file.write(message.packed(*values))

    def flush(self) -> None:
        """Write buffered messages to the file."""
        self._file.flush()

    def close(self) -> None:
        """Close the file; harmless if repeated."""
        self._file.close()
