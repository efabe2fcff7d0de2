from __future__ import annotations

import math
import struct
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.firmware.stream.assembler import Assembler
from mavcal.calib.recording import Identity
from mavcal.calib.wire.codec import RawMessage, encode
from mavcal.calib.wire.frames import Frame, FrameParser
from mavcal.calib.wire.parameters import HASH_CHECK, ParamType
from mavcal.service.vehicle.identity import Autopilot, VehicleIdentity
from mavcal.service.vehicle.parameters import Parameters


def param_value(bits: bytes, kind: int, name: str = "P") -> Frame:
    """A PARAM_VALUE as it comes over the wire."""
    payload = struct.pack("<4sHH16sB", bits, 1, 0, name.encode(), kind)
    (frame,) = FrameParser().feed(encode(RawMessage(22, payload), 1, 1, 0))
    return frame


def recorded(autopilot: str, frame: Frame) -> list[float | int]:
    chunk = Assembler(Identity(autopilot=autopilot)).feed([(None, frame)])
    return [entry.value for entry in chunk.parameters.entries]


def same(one: float, other: float) -> bool:
    return type(one) is type(other) and (one == other or (math.isnan(one) and math.isnan(other)))


@given(st.binary(min_size=4, max_size=4), st.sampled_from(ParamType), st.sampled_from(("ardupilot", "px4")))
def test_a_recording_and_the_live_list_read_the_same_value(bits: bytes, kind: ParamType, autopilot: str) -> None:
    frame = param_value(bits, kind)
    vehicle = SimpleNamespace(identity=VehicleIdentity(Autopilot(autopilot), 2))
    live = Parameters(cast("Any", vehicle))
    live.hear(frame)
    (value,) = recorded(autopilot, frame)
    assert same(value, live["P"].value)


@pytest.mark.parametrize(("autopilot", "value"), [("px4", -1310988), ("ardupilot", 77.0)])
def test_each_firmware_fills_the_field_in_its_own_way(autopilot: str, value: float) -> None:
    bits = struct.pack("<i" if autopilot == "px4" else "<f", value)
    assert recorded(autopilot, param_value(bits, ParamType.INT32)) == [value]


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("kind", [0, 7, 8, 10, 255])
def test_a_type_that_does_not_fit_the_field_has_no_value(autopilot: str, kind: int) -> None:
    assert recorded(autopilot, param_value(struct.pack("<f", 1.5), kind)) == []


def test_the_checksum_of_the_list_is_no_parameter() -> None:
    assert recorded("px4", param_value(b"1234", ParamType.UINT32, HASH_CHECK)) == []
