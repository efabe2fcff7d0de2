"""What the vehicle says of itself, in its own words."""

from __future__ import annotations

import pytest

from mavcal.calib.preflight import own
from mavcal.calib.preflight.check import CheckId, Verdict
from mavcal.calib.preflight.snapshot import OwnView, Shaking

READY = OwnView(present=True, ready=True, asked=True, calibrating=False)


def test_its_own_words_are_the_reason() -> None:
    view = OwnView(present=True, ready=False, asked=True, texts=("PreArm: Throttle below Failsafe",))
    check = own.vehicle_prearm(view, "ardupilot", {"ARMING_CHECK": 1}, [])
    assert check.verdict == Verdict.FAIL
    assert "'PreArm: Throttle below Failsafe'" in check.reason


def test_what_follows_from_a_failed_check_is_no_second_failure() -> None:
    view = OwnView(present=True, ready=False, asked=True, texts=("PreArm: Compass not calibrated",))
    check = own.vehicle_prearm(view, "ardupilot", {}, [CheckId.PARAMETERS_CHANGED])
    assert check.verdict == Verdict.WARN
    other = OwnView(present=True, ready=False, texts=("PreArm: Compass not calibrated", "PreArm: Fence breached"))
    assert own.vehicle_prearm(other, "ardupilot", {}, [CheckId.PARAMETERS_CHANGED]).verdict == Verdict.FAIL


def test_ready_and_silent_would_arm() -> None:
    check = own.vehicle_prearm(READY, "ardupilot", {"ARMING_CHECK": 1}, [])
    assert check.verdict == Verdict.PASS
    assert "would arm now" in check.reason


@pytest.mark.parametrize("parameters", [{"ARMING_CHECK": 0}, {"ARMING_SKIPCHK": -1}])
def test_a_yes_with_disabled_checks_is_none(parameters: dict[str, int]) -> None:
    assert own.vehicle_prearm(READY, "ardupilot", parameters, []).verdict == Verdict.UNKNOWN
    check = own.arming_checks("ardupilot", parameters)
    assert check.verdict == Verdict.WARN
    assert "Disabled is not pass" in check.reason


def test_a_vehicle_that_does_not_say_is_unknown() -> None:
    assert own.vehicle_prearm(OwnView(), "px4", {}, []).verdict == Verdict.UNKNOWN
    absent = OwnView(present=False, ready=True)
    assert own.vehicle_prearm(absent, "px4", {}, []).verdict == Verdict.UNKNOWN
    assert own.onboard_calibration(OwnView()).verdict == Verdict.UNKNOWN
    assert own.vibration(None).verdict == Verdict.UNKNOWN


def test_arming_checks_as_a_firmware_comes() -> None:
    assert own.arming_checks("ardupilot", {"ARMING_CHECK": 1}).verdict == Verdict.PASS
    assert own.arming_checks("ardupilot", {"ARMING_SKIPCHK": 0}).verdict == Verdict.PASS
    assert own.arming_checks("px4", {"COM_ARM_MAG_STR": 2, "SYS_HAS_MAG": 1}).verdict == Verdict.PASS
    assert own.arming_checks("px4", {"COM_ARM_MAG_STR": 0}).verdict == Verdict.WARN
    assert own.arming_checks("ardupilot", {}).verdict == Verdict.UNKNOWN


def test_clips_since_the_start_count() -> None:
    assert own.vibration(Shaking((0.1, 0.1, 0.1), (100, 0, 0))).verdict == Verdict.PASS
    assert own.vibration(Shaking((0.1, 0.1, 0.1), (0, 101, 0))).verdict == Verdict.FAIL
    assert own.vibration(Shaking((6.0, 0.1, 0.1), (0, 0, 0))).verdict == Verdict.FAIL
