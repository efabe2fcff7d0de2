"""The messages of one name in a DataFlash log, column by column."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from calib.errors import InvalidInputError
from calib.logs.dataflash.formats import HEADER, Format

Bytes = NDArray[np.uint8]
Column = NDArray[Any]
Part = tuple[int, NDArray[np.uint32]]

ROWS: Final = 1 << 15
"""Messages that are gathered at once: what is copied on the way stays in the processor's cache."""


class Table(ABC):
    """All messages of one name, in the order of the file.

    ``table["AccX"]`` is a numpy array, one value a message: floats where the log scales integers, else the log's own
    type; texts are ``str``.

    Parameters
    ----------
    format_
        Its definition: name, columns, types.
    units
        Unit of each column, as far as the log says.
    """

    def __init__(self, format_: Format, units: Mapping[str, str] | None = None) -> None:
        self.format = format_
        self.units: Mapping[str, str] = units or {}

    @property
    def name(self) -> str:
        """What the log calls it."""
        return self.format.name

    @property
    def names(self) -> tuple[str, ...]:
        """Its columns."""
        return self.format.columns

    def __contains__(self, column: object) -> bool:
        return column in self.format.columns

    def __getitem__(self, column: str) -> Column:
        return self.columns(column)[0]

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
        return self._columns(names)

    @abstractmethod
    def __len__(self) -> int: ...

    @property
    @abstractmethod
    def offsets(self) -> NDArray[np.int64]:
        """Where the messages lie in the file: byte or line, ascending."""

    @abstractmethod
    def _columns(self, names: tuple[str, ...]) -> list[Column]: ...


Log = Mapping[str, Table]
"""A log as its tables; ``log.get(name)`` is None where it has none."""


class BinaryTable(Table):
    """Messages that lie in `data` behind the offsets of `parts`; nothing is read before it is asked for."""

    def __init__(self, format_: Format, units: Mapping[str, str], data: Bytes, parts: list[Part]) -> None:
        super().__init__(format_, units)
        self._data, self._parts = data, parts

    def __len__(self) -> int:
        return sum(len(part) for _, part in self._parts)

    @cached_property
    def offsets(self) -> NDArray[np.int64]:
        """Where the messages lie in the file, bytes, ascending."""
        found = [base + part.astype(np.int64) for base, part in self._parts]
        return np.concatenate(found) if found else np.empty(0, dtype=np.int64)

    def _columns(self, names: tuple[str, ...]) -> list[Column]:
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
            return np.array([text.decode("utf-8", "replace").split("\0")[0] for text in column.tolist()], dtype=str)
        return column

    def _rows(self) -> Iterator[NDArray[Any]]:
        """The messages without their headers, a few at a time."""
        dtype = self.format.dtype
        void = np.dtype((np.void, dtype.itemsize))
        if not dtype.itemsize:
            return
        for base, part in self._parts:
            room = len(self._data) - base - HEADER - dtype.itemsize + 1
            window = np.ndarray((room,), void, self._data, offset=base + HEADER, strides=(1,))
            for first in range(0, len(part), ROWS):
                yield window[part[first : first + ROWS]].view(dtype)
