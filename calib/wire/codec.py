"""Messages: payloads to the dialect's objects and back, and parameter values as bits."""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.wire.frames import EXTRA_BYTE, MAGIC_V2, SIGNED, Frame, crc
from mavcal.calib.wire.signing import Signing, sign

Message = Any
"""A message object of :mod:`pymavlink.dialects.v20.ardupilotmega` (generated classes without a useful type)."""


class RawMessage(NamedTuple):
    """A message as its payload bytes, for values that must not pass through a float (bytewise integers)."""

    message_id: int
    payload: bytes


class _Plan(NamedTuple):
    cls: Any
    unpacker: struct.Struct
    picks: tuple[tuple[int, int], ...]
    """For every declared field: where it starts among the unpacked values, and how many it takes."""


def _plan(cls: Any) -> _Plan:
    starts = [sum(cls.lengths[:order]) for order in range(len(cls.lengths))]
    return _Plan(cls, cls.unpacker, tuple((starts[order], cls.lengths[order]) for order in cls.orders))


_PLANS: dict[int, _Plan] = {}


def decode(frame: Frame) -> Message:
    """Build the dialect's message object.

    Raises
    ------
    InvalidInputError
        If the dialect has no such message (``frame.known`` may then still be True).
    """
    plan = _PLANS.get(frame.message_id)
    if plan is None:
        cls = dialect.mavlink_map.get(frame.message_id)
        if cls is None:
            raise InvalidInputError(f"message id {frame.message_id} is not in the dialect; filter by id first")
        plan = _PLANS.setdefault(frame.message_id, _plan(cls))
    values = plan.unpacker.unpack(padded_payload(frame, plan.unpacker.size))
    return plan.cls(*[_field(values, start, length) for start, length in plan.picks])


def _field(values: tuple[Any, ...], start: int, length: int) -> Any:
    value = values[start]
    if isinstance(value, bytes):
        return value.rstrip(b"\x00")
    return value if length == 1 else list(values[start : start + length])


def padded_payload(frame: Frame, size: int) -> bytes:
    """The first `size` bytes of the payload, with the zeros that MAVLink 2 leaves out put back."""
    return frame.payload[:size].ljust(size, b"\x00")


class _Packer:
    """Stands in for a pymavlink connection: the dialect's ``pack`` reads only these attributes."""

    class _NoSigning:
        sign_outgoing = False

    seq = srcSystem = srcComponent = 0  # noqa: N815 - pymavlink's names
    signing = _NoSigning()


def raw_message(message: Message | RawMessage) -> RawMessage:
    """Serialise the payload of a message. Raises InvalidInputError if a value does not fit its field."""
    if isinstance(message, RawMessage):
        return message
    try:
        message.pack(_Packer())
    except (struct.error, TypeError, OverflowError) as exc:
        raise InvalidInputError(f"{message.get_type()} cannot be sent: {exc}") from exc
    return RawMessage(message.get_msgId(), bytes(message.get_payload()))


def encode(
    message: Message | RawMessage, system: int, component: int, sequence: int, signing: Signing | None = None
) -> bytes:
    """Make the bytes of one MAVLink 2 frame, signed if `signing` is given."""
    message_id, payload = raw_message(message)
    extra = EXTRA_BYTE.get(message_id)
    if extra is None:
        raise InvalidInputError(f"message id {message_id} is not in the dialect and cannot be sent")
    payload = payload.rstrip(b"\x00") or payload[:1]
    flags = SIGNED if signing else 0
    header = struct.pack(
        "<BBBBBBHB", len(payload), flags, 0, sequence & 0xFF, system, component, message_id & 0xFFFF, message_id >> 16
    )
    body = header + payload
    frame = bytes([MAGIC_V2]) + body + struct.pack("<H", crc(extra, crc(body)))
    return sign(frame, *signing) if signing else frame


PARAM_VALUE_ID = 22
PARAM_SET_ID = 23
_PARAM_VALUE = struct.Struct("<4sHH16sB")
_PARAM_SET = struct.Struct("<4sBB16sB")


class ParamValue(NamedTuple):
    """A PARAM_VALUE with the four bytes of its value."""

    name: str
    bits: bytes
    kind: int
    param_count: int
    param_index: int


def param_bytes(frame: Frame) -> bytes:
    """The four value bytes of a PARAM_VALUE or PARAM_SET.

    An integer sent bytewise may have the bit pattern of a NaN, which a Python float does not preserve.
    """
    if frame.message_id not in (PARAM_VALUE_ID, PARAM_SET_ID):
        raise InvalidInputError(f"message id {frame.message_id} carries no parameter value")
    return padded_payload(frame, 4)


def decode_param_value(frame: Frame) -> ParamValue:
    """Take a PARAM_VALUE apart without touching the bits of its value."""
    if frame.message_id != PARAM_VALUE_ID:
        raise InvalidInputError(f"message id {frame.message_id} is not PARAM_VALUE")
    bits, count, index, name, kind = _PARAM_VALUE.unpack(padded_payload(frame, _PARAM_VALUE.size))
    return ParamValue(name.split(b"\x00", 1)[0].decode("ascii", "replace"), bits, kind, count, index)


def param_set(target_system: int, target_component: int, name: str, bits: bytes, kind: int) -> RawMessage:
    """PARAM_SET with the value given as its four bytes. Raises InvalidInputError for an impossible name."""
    encoded = name.encode("ascii", "replace")
    if not 0 < len(encoded) <= 16 or len(bits) != 4:
        raise InvalidInputError(f"a parameter name has 1 to 16 characters and a value 4 bytes: {name!r}")
    return RawMessage(PARAM_SET_ID, _PARAM_SET.pack(bits, target_system, target_component, encoded, kind))
