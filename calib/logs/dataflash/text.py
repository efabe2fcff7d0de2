"""DataFlash logs as text, as old firmwares and ground stations print them: a message a line, numbers already scaled."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import UnreadableError
from mavcal.calib.logs.dataflash.formats import Format, define
from mavcal.calib.logs.dataflash.tables import Column, Table

WHOLE: Final = "bBhHiIqQ"
LONGEST_LINE: Final = 4096


class TextTable(Table):
    """Messages of one name in a text log."""

    def __init__(self, format_: Format, lines: NDArray[np.int64], cells: list[tuple[float | str, ...]]) -> None:
        super().__init__(format_)
        self._lines, self._cells = lines, cells

    def __len__(self) -> int:
        return len(self._cells)

    @property
    def offsets(self) -> NDArray[np.int64]:
        """Line numbers of the messages, from 0."""
        return self._lines

    def where(self, rows: NDArray[np.bool_]) -> TextTable:
        """The same with only those messages."""
        cells = [row for row, wanted in zip(self._cells, rows, strict=True) if wanted]
        return TextTable(self.format, self._lines[rows], cells)

    def _arrays(self, groups: tuple[tuple[str, ...], ...]) -> list[NDArray[np.float64]]:
        return [np.column_stack(self._columns(group)).astype(np.float64) for group in groups]

    def _columns(self, names: tuple[str, ...]) -> list[Column]:
        wanted = [self.format.columns.index(name) for name in names]
        return [self._typed(name, [row[k] for row in self._cells]) for name, k in zip(names, wanted, strict=True)]

    def _typed(self, name: str, values: list[float | str]) -> Column:
        if self.format.is_text(name) or any(isinstance(value, str) for value in values):
            return np.array([str(value) for value in values], dtype=str)
        column = np.array(values, dtype=np.float64)
        if self.format.letter(name) in WHOLE and np.isfinite(column).all() and (np.abs(column) < 2**53).all():
            return column.astype(np.int64)
        return column


class TextLog(Mapping[str, Table]):
    """A text log as its tables; `skipped` lines belong to no defined message, or contradict its definition.

    Raises
    ------
    UnreadableError
        If no line defines a message (FMT).
    """

    def __init__(self, content: bytes, source: str, names: Collection[str] | None = None) -> None:
        self.source = source
        self.skipped = 0
        self.lines = 0
        formats: dict[str, Format] = {}
        cells: dict[str, list[tuple[float | str, ...]]] = {}
        places: dict[str, list[int]] = {}
        for number, raw in enumerate(content.splitlines()):
            self.lines += 1
            name, comma, rest = raw[:LONGEST_LINE].decode("utf-8", "replace").partition(",")
            name = name.strip()
            if name == "FMT":
                made = _definition(rest)
                if made is not None:
                    formats.setdefault(made.name, made)
                continue
            if not comma or (names is not None and name not in names and name in formats):
                continue
            row = _row(formats[name], rest) if name in formats else None
            if row is None:
                self.skipped += 1
                continue
            cells.setdefault(name, []).append(row)
            places.setdefault(name, []).append(number)
        if not formats:
            raise UnreadableError(
                f"{source} defines no message (no line begins with FMT): it is no DataFlash log, or of a firmware "
                "older than 2013, whose columns have no names"
            )
        self._tables = {
            name: TextTable(formats[name], np.array(places[name], dtype=np.int64), rows) for name, rows in cells.items()
        }

    def __getitem__(self, name: str) -> Table:
        return self._tables[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._tables)

    def __len__(self) -> int:
        return len(self._tables)


def _definition(rest: str) -> Format | None:
    parts = [part.strip() for part in rest.split(",", 4)]
    if len(parts) < 4 or not parts[0].isdecimal():
        return None
    return define(int(parts[0]), None, parts[2], parts[3], parts[4] if len(parts) > 4 else "")


def _row(format_: Format, rest: str) -> tuple[float | str, ...] | None:
    """The cells of one line; None if they contradict the definition."""
    columns = len(format_.columns)
    parts = rest.split(",", max(columns - 1, 0)) if format_.letters[-1:] == "Z" else rest.split(",")
    if len(parts) != columns:
        return None
    row: list[float | str] = []
    for letter, part in zip(format_.letters, parts, strict=True):
        text = part.strip()
        try:
            row.append(text if letter in "nNZ" else float(text))
        except ValueError:
            if letter != "M":  # the mode may stand there by its name
                return None
            row.append(text)
    return tuple(row)
