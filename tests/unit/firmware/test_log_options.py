from __future__ import annotations

import math
import re

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.log_options import Logged, how_to_log, how_to_log_disarmed
from mavcal.calib.recording import Identity

PLANE = Identity("ardupilot", dialect.MAV_TYPE_FIXED_WING)
COPTER = Identity("ardupilot", dialect.MAV_TYPE_QUADROTOR)
PX4 = Identity("px4", dialect.MAV_TYPE_QUADROTOR)


def bit(said: str) -> int:
    found = re.search(r"bit (\d+) \(", said)
    assert found is not None
    return int(found[1])


@pytest.mark.parametrize("what", Logged)
@pytest.mark.parametrize(
    ("identity", "name"), [(PLANE, "LOG_BITMASK"), (COPTER, "LOG_BITMASK"), (PX4, "SDLOG_PROFILE")]
)
def test_a_bit_is_asked_for_until_it_is_set(what: Logged, identity: Identity, name: str) -> None:
    asked = how_to_log(what, identity, {})
    assert asked.startswith(f"Set {name} bit ")
    number = bit(asked)
    others = sum(1 << k for k in range(24) if k != number)
    assert how_to_log(what, identity, {name: others}) == asked  # whatever else is
    for value in (1 << number, others | 1 << number, float(1 << number)):
        assert "is set already" in how_to_log(what, identity, {name: value})


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_bitmask_that_is_no_number_is_not_set(value: float) -> None:
    assert how_to_log(Logged.COMPASS, COPTER, {"LOG_BITMASK": value}).startswith("Set ")


def test_the_same_thing_has_another_bit_on_another_vehicle() -> None:
    bits = {bit(how_to_log(Logged.COMPASS, identity, {})) for identity in (PLANE, COPTER)}
    assert len(bits) == 2


def test_where_the_kind_is_not_known_a_bit_that_depends_on_it_is_named_alone() -> None:
    nobody = Identity("ardupilot")
    alone = how_to_log(Logged.COMPASS, nobody, {"LOG_BITMASK": 2**24 - 1})
    assert '"Compass"' in alone
    assert "LOG_BITMASK" in alone
    assert re.search(r"\d", alone) is None
    assert bit(how_to_log(Logged.ATTITUDE, nobody, {})) == 0


@pytest.mark.parametrize("autopilot", [None, "other"])
def test_another_autopilot_is_told_nothing_it_does_not_have(autopilot: str | None) -> None:
    assert how_to_log(Logged.COMPASS, Identity(autopilot), {}) == ""
    both = how_to_log_disarmed(autopilot)
    assert how_to_log_disarmed("ardupilot") in both
    assert how_to_log_disarmed("px4") in both
    assert how_to_log_disarmed("px4") != how_to_log_disarmed("ardupilot")
