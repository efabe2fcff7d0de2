"""Values of parameters as four bytes, cast or copied, and what was heard of them."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.wire.codec import RawMessage, decode, decode_param_value, encode, param_bytes, param_set
from mavcal.calib.wire.frames import FrameParser
from mavcal.calib.wire.parameters import ParameterEncoding, ParamType, heard_value, usual_encoding, value_from_bits

CAST, BYTEWISE = ParameterEncoding.CAST, ParameterEncoding.BYTEWISE
RANGES = {
    ParamType.UINT8: (0, 255),
    ParamType.INT8: (-128, 127),
    ParamType.UINT16: (0, 65535),
    ParamType.INT16: (-32768, 32767),
    ParamType.UINT32: (0, 2**32 - 1),
    ParamType.INT32: (-(2**31), 2**31 - 1),
}


@pytest.mark.parametrize("kind", RANGES)
@given(data=st.data())
def test_an_integer_that_is_copied_comes_back_whole(kind, data):
    value = data.draw(st.integers(*RANGES[kind]))
    bits = struct.pack(kind.layout, value)
    assert len(bits) == 4
    assert value_from_bits(bits, kind, BYTEWISE) == value
    assert isinstance(value_from_bits(bits, kind, BYTEWISE), int)


@given(value=st.integers(-(2**24), 2**24))
def test_an_integer_that_is_cast_comes_back_up_to_24_bits(value):
    found = value_from_bits(struct.pack("<f", value), ParamType.INT32, CAST)
    assert (found, type(found)) == (value, int)


@given(value=st.floats(width=32, allow_nan=False))
@pytest.mark.parametrize("encoding", [CAST, BYTEWISE])
def test_a_real_number_is_the_same_in_either_encoding(encoding, value):
    assert value_from_bits(struct.pack("<f", value), ParamType.REAL32, encoding) == value


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_cast_integer_that_is_no_number_equals_nothing(value):
    assert math.isnan(value_from_bits(struct.pack("<f", value), ParamType.INT32, CAST))


def test_a_cast_integer_with_a_fraction_is_rounded():
    assert value_from_bits(struct.pack("<f", 2.75), ParamType.UINT8, CAST) == 3
    assert value_from_bits(struct.pack("<f", -2.75), ParamType.INT8, CAST) == -3


def test_the_pattern_of_a_nan_is_an_integer_where_it_is_copied():
    bits = struct.pack("<i", -1)
    assert math.isnan(struct.unpack("<f", bits)[0])
    assert value_from_bits(bits, ParamType.INT32, BYTEWISE) == -1


@pytest.mark.parametrize(
    ("autopilot", "encoding"), [("px4", BYTEWISE), ("ardupilot", CAST), ("other", CAST), (None, CAST)]
)
def test_px4_copies_and_all_others_cast(autopilot, encoding):
    assert usual_encoding(autopilot) is encoding


def test_everything_but_a_real_number_is_an_integer():
    assert [kind for kind in ParamType if not kind.integer] == [ParamType.REAL32]


SEVEN = struct.pack("<f", 7.0)


def heard(name=b"INS_ACC_ID", bits=SEVEN, kind=6, count=900, index=12, encoding=CAST):
    payload = struct.pack("<4sHH16sB", bits, count, index, name, kind)
    (frame,) = FrameParser().feed(encode(RawMessage(22, payload), 1, 1, 0))
    return heard_value(frame, encoding)


def test_a_value_is_heard_with_its_place_in_the_list():
    found = heard()
    assert (found.name, found.value, found.kind) == ("INS_ACC_ID", 7, ParamType.INT32)
    assert (found.count, found.index, found.bits) == (900, 12, SEVEN)
    assert heard(index=65535).index is None
    assert heard(index=65534).index == 65534


def test_the_checksum_of_a_list_is_no_parameter():
    assert heard(name=b"_HASH_CHECK") is None
    assert heard(name=b"_HASH_CHECKX") is not None


@pytest.mark.parametrize("kind", [0, 7, 8, 10, 255])
def test_a_type_that_four_bytes_do_not_hold_has_no_value(kind):
    found = heard(kind=kind)
    assert found.kind is None
    assert math.isnan(found.value)
    assert found.bits == SEVEN


def test_a_name_ends_at_its_first_zero_and_what_is_no_letter_is_marked():
    assert heard(name=b"ABC\x00XYZ").name == "ABC"
    assert heard(name=b"A\xffB").name == "A\ufffdB"


@given(name=st.text("ABCDEFGHIJKLMNOPQRSTUVWXYZ_0123456789", min_size=1, max_size=16), value=st.integers(-99, 99))
def test_what_is_set_is_read_by_the_dialect(name, value):
    bits = struct.pack("<f", value)
    (frame,) = FrameParser().feed(encode(param_set(3, 4, name, bits, 9), 1, 1, 0))
    message = decode(frame)
    assert (message.target_system, message.target_component, message.param_type) == (3, 4, 9)
    assert message.param_id.rstrip("\x00") == name
    assert message.param_value == value
    assert param_bytes(frame) == bits


@pytest.mark.parametrize(
    ("name", "bits"), [("", b"\0\0\0\0"), ("A" * 17, b"\0\0\0\0"), ("A", b"\0\0\0"), ("A", bytes(5))]
)
def test_a_name_or_value_that_does_not_fit_is_refused(name, bits):
    with pytest.raises(InvalidInputError, match="a parameter name has 1 to 16 characters and a value 4 bytes"):
        param_set(1, 1, name, bits, 9)


def test_other_messages_carry_no_parameter():
    (frame,) = FrameParser().feed(encode(RawMessage(0, b"abc"), 1, 1, 0))
    with pytest.raises(InvalidInputError, match="message id 0 carries no parameter value"):
        param_bytes(frame)
    with pytest.raises(InvalidInputError, match="message id 0 is not PARAM_VALUE"):
        decode_param_value(frame)
    (setting,) = FrameParser().feed(encode(param_set(1, 1, "A", bytes(4), 9), 1, 1, 0))
    with pytest.raises(InvalidInputError, match="message id 23 is not PARAM_VALUE"):
        decode_param_value(setting)
