"""Payloads of one message, all at once: bytes to a structured array in wire order."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import InvalidInputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavcal.calib.wire import Frame

_NUMPY_CODES: Final = {
    "char": "S1",
    "int8_t": "i1",
    "uint8_t": "u1",
    "uint8_t_mavlink_version": "u1",
    "int16_t": "<i2",
    "uint16_t": "<u2",
    "int32_t": "<i4",
    "uint32_t": "<u4",
    "int64_t": "<i8",
    "uint64_t": "<u8",
    "float": "<f4",
    "double": "<f8",
}


@cache
def wire_dtype(message_id: int) -> np.dtype[Any]:
    """The layout of a message's payload, extension fields included.

    Raises
    ------
    InvalidInputError
        If the dialect has no such message.
    """
    cls = dialect.mavlink_map.get(message_id)
    if cls is None:
        raise InvalidInputError(f"message id {message_id} is not in the dialect; filter by id first")
    types = dict(zip(cls.fieldnames, cls.fieldtypes, strict=True))
    fields: list[tuple[Any, ...]] = []
    for name, length in zip(cls.ordered_fieldnames, cls.array_lengths, strict=True):
        code = _NUMPY_CODES[types[name]]
        if code == "S1" and length:
            fields.append((name, f"S{length}"))
        elif length:
            fields.append((name, code, (length,)))
        else:
            fields.append((name, code))
    return np.dtype(fields)


def gather(frames: Sequence[Frame], message_id: int) -> NDArray[Any]:
    """One structured row a frame; all frames are of `message_id`. Zeros that MAVLink 2 left out are put back."""
    dtype = wire_dtype(message_id)
    size = dtype.itemsize
    return np.frombuffer(b"".join([f.payload[:size].ljust(size, b"\0") for f in frames]), dtype)
