"""Parameter values on the wire: four bytes that mean different things to different firmwares.

ArduPilot casts every value to float32; PX4 copies the bytes of an int32 into the float field. Values are kept as their
four bytes: an integer may have the bit pattern of a NaN, which a Python float does not preserve.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Final

from mavcal.calib.wire.codec import decode_param_value
from mavcal.calib.wire.frames import Frame

HASH_CHECK: Final = "_HASH_CHECK"
"""Name under which PX4 sends the checksum of its list; it is no parameter, and no calibration changes it."""
NO_INDEX: Final = 65535
"""The index of a value that was not sent as part of a list."""


class ParameterEncoding(StrEnum):
    """How a value fills the float field of PARAM_VALUE and PARAM_SET."""

    CAST = "cast"  # converted to float32: integers are exact up to 2**24
    BYTEWISE = "bytewise"  # the bytes of the integer itself


class ParamType(IntEnum):
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
        return self is not ParamType.REAL32

    @property
    def layout(self) -> str:
        """Format for :mod:`struct` of a value that fills the field with its own bytes."""
        return _LAYOUT[self]


_LAYOUT: Final = {
    ParamType.UINT8: "<Bxxx",
    ParamType.INT8: "<bxxx",
    ParamType.UINT16: "<Hxx",
    ParamType.INT16: "<hxx",
    ParamType.UINT32: "<I",
    ParamType.INT32: "<i",
    ParamType.REAL32: "<f",
}


def value_from_bits(bits: bytes, kind: ParamType, encoding: ParameterEncoding) -> float | int:
    """The value in these bits. A cast integer that is not a number reads as NaN, which equals nothing."""
    if encoding is ParameterEncoding.BYTEWISE or kind is ParamType.REAL32:
        value: float | int = struct.unpack(kind.layout, bits)[0]
        return value
    number: float = struct.unpack("<f", bits)[0]
    return round(number) if math.isfinite(number) else math.nan


def usual_encoding(autopilot: str | None) -> ParameterEncoding:
    """Encoding of this autopilot, for a vehicle whose capabilities do not state it."""
    return ParameterEncoding.BYTEWISE if autopilot == "px4" else ParameterEncoding.CAST


@dataclass(frozen=True)
class HeardValue:
    """Contents of a PARAM_VALUE, from a link or from a recording."""

    name: str
    bits: bytes
    kind: ParamType | None
    """None: a type that does not fit four bytes; the value is unknown."""
    value: float | int
    """NaN where the type is not known."""
    count: int
    index: int | None
    """Its place in the vehicle's list; None: it came without one."""


def heard_value(frame: Frame, encoding: ParameterEncoding) -> HeardValue | None:
    """Read a PARAM_VALUE; None: it is the checksum of the list, and no parameter."""
    name, bits, number, count, index = decode_param_value(frame)
    if name == HASH_CHECK:
        return None
    kind = ParamType(number) if number in set(ParamType) else None
    value = math.nan if kind is None else value_from_bits(bits, kind, encoding)
    return HeardValue(name, bits, kind, value, count, None if index == NO_INDEX else index)
