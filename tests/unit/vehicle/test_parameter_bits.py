from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.wire.parameters import ParameterEncoding, ParamType, value_from_bits
from mavcal.service.errors import ParameterRejected
from mavcal.service.vehicle.parameter_bits import bits_from_value, same_value

CAST, BYTES = ParameterEncoding.CAST, ParameterEncoding.BYTEWISE
REAL, INT32, INT8 = ParamType.REAL32, ParamType.INT32, ParamType.INT8


@given(st.integers(-(2**31), 2**31 - 1))
def test_every_integer_survives_bytewise(value: int) -> None:
    bits = bits_from_value("P", value, INT32, BYTES)
    assert bits == struct.pack("<i", value)
    assert value_from_bits(bits, INT32, BYTES) == value


@given(st.integers(-(2**31), 2**31 - 1))
def test_a_cast_integer_is_exact_or_refused(value: int) -> None:
    if struct.unpack("<f", struct.pack("<f", value))[0] == value:
        assert value_from_bits(bits_from_value("P", value, INT32, CAST), INT32, CAST) == value
    else:
        with pytest.raises(ParameterRejected):
            bits_from_value("P", value, INT32, CAST)


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_every_float32_survives_either_way(value: float) -> None:
    for encoding in ParameterEncoding:
        bits = bits_from_value("P", value, REAL, encoding)
        assert value_from_bits(bits, REAL, encoding) == value


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("kind", [REAL, INT32])
def test_what_is_not_finite_is_refused_by_name(value: float, kind: ParamType) -> None:
    with pytest.raises(ParameterRejected, match="P") as caught:
        bits_from_value("P", value, kind, CAST)
    assert caught.value.name == "P"


def test_the_sign_of_zero_does_not_matter() -> None:
    assert same_value(struct.pack("<f", 0.0), struct.pack("<f", -0.0), REAL, CAST)
    assert not same_value(struct.pack("<f", 1.0), struct.pack("<f", 1.0000001), REAL, CAST)


def test_a_nan_pattern_equals_itself_as_an_integer_and_nothing_as_a_number() -> None:
    minus_one = struct.pack("<i", -1)
    assert value_from_bits(minus_one, INT32, BYTES) == -1
    assert math.isnan(float(value_from_bits(minus_one, INT32, CAST)))
    assert same_value(minus_one, minus_one, INT32, BYTES)


def test_small_kinds_use_the_first_bytes() -> None:
    assert bits_from_value("P", -3, INT8, BYTES) == b"\xfd\x00\x00\x00"
    assert value_from_bits(b"\xfd\x00\x00\x00", INT8, BYTES) == -3
