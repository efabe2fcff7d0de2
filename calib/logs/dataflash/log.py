"""A binary DataFlash log, read on demand."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from mavcal.calib.errors import UnreadableError
from mavcal.calib.logs.dataflash.formats import Format
from mavcal.calib.logs.dataflash.scan import Index, scan
from mavcal.calib.logs.dataflash.tables import BinaryTable, Bytes, Table

PREFIXES: Final = {-1: "d", -2: "c", -3: "m", -6: "u", -9: "n", 0: ""}
"""SI prefix of a power of ten."""
NO_MULTIPLIER: Final = ("-", "?")


class DataFlash(Mapping[str, Table]):
    """A binary DataFlash log: a mapping of message names to tables of their columns.

    >>> log = DataFlash("flight.bin")  # doctest: +SKIP
    >>> log["XKF4"]["SV"].max()  # doctest: +SKIP

    Parameters
    ----------
    path_or_bytes
        The file (mapped, not read), or its content.
    names
        The messages that will be read; None: any. Fewer need less memory.

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
        return self._made(type_, self._units.get(type_, {}))

    def _made(self, type_: int, units: Mapping[str, str]) -> BinaryTable:
        return BinaryTable(self.index.formats[type_], units, self._data, self.index.parts[type_])

    @cached_property
    def _units(self) -> dict[int, dict[str, str]]:
        """Units of the columns by type, from FMTU, UNIT and MULT."""
        labels = dict(self._pairs("UNIT", "Id", "Label"))
        factors = dict(self._pairs("MULT", "Id", "Mult"))
        found = {}
        columns = (self._column("FMTU", column) for column in ("FmtType", "UnitIds", "MultIds"))
        for type_, units, multipliers in zip(*columns, strict=False):
            format_ = self.index.formats.get(type_)
            if format_ is not None:
                found[type_] = _units_of(format_, str(units), str(multipliers), labels, factors)
        return found

    def _column(self, name: str, column: str) -> list[Any]:
        types = self._types.get(name)
        if not types or column not in self.index.formats[types[0]].columns:
            return []
        return list(self._made(types[0], {})[column].tolist())

    def _pairs(self, name: str, key: str, value: str) -> list[tuple[Any, Any]]:
        return list(zip(self._column(name, key), self._column(name, value), strict=False))


def _units_of(
    format_: Format,
    units: str,
    multipliers: str,
    labels: Mapping[Any, Any],
    factors: Mapping[Any, Any],
) -> dict[str, str]:
    """Unit of each column's returned values; a column that the log scales itself is in the plain unit."""
    found = {}
    for column, unit, multiplier in zip(format_.columns, units, multipliers, strict=False):
        label = str(labels.get(ord(unit), ""))
        factor = factors.get(ord(multiplier))
        if label and multiplier not in NO_MULTIPLIER and format_.divisor(column) is None and isinstance(factor, float):
            label = _prefixed(factor, label)
        if label:
            found[column] = label
    return found


def _prefixed(factor: float, label: str) -> str:
    if not 0.0 < factor < np.inf:
        return label
    power = round(float(np.log10(factor)))
    if power in PREFIXES and abs(factor / 10.0**power - 1.0) < 1e-5:
        return PREFIXES[power] + label
    return f"{factor:g} {label}"


def _mapped(path: Path) -> Bytes:
    try:
        if not path.stat().st_size:
            raise UnreadableError(f"{path.name} is empty")
        return np.asarray(np.memmap(path, dtype=np.uint8, mode="r"))
    except OSError as error:
        raise UnreadableError(f"{path.name} cannot be opened: {error.strerror or error}") from error
