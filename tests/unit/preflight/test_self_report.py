"""What the vehicle says of itself, in its own words."""

from __future__ import annotations

import pytest

from mavcal.calib.preflight import self_report
from mavcal.calib.preflight.check import CheckId, OwnView, Shaking, Verdict
from mavcal.calib.preflight.inertial import vibration
from tests.unit.preflight.vehicle import unheard

READY = OwnView(present=True, ready=True, asked=True, calibrating=False)


def test_its_own_words_are_the_reason() -> None:
    view = OwnView(present=True, ready=False, asked=True, texts=("PreArm: Throttle below Failsafe",))
    check = self_report.vehicle_prearm(view, "ardupilot", {"ARMING_CHECK": 1}, [])
    assert check.verdict == Verdict.FAIL
    assert "'PreArm: Throttle below Failsafe'" in check.reason


def test_what_follows_from_a_failed_check_is_no_second_failure() -> None:
    view = OwnView(present=True, ready=False, asked=True, texts=("PreArm: Compass not calibrated",))
    check = self_report.vehicle_prearm(view, "ardupilot", {}, [CheckId.PARAMETERS_CHANGED])
    assert check.verdict == Verdict.WARN
    other = OwnView(present=True, ready=False, texts=("PreArm: Compass not calibrated", "PreArm: Fence breached"))
    assert self_report.vehicle_prearm(other, "ardupilot", {}, [CheckId.PARAMETERS_CHANGED]).verdict == Verdict.FAIL


def test_units_that_disagree_are_asked_again_only_where_nothing_measured_says_why() -> None:
    texts = ("PreArm: Accels inconsistent", "PreArm: GPS 1: Bad fix")
    view = OwnView(present=True, ready=False, asked=True, texts=texts[:1])
    alone = self_report.vehicle_prearm(view, "ardupilot", {}, [])
    assert self_report.agrees_soon("ardupilot", alone, texts)
    assert not self_report.agrees_soon("ardupilot", alone, texts[1:])
    assert not self_report.agrees_soon("px4", alone, texts)
    measured = self_report.vehicle_prearm(view, "ardupilot", {}, [CheckId.ACCEL_FORCE])
    assert not self_report.agrees_soon("ardupilot", measured, texts)


def test_ready_and_silent_would_arm() -> None:
    check = self_report.vehicle_prearm(READY, "ardupilot", {"ARMING_CHECK": 1}, [])
    assert check.verdict == Verdict.PASS
    assert "would arm now" in check.reason


@pytest.mark.parametrize("parameters", [{"ARMING_CHECK": 0}, {"ARMING_SKIPCHK": -1}])
def test_a_yes_with_disabled_checks_is_none(parameters: dict[str, int]) -> None:
    assert self_report.vehicle_prearm(READY, "ardupilot", parameters, []).verdict == Verdict.UNKNOWN
    check = self_report.arming_checks(unheard("ardupilot", parameters))
    assert check.verdict == Verdict.WARN
    assert "Disabled is not pass" in check.reason


def test_a_vehicle_that_does_not_say_is_unknown() -> None:
    assert self_report.vehicle_prearm(OwnView(), "px4", {}, []).verdict == Verdict.UNKNOWN
    absent = OwnView(present=False, ready=None)
    assert "not heard" not in self_report.vehicle_prearm(absent, "ardupilot", {"ARMING_CHECK": 0}, []).reason
    assert self_report.onboard_calibration(unheard(view=OwnView())).verdict == Verdict.UNKNOWN
    assert vibration(unheard(shaking=None)).verdict == Verdict.UNKNOWN


def test_px4_says_that_it_is_ready_by_its_health_alone() -> None:
    """Its SYS_STATUS has the bit among what is healthy, and neither among what is present nor switched on."""
    check = self_report.vehicle_prearm(OwnView(present=False, ready=True, asked=True), "px4", {}, [])
    assert check.verdict == Verdict.PASS
    assert "would arm now" in check.reason


def test_one_fault_is_one_failure_whatever_words_the_vehicle_has_for_it() -> None:
    for failed, text in (
        (CheckId.GYRO_REST, "PreArm: EKF attitude is bad"),
        (CheckId.GYRO_REST, "PreArm: Gyros inconsistent"),
        (CheckId.COMPASS_FIELD, "PreArm: EKF3 Yaw inconsistent by 50 deg"),
        (CheckId.SENSORS_HEARD, "PreArm: Gyros not healthy"),
    ):
        view = OwnView(present=True, ready=False, texts=(text,))
        assert self_report.vehicle_prearm(view, "ardupilot", {"ARMING_CHECK": 1}, [failed]).verdict == Verdict.WARN, (
            text
        )
        fence = OwnView(present=True, ready=False, texts=(text, "PreArm: Fence breached"))
        assert self_report.vehicle_prearm(fence, "ardupilot", {"ARMING_CHECK": 1}, [failed]).verdict == Verdict.FAIL
    silent = OwnView(present=True, ready=False)
    assert self_report.vehicle_prearm(silent, "px4", {}, [CheckId.COMPASS_FIELD]).verdict == Verdict.WARN
    assert self_report.vehicle_prearm(silent, "px4", {}, []).verdict == Verdict.FAIL


def test_arming_checks_as_a_firmware_comes() -> None:
    assert self_report.arming_checks(unheard("ardupilot", {"ARMING_CHECK": 1})).verdict == Verdict.PASS
    assert self_report.arming_checks(unheard("ardupilot", {"ARMING_SKIPCHK": 0})).verdict == Verdict.PASS
    assert self_report.arming_checks(unheard("px4", {"COM_ARM_MAG_STR": 2, "SYS_HAS_MAG": 1})).verdict == Verdict.PASS
    assert self_report.arming_checks(unheard("px4", {"COM_ARM_MAG_STR": 0})).verdict == Verdict.WARN
    assert self_report.arming_checks(unheard("ardupilot", {})).verdict == Verdict.UNKNOWN


def test_clips_since_the_start_count() -> None:
    assert vibration(unheard(shaking=Shaking((0.1, 0.1, 0.1), (100, 0, 0)))).verdict == Verdict.PASS
    assert vibration(unheard(shaking=Shaking((0.1, 0.1, 0.1), (0, 101, 0)))).verdict == Verdict.FAIL
    assert vibration(unheard(shaking=Shaking((6.0, 0.1, 0.1), (0, 0, 0)))).verdict == Verdict.FAIL
