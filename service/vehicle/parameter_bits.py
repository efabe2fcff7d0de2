"""A parameter as last heard, and the four bytes of what is to be sent; :mod:`calib.wire.parameters` reads them."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from mavcal.calib.wire.parameters import ParameterEncoding, ParamType, value_from_bits
from mavcal.service.errors import ParameterRejected

_RANGE = {
    ParamType.UINT8: (0, 2**8 - 1),
    ParamType.INT8: (-(2**7), 2**7 - 1),
    ParamType.UINT16: (0, 2**16 - 1),
    ParamType.INT16: (-(2**15), 2**15 - 1),
    ParamType.UINT32: (0, 2**32 - 1),
    ParamType.INT32: (-(2**31), 2**31 - 1),
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
    """

    name: str
    value: float | int
    kind: ParamType
    index: int | None
    bits: bytes


def bits_from_value(name: str, value: float, kind: ParamType, encoding: ParameterEncoding) -> bytes:
    """Make the bytes to send, and refuse what would arrive as something else.

    REAL32 is rounded to float32. Raises ParameterRejected for numbers that are not finite (PX4 freezes on one), do
    not fit the kind, or cannot be carried exactly.
    """
    if not math.isfinite(value):
        raise ParameterRejected(f"{name}: {value} is not a number that may be written.", name=name)
    if kind is ParamType.REAL32:
        return _float_bits(name, value)
    low, high = _RANGE[kind]
    if value != int(value) or not low <= value <= high:
        raise ParameterRejected(f"{name} = {value} does not fit its type {kind.name} ({low} to {high}).", name=name)
    if encoding is ParameterEncoding.BYTEWISE:
        return struct.pack(kind.layout, int(value))
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


def same_value(bits: bytes, other: bytes, kind: ParamType, encoding: ParameterEncoding) -> bool:
    """True if both mean the same value: equal bytes, or numbers that are equal (+0 and -0)."""
    return bits == other or value_from_bits(bits, kind, encoding) == value_from_bits(other, kind, encoding)
