"""The messages of one name in a DataFlash log, column by column."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.logs.dataflash.formats import HEADER, Format

Bytes = NDArray[np.uint8]
Column = NDArray[Any]
Part = tuple[int, NDArray[np.uint32]]

ROWS: Final = 1 << 15
"""Messages gathered at once, few enough to stay in the processor's cache."""


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
        """Name of the message in the log."""
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
        self._check(names)
        return self._columns(names)

    def arrays(self, *groups: tuple[str, ...]) -> list[NDArray[np.float64]]:
        """Float arrays (N, k), one for each group of k numeric columns; errors as :meth:`columns`."""
        self._check(tuple(name for group in groups for name in group))
        return self._arrays(groups)

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def where(self, rows: NDArray[np.bool_]) -> Table:
        """The same with only those messages."""

    @property
    @abstractmethod
    def offsets(self) -> NDArray[np.int64]:
        """Positions of the messages in the file: byte or line, ascending."""

    @abstractmethod
    def _columns(self, names: tuple[str, ...]) -> list[Column]: ...

    @abstractmethod
    def _arrays(self, groups: tuple[tuple[str, ...], ...]) -> list[NDArray[np.float64]]: ...

    def _check(self, names: tuple[str, ...]) -> None:
        missing = [name for name in names if name not in self.format.columns]
        if missing:
            raise InvalidInputError(
                f"{self.name} has no column {', '.join(missing)}; it has {', '.join(self.format.columns)}"
            )


Log = Mapping[str, Table]
"""A log as its tables; ``log.get(name)`` is None where it has none."""


class BinaryTable(Table):
    """Messages of `data` at the offsets of `parts`; nothing is read until requested."""

    def __init__(self, format_: Format, units: Mapping[str, str], data: Bytes, parts: list[Part]) -> None:
        super().__init__(format_, units)
        self._data, self._parts = data, parts

    def __len__(self) -> int:
        return sum(len(part) for _, part in self._parts)

    @property
    def offsets(self) -> NDArray[np.int64]:
        """Positions of the messages in the file, bytes, ascending."""
        found, done = np.empty(len(self), dtype=np.int64), 0
        for base, part in self._parts:
            np.add(part, base, out=found[done : done + len(part)], dtype=np.int64)
            done += len(part)
        return found

    def _columns(self, names: tuple[str, ...]) -> list[Column]:
        out = [self._empty(name) for name in names]
        done = 0
        for rows in self._rows(names):
            for name, column in zip(names, out, strict=True):
                column[done : done + len(rows)] = rows[name]
            done += len(rows)
        return [self._finished(name, column) for name, column in zip(names, out, strict=True)]

    def where(self, rows: NDArray[np.bool_]) -> BinaryTable:
        """The same with only those messages."""
        ends = np.cumsum([len(part) for _, part in self._parts])
        parts = [(base, part[rows[end - len(part) : end]]) for (base, part), end in zip(self._parts, ends, strict=True)]
        return BinaryTable(self.format, self.units, self._data, parts)

    def _arrays(self, groups: tuple[tuple[str, ...], ...]) -> list[NDArray[np.float64]]:
        out = [np.empty((len(self), len(group))) for group in groups]
        done = 0
        for rows in self._rows(name for group in groups for name in group):
            with np.errstate(invalid="ignore"):  # damaged bytes may be a signalling NaN
                for group, values in zip(groups, out, strict=True):
                    for k, name in enumerate(group):
                        values[done : done + len(rows), k] = rows[name]
            done += len(rows)
        for group, values in zip(groups, out, strict=True):
            for k, name in enumerate(group):
                divisor = self.format.divisor(name)
                if divisor is not None:
                    values[:, k] /= divisor
        return out

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

    def _rows(self, names: Iterable[str]) -> Iterator[NDArray[Any]]:
        """The bytes of these columns and those between them, some thousand messages at a time."""
        whole = self.format.dtype
        fields = {name: whole.fields[name] for name in names} if whole.fields else {}
        if not fields:
            return
        first = min(offset for _, offset, *_ in fields.values())
        size = max(offset + dtype.itemsize for dtype, offset, *_ in fields.values()) - first
        layout = np.dtype(
            {
                "names": list(fields),
                "formats": [dtype for dtype, *_ in fields.values()],
                "offsets": [offset - first for _, offset, *_ in fields.values()],
                "itemsize": size,
            }
        )
        for base, part in self._parts:
            begin = base + HEADER + first
            window = np.ndarray(
                (len(self._data) - begin - size + 1,), np.dtype((np.void, size)), self._data, begin, strides=(1,)
            )
            for row in range(0, len(part), ROWS):
                yield window[part[row : row + ROWS]].view(layout)
