"""A vehicle's parameters: types, values, saved values, and values in force."""

from __future__ import annotations

import csv
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np

from mavcal.service.simvehicle.errors import ConfigurationError
from mavcal.service.simvehicle.rotation import Array

NAME_LENGTH = 16
AXES = ("X", "Y", "Z")


class ParameterType(IntEnum):
    """MAV_PARAM_TYPE of the values that the firmwares use."""

    INT8 = 2
    UINT16 = 3
    INT16 = 4
    UINT32 = 5
    INT32 = 6
    REAL32 = 9


Value = float | int


@dataclass
class SimParameter:
    """One parameter: its value is a float rounded to float32, or an int."""

    name: str
    kind: ParameterType
    value: Value
    default: Value
    listed: bool = True

    @property
    def is_float(self) -> bool:
        """Whether the value is a float32."""
        return self.kind is ParameterType.REAL32


def float32(value: float) -> float:
    """The nearest float32 as a Python float; overflow becomes infinite as in C."""
    with np.errstate(over="ignore"):
        return float(np.float32(value))


class ParameterTable:
    """All parameters of one vehicle in the order in which they are listed."""

    def __init__(self, parameters: Iterable[SimParameter], visible: Callable[[str], bool] = lambda _: True) -> None:
        self._by_name = {p.name: p for p in parameters}
        self._visible = visible
        self.saved: dict[str, Value] = {name: p.value for name, p in self._by_name.items()}
        self.version = 0
        self._pinned: dict[str, Value] = {}
        self._listing: list[SimParameter] | None = None
        self._index: dict[str, int] = {}

    def replace_all(self, parameters: Iterable[SimParameter], *, by_name: bool = False) -> None:
        """Hold these parameters instead, in this order or by name; ones that they do not name stay, unlisted."""
        given = {p.name: p for p in parameters}
        for name, parameter in self._by_name.items():
            if name not in given:
                parameter.listed = False
        rest = {name: p for name, p in self._by_name.items() if name not in given}
        self._by_name.clear()
        everything = given | rest
        self._by_name.update(sorted(everything.items()) if by_name else everything.items())
        self.saved = {name: p.value for name, p in self._by_name.items()}
        self._listing = None
        self.version += 1

    def mapping(self) -> dict[str, SimParameter]:
        """The live parameters by name."""
        return self._by_name

    def __contains__(self, name: str) -> bool:
        return name in self._by_name

    def __getitem__(self, name: str) -> SimParameter:
        return self._by_name[name]

    def __iter__(self) -> Iterator[SimParameter]:
        return iter(self._by_name.values())

    def get(self, name: str, default: float = 0.0) -> float:
        """The value in force of a parameter as a float; `default` if the vehicle has none of that name."""
        if name in self._pinned:
            return float(self._pinned[name])
        parameter = self._by_name.get(name)
        return default if parameter is None else float(parameter.value)

    def vector(self, base: str, default: float = 0.0) -> Array:
        """The values in force of base_X, base_Y, base_Z."""
        return np.array([self.get(f"{base}_{axis}", default) for axis in AXES])

    def store(self, name: str, value: Value) -> SimParameter:
        """Change the value that is read back. The caller has converted it to the parameter's type."""
        parameter = self._by_name[name]
        parameter.value = float32(float(value)) if parameter.is_float else int(value)
        self.version += 1
        self._listing = None
        return parameter

    def save(self, name: str, value: Value | None = None) -> None:
        """Commit `value`, or the present one (None), to storage: it is there after a restart."""
        self.saved[name] = self._by_name[name].value if value is None else value

    def restore_saved(self) -> None:
        """Take every value from storage, as a restart does."""
        for name, value in self.saved.items():
            self._by_name[name].value = value
        self.version += 1
        self._listing = None

    def pin(self, name: str) -> None:
        """Keep the present value in force: later writes are accepted, but not applied."""
        if name not in self._by_name:
            raise ConfigurationError(f"no parameter {name} to hold back")
        self._pinned[name] = self._by_name[name].value

    def unpin_all(self) -> None:
        """Put every stored value in force again."""
        self._pinned.clear()
        self.version += 1

    def listing(self) -> list[SimParameter]:
        """The listed parameters in order; hidden ones are left out."""
        if self._listing is None:
            self._listing = [p for p in self._by_name.values() if p.listed and self._visible(p.name)]
            self._index = {p.name: i for i, p in enumerate(self._listing)}
        return self._listing

    def show(self, name: str) -> None:
        """List a parameter from now on."""
        self._by_name[name].listed = True
        self._listing = None

    def index_of(self, name: str) -> int | None:
        """Position in the listing; None if the parameter is not listed."""
        self.listing()
        return self._index.get(name)

    def vector_members(self, name: str) -> list[str] | None:
        """The three names of a vector parameter if `name` is its X element, else None."""
        if not name.endswith("_X"):
            return None
        members = [name[:-1] + axis for axis in AXES]
        whole = all(m in self._by_name and self._by_name[m].is_float for m in members)
        return members if whole else None

    def hash(self, skip: Callable[[str], bool]) -> int:
        """CRC of names and values as PX4's _HASH_CHECK covers them, without those that `skip` names."""
        crc = 0
        for p in sorted(self.listing(), key=lambda p: p.name):
            if not skip(p.name):
                crc = zlib.crc32(p.name.encode() + int32_bytes(p), crc)
        return crc


def int32_bytes(parameter: SimParameter) -> bytes:
    """The four little-endian bytes of a value in its own type (int32 or float32)."""
    if parameter.is_float:
        return struct.pack("<f", parameter.value)
    return struct.pack("<I", int(parameter.value) & 0xFFFFFFFF)


def load_table(path: str) -> list[SimParameter]:
    """Parameters of a `name,value,type` file in its order; type is a MAV_PARAM_TYPE number.

    A header line and lines that begin with # are skipped. Raises ConfigurationError naming the broken line.
    """
    parameters: list[SimParameter] = []
    try:
        with Path(path).open(newline="", encoding="utf-8") as file:
            for number, row in enumerate(csv.reader(file), start=1):
                if not row or row[0].startswith("#") or row[0] == "name":
                    continue
                parameters.append(_parsed_row(path, number, row))
    except OSError as error:
        raise ConfigurationError(f"parameter file {path} cannot be read: {error.strerror}") from error
    if not parameters:
        raise ConfigurationError(f"parameter file {path} holds no name,value,type line")
    return parameters


def _parsed_row(path: str, number: int, row: list[str]) -> SimParameter:
    try:
        name, text, kind_text = (cell.strip() for cell in row[:3])
        kind = ParameterType(int(kind_text))
        value: Value = float32(float(text)) if kind is ParameterType.REAL32 else int(float(text))
    except ValueError as error:
        raise ConfigurationError(f"{path}, line {number}: needs name,value,type: {error}") from error
    if not 0 < len(name) <= NAME_LENGTH:
        raise ConfigurationError(f"{path}, line {number}: a name has 1 to {NAME_LENGTH} characters, got {name!r}")
    return SimParameter(name, kind, value, value)
