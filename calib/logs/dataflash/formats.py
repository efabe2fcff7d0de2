"""FMT definitions of a DataFlash log, checked before use.

A definition names a message type, its length, its columns and one letter a column (ArduPilot ``LogStructure.h``).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

MAGIC: Final = (0xA3, 0x95)
HEADER: Final = 3
"""Two magic bytes and the type."""
FMT_TYPE: Final = 128
FMT_LENGTH: Final = 89

_CODES: Final[Mapping[str, tuple[str, float | None]]] = {
    "a": ("(32,)<i2", None),
    "b": ("i1", None),
    "B": ("u1", None),
    "g": ("<f2", None),
    "h": ("<i2", None),
    "H": ("<u2", None),
    "i": ("<i4", None),
    "I": ("<u4", None),
    "f": ("<f4", None),
    "d": ("<f8", None),
    "n": ("S4", None),
    "N": ("S16", None),
    "Z": ("S64", None),
    "c": ("<i2", 100.0),
    "C": ("<u2", 100.0),
    "e": ("<i4", 100.0),
    "E": ("<u4", 100.0),
    "L": ("<i4", 1e7),
    "M": ("u1", None),
    "q": ("<i8", None),
    "Q": ("<u8", None),
}
"""Letter: numpy code, and what the stored integer is divided by."""

_NAME: Final = re.compile(r"[A-Za-z0-9_]{1,4}")
_COLUMN: Final = re.compile(r"[A-Za-z0-9_.\[\]/ -]{1,32}")


@dataclass(frozen=True)
class Format:
    """One message type.

    Parameters
    ----------
    type, length
        The number in its header, and its bytes with the header (0 in a text log).
    name, letters, columns
        As the log says; columns without a name of their own are called ``_0``, ``_1`` ...
    """

    type: int
    name: str
    letters: str
    columns: tuple[str, ...]

    @property
    def length(self) -> int:
        """Bytes of a message with its header."""
        return HEADER + self.dtype.itemsize

    @property
    def dtype(self) -> np.dtype[Any]:
        """Layout of the bytes behind the header."""
        return np.dtype([(name, _CODES[c][0]) for name, c in zip(self.columns, self.letters, strict=True)])

    def letter(self, column: str) -> str:
        """The letter of `column`; empty if there is no such column."""
        return self.letters[self.columns.index(column)] if column in self.columns else ""

    def divisor(self, column: str) -> float | None:
        """Divisor of the stored integer; None: it is the value itself."""
        return _CODES[self.letter(column)][1]

    def is_text(self, column: str) -> bool:
        """Whether the column holds characters."""
        return self.letter(column) in "nNZ"


def define(type_: int, length: int | None, name: str, letters: str, columns: str) -> Format | None:
    """The definition if everything in it agrees, else None.

    `length` (with the header) must be what the letters add up to; None: not said. Missing column names are filled in
    and superfluous ones left out: old firmwares misstate their own FMT.
    """
    if not _NAME.fullmatch(name) or any(c not in _CODES for c in letters):
        return None
    if length is not None and length != HEADER + sum(np.dtype(_CODES[c][0]).itemsize for c in letters):
        return None
    names = [column.strip() for column in columns.split(",")] if columns.strip() else []
    if any(not _COLUMN.fullmatch(column) for column in names):
        return None
    names = names[: len(letters)] + [f"_{k}" for k in range(len(names), len(letters))]
    if len(set(names)) != len(names):
        return None
    return Format(type_, name, letters, tuple(names))


def read_fmt(payload: bytes) -> Format | None:
    """The definition in the 86 bytes behind a FMT header; None if they are none."""
    try:
        name, letters, columns = (
            part.rstrip(b"\0").decode("ascii") for part in (payload[2:6], payload[6:22], payload[22:86])
        )
    except UnicodeDecodeError:
        return None
    return define(payload[0], payload[1], name, letters, columns)


FMT: Final = Format(FMT_TYPE, "FMT", "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))
