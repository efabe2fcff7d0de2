"""Numbers of the protocol, compared with MAVLink's own definitions."""

from __future__ import annotations

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.parameters import ParameterEncoding, ParamType
from mavcal.service.errors import ParameterRejected
from mavcal.service.jobs.write import guard
from mavcal.service.jobs.write import steps as restart
from mavcal.service.vehicle.parameter_bits import bits_from_value

DTYPES = {
    ParamType.UINT8: np.uint8,
    ParamType.INT8: np.int8,
    ParamType.UINT16: np.uint16,
    ParamType.INT16: np.int16,
    ParamType.UINT32: np.uint32,
    ParamType.INT32: np.int32,
}


@pytest.mark.parametrize("kind", DTYPES)
def test_an_integer_is_taken_up_to_its_limits_and_not_beyond(kind: ParamType) -> None:
    info = np.iinfo(DTYPES[kind])
    for value in (int(info.min), int(info.max)):
        bits = bits_from_value("P", value, kind, ParameterEncoding.BYTEWISE)
        assert np.frombuffer(bits[: info.bits // 8], dtype=DTYPES[kind])[0] == value
        assert bits[info.bits // 8 :] == bytes(4 - info.bits // 8)
    for value in (int(info.min) - 1, int(info.max) + 1):
        with pytest.raises(ParameterRejected):
            bits_from_value("P", value, kind, ParameterEncoding.BYTEWISE)


def test_kinds_have_the_numbers_of_mavlink() -> None:
    assert {kind.name: int(kind) for kind in ParamType} == {
        kind.name: getattr(dialect, f"MAV_PARAM_TYPE_{kind.name}") for kind in ParamType
    }


def test_a_restart_is_of_the_autopilot_alone() -> None:
    assert restart.PREFLIGHT_REBOOT_SHUTDOWN == dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN
    first, *others = restart.REBOOT_AUTOPILOT
    assert first == 1.0  # 2 would shut it down, 3 would keep it in its bootloader
    assert others == [0.0] * 6  # of these, 1 would restart a companion, a component, a camera or a mount


def test_what_tells_a_guard_at_once_are_these_messages() -> None:
    names = ("HEARTBEAT", "EXTENDED_SYS_STATE", "MAG_CAL_PROGRESS")
    for name in names:
        assert getattr(guard, name) == getattr(dialect, f"MAVLINK_MSG_ID_{name}")
    assert {getattr(guard, name) for name in names} == guard._TELLING
