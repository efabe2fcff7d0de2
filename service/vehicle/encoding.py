"""Parameter values on the wire: four bytes that mean different things to different firmwares.

ArduPilot casts every value to float32; PX4 copies the bytes of an int32 into the float field. Values are kept as
their four bytes, because the pattern of an integer may be that of a NaN, which does not survive a Python float.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum, StrEnum

from mavcal.service.errors import ParameterRejected


class ParameterEncoding(StrEnum):
    """How a value fills the float field of PARAM_VALUE and PARAM_SET."""

    CAST = "cast"  # converted to float32: integers are exact up to 2**24
    BYTEWISE = "bytewise"  # the bytes of the integer itself


class ParameterKind(IntEnum):
    """MAV_PARAM_TYPE, the ones that fit four bytes."""

    UINT8 = 1
    INT8 = 2
    UINT16 = 3
    INT16 = 4
    UINT32 = 5
    INT32 = 6
    REAL32 = 9

    @property
    def integer(self) -> bool:
        """True for everything but REAL32."""
        return self is not ParameterKind.REAL32


_FORMAT = {
    ParameterKind.UINT8: "<Bxxx",
    ParameterKind.INT8: "<bxxx",
    ParameterKind.UINT16: "<Hxx",
    ParameterKind.INT16: "<hxx",
    ParameterKind.UINT32: "<I",
    ParameterKind.INT32: "<i",
    ParameterKind.REAL32: "<f",
}
_RANGE = {
    ParameterKind.UINT8: (0, 2**8 - 1),
    ParameterKind.INT8: (-(2**7), 2**7 - 1),
    ParameterKind.UINT16: (0, 2**16 - 1),
    ParameterKind.INT16: (-(2**15), 2**15 - 1),
    ParameterKind.UINT32: (0, 2**32 - 1),
    ParameterKind.INT32: (-(2**31), 2**31 - 1),
}


@dataclass(frozen=True)
class Parameter:
    """A parameter as last heard.

    Parameters
    ----------
    value
        int for integer kinds; for REAL32 the float32 value exactly.
    index
        Its place in the vehicle's list, or None if it came without one (65535).
    bits
        The four bytes as they were sent.
    heard_at
        Monotonic clock, s.
    """

    name: str
    value: float | int
    kind: ParameterKind
    index: int | None
    bits: bytes
    heard_at: float


def value_from_bits(bits: bytes, kind: ParameterKind, encoding: ParameterEncoding) -> float | int:
    """Read a value. A cast integer that is no number reads as NaN, so that it equals nothing."""
    if encoding is ParameterEncoding.BYTEWISE or kind is ParameterKind.REAL32:
        value: float | int = struct.unpack(_FORMAT[kind], bits)[0]
        return value
    number: float = struct.unpack("<f", bits)[0]
    return round(number) if math.isfinite(number) else math.nan


def bits_from_value(name: str, value: float, kind: ParameterKind, encoding: ParameterEncoding) -> bytes:
    """Make the bytes to send, and refuse what would arrive as something else.

    REAL32 is rounded to float32. Raises ParameterRejected for numbers that are not finite (PX4 freezes on one), do
    not fit the kind, or cannot be carried exactly.
    """
    if not math.isfinite(value):
        raise ParameterRejected(f"{name}: {value} is not a number that may be written.", name=name)
    if kind is ParameterKind.REAL32:
        return _float_bits(name, value)
    low, high = _RANGE[kind]
    if value != int(value) or not low <= value <= high:
        raise ParameterRejected(f"{name} = {value} does not fit its type {kind.name} ({low} to {high}).", name=name)
    if encoding is ParameterEncoding.BYTEWISE:
        return struct.pack(_FORMAT[kind], int(value))
    bits = _float_bits(name, value)
    if struct.unpack("<f", bits)[0] != value:
        raise ParameterRejected(
            f"{name} = {value} cannot be sent exactly: this firmware takes integers as float32.", name=name
        )
    return bits


def _float_bits(name: str, value: float) -> bytes:
    try:
        return struct.pack("<f", value)
    except OverflowError as exc:
        raise ParameterRejected(f"{name} = {value} is too large for float32.", name=name) from exc


def same_value(bits: bytes, other: bytes, kind: ParameterKind, encoding: ParameterEncoding) -> bool:
    """True if both mean the same value: equal bytes, or numbers that are equal (+0 and -0)."""
    return bits == other or value_from_bits(bits, kind, encoding) == value_from_bits(other, kind, encoding)
