"""A DataFlash log as tables of columns, read only as far as they are asked for."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from calib.errors import InvalidInputError, UnreadableError
from calib.logs.dataflash.formats import HEADER, Format
from calib.logs.dataflash.scan import Bytes, Index, scan

Column = NDArray[Any]

ROWS: Final = 1 << 16
"""Messages that are gathered at once: what is copied on the way stays in the processor's cache."""
MICRO: Final = 1e-6
PREFIXES: Final = {1e-1: "d", 1e-2: "c", 1e-3: "m", 1e-6: "u", 1e-9: "n"}


class Table:
    """All messages of one name, column by column.

    ``table["AccX"]`` is a numpy array, one value a message in the order of the file: floats where the log scales
    integers, else the log's own type; texts are ``str``. ``table.units`` says in what.
    """

    def __init__(self, format_: Format, data: Bytes, parts: list[tuple[int, NDArray[np.uint32]]]) -> None:
        self.format = format_
        self.units: dict[str, str] = {}
        self._data, self._parts = data, parts

    @property
    def name(self) -> str:
        """What the log calls it."""
        return self.format.name

    @property
    def names(self) -> tuple[str, ...]:
        """Its columns."""
        return self.format.columns

    def __len__(self) -> int:
        return sum(len(part) for _, part in self._parts)

    def __contains__(self, column: str) -> bool:
        return column in self.format.columns

    def __getitem__(self, column: str) -> Column:
        return self.columns(column)[0]

    @cached_property
    def offsets(self) -> NDArray[np.int64]:
        """Where the messages lie in the file."""
        found = [base + part.astype(np.int64) for base, part in self._parts]
        return np.concatenate(found) if found else np.empty(0, dtype=np.int64)

    def columns(self, *names: str) -> list[Column]:
        """Several columns at once, which is faster than one after the other.

        Raises
        ------
        InvalidInputError
            If the messages have no such column.
        """
        missing = [name for name in names if name not in self.format.columns]
        if missing:
            raise InvalidInputError(
                f"{self.name} has no column {', '.join(missing)}; it has {', '.join(self.format.columns)}"
            )
        out = [self._empty(name) for name in names]
        done = 0
        for rows in self._rows():
            for name, column in zip(names, out, strict=True):
                column[done : done + len(rows)] = rows[name]
            done += len(rows)
        return [self._finished(name, column) for name, column in zip(names, out, strict=True)]

    def _empty(self, name: str) -> Column:
        dtype = self.format.dtype[name]
        if self.format.divisor(name) is not None:
            return np.empty(len(self))
        return np.empty((len(self), *dtype.shape), dtype.base)

    def _finished(self, name: str, column: Column) -> Column:
        divisor = self.format.divisor(name)
        if divisor is not None:
            column /= divisor
        elif self.format.is_text(name):
            return np.char.decode(column, "utf-8", "replace") if len(column) else column.astype(str)
        return column

    def _rows(self) -> Iterator[NDArray[Any]]:
        """The messages without their headers, a few at a time."""
        dtype = self.format.dtype
        if not dtype.itemsize:
            return
        for base, part in self._parts:
            room = len(self._data) - base - HEADER - dtype.itemsize + 1
            window = np.ndarray(
                (room,), np.dtype((np.void, dtype.itemsize)), self._data, offset=base + HEADER, strides=(1,)
            )
            for first in range(0, len(part), ROWS):
                yield window[part[first : first + ROWS]].view(dtype)


Log = Mapping[str, Table]
"""A log as its tables; ``log.get(name)`` is None where it has none."""


class DataFlash(Mapping[str, Table]):
    """A binary DataFlash log: a mapping of message names to :class:`Table` s.

    >>> log = DataFlash("flight.bin")  # doctest: +SKIP
    >>> log["XKF4"]["SV"].max()  # doctest: +SKIP

    Parameters
    ----------
    path_or_bytes
        The file (mapped, not read), or its content.
    names
        The messages that will be asked for; None: any. Fewer need less memory.

    Raises
    ------
    UnreadableError
        If it cannot be opened, or no message of a DataFlash log is in it.
    """

    def __init__(self, path_or_bytes: Path | str | bytes, names: Collection[str] | None = None) -> None:
        if isinstance(path_or_bytes, bytes):
            self.source = "the log"
            self._data: Bytes = np.frombuffer(path_or_bytes, dtype=np.uint8)
        else:
            self.source = Path(path_or_bytes).name
            self._data = _mapped(Path(path_or_bytes))
        self.index: Index = scan(self._data, names)
        if len(self.index.formats) < 2:
            raise UnreadableError(
                f"{self.source} ({len(self._data)} bytes) holds no definition of a message: it is no DataFlash log, or "
                "its beginning is missing; download it from the vehicle again"
            )
        self._types: dict[str, list[int]] = {}
        for type_, format_ in self.index.formats.items():
            if self.index.parts.get(type_):
                self._types.setdefault(format_.name, []).append(type_)

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return len(self._data)

    def __getitem__(self, name: str) -> Table:
        return self.table(name)

    def __contains__(self, name: object) -> bool:
        return name in self._types

    def __iter__(self) -> Iterator[str]:
        return iter(self._types)

    def __len__(self) -> int:
        return len(self._types)

    def table(self, name: str) -> Table:
        """All messages called `name`; of several definitions of that name the one with most messages.

        Raises
        ------
        KeyError
            If the log has none.
        """
        type_ = max(self._types[name], key=lambda number: int(self.index.counts[number]))
        return Table(self.index.formats[type_], self._data, self.index.parts[type_])


def _mapped(path: Path) -> Bytes:
    try:
        if not path.stat().st_size:
            raise UnreadableError(f"{path.name} is empty")
        return np.memmap(path, dtype=np.uint8, mode="r")
    except OSError as error:
        raise UnreadableError(f"{path.name} cannot be opened: {error.strerror or error}") from error
