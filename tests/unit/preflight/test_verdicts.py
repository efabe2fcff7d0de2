"""The rule of verdicts as properties, and the sentences that a report, a tile and a refusal are told by."""

from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.preflight import self_report
from mavcal.calib.preflight.check import (
    Check,
    CheckId,
    Measure,
    OwnView,
    Report,
    Shaking,
    Verdict,
    judged,
    readiness,
    unchecked,
    unknown,
)
from mavcal.calib.preflight.inertial import vibration
from mavcal.calib.preflight.states import FinishedCalibration, SensorState, sensor_states, summary
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial
from tests.unit.firmware.conftest import make_fit  # noqa: F401 - a fixture
from tests.unit.preflight.vehicle import NOW, healthy, unheard

PASS, WARN, FAIL, UNKNOWN = Verdict.PASS, Verdict.WARN, Verdict.FAIL, Verdict.UNKNOWN
RISING = [PASS, WARN, FAIL]
values = st.floats(0.0, 10.0)


def measure(value, sd, limit=1.0):
    return Measure("it", value, sd, limit, "deg")


@given(value=values, sd=st.floats(0.0, 0.33), more=values)
def test_a_larger_value_is_never_judged_milder(value, sd, more):
    first, second = measure(value, sd).verdict, measure(value + more, sd).verdict
    assert RISING.index(second) >= RISING.index(first)


@given(value=values, sd=st.floats(0.0, 3.0))
def test_a_failure_is_beyond_doubt_and_a_pass_is_within_the_limit(value, sd):
    verdict = measure(value, sd).verdict
    assert (verdict == FAIL) == (value - 3.0 * sd > 1.0)
    assert verdict != PASS or (value <= 1.0 and 3.0 * sd <= 1.0)
    assert verdict != UNKNOWN or 3.0 * sd > 1.0


@given(
    numbers=st.lists(st.tuples(values, st.floats(0.0, 0.3)), min_size=1, max_size=5),
    factor=st.floats(0.1, 10.0),
)
def test_a_check_is_its_worst_number_in_any_unit(numbers, factor):
    check = judged(CheckId.GYRO_REST, [measure(*n) for n in numbers], good="fine", remedy="mend")
    scaled = [measure(v * factor, sd * factor, factor) for v, sd in numbers]
    again = judged(CheckId.GYRO_REST, scaled, good="fine", remedy="mend")
    worst = max((measure(*n).verdict for n in numbers), key=RISING.index)
    assert check.verdict == worst
    if all(abs(v - 3.0 * sd - 1.0) > 1e-6 and abs(v - 1.0) > 1e-6 for v, sd in numbers):
        assert again.verdict == worst


def test_an_uncertain_number_leaves_a_check_unknown_only_where_no_other_decides():
    vague, good, bad = measure(0.5, 1.0), measure(0.5, 0.1), measure(3.0, 0.1)
    assert judged(CheckId.GYRO_REST, [vague, good], good="fine", remedy="mend").verdict == UNKNOWN
    found = judged(CheckId.GYRO_REST, [vague, bad], good="fine", remedy="mend")
    assert (found.verdict, found.value) == (FAIL, 3.0)
    said = judged(CheckId.GYRO_REST, [vague], good="fine", remedy="mend")
    assert (said.reason, said.remedy) == ("it is 0.5 ± 1 deg: too uncertain to compare with 1 deg.", "mend")


def test_of_two_numbers_with_one_verdict_the_one_further_beyond_its_limit_is_told():
    far, near = measure(3.0, 0.0), Measure("that", 20.0, 0.0, 10.0, "uT")
    assert judged(CheckId.GYRO_REST, [near, far], good="", remedy="").value == 3.0
    without_limit = Measure("clips", 5.0, 0.0, 0.0, "")
    assert judged(CheckId.VIBRATION, [far, without_limit], good="", remedy="").value == 5.0


def check(of, verdict, reason=""):
    return Check(of, verdict, None, None, None, "", reason)


def test_a_vehicle_that_would_arm_with_warnings_is_told_so():
    good = check(CheckId.VEHICLE_PREARM, PASS, "This vehicle would arm now: its own checks pass.")
    every = readiness(Report((good,)))
    assert (every.verdict, every.text, every.against) == (PASS, "All 1 checks pass: this vehicle would arm now.", ())
    warned = readiness(Report((check(CheckId.VIBRATION, WARN, "shakes"), good)))
    assert warned.text == "This vehicle would arm now. 1 of 2 checks pass; vibration deserves a look."
    assert warned.against == ("vibration: shakes",)
    failed = readiness(Report((check(CheckId.ACCEL_FORCE, FAIL, "off"), good)))
    assert failed.text.startswith("Not fit to fly, although the vehicle itself would arm: ")
    assert "accel_force failed" in failed.text


def test_what_stands_against_arming_is_told_with_failures_first():
    found = readiness(
        Report(
            (
                check(CheckId.GYRO_REST, UNKNOWN, "a"),
                check(CheckId.VIBRATION, WARN, "b"),
                check(CheckId.ACCEL_FORCE, FAIL, "c"),
                check(CheckId.VEHICLE_PREARM, UNKNOWN, "It does not say."),
            )
        )
    )
    assert [line.partition(":")[0] for line in found.against] == [
        "accel_force",
        "vibration",
        "gyro_rest",
        "vehicle_prearm",
    ]
    assert found.text == "Whether this vehicle would arm now is not known. It does not say."
    refused = readiness(Report((check(CheckId.VEHICLE_PREARM, FAIL, "The vehicle would not arm now: 'x'."),)))
    assert (refused.verdict, refused.text) == (FAIL, "The vehicle would not arm now: 'x'.")
    assert unchecked("it is armed.").text.endswith("was not checked: it is armed.")


def test_a_consequence_keeps_its_number_and_names_its_cause():
    failed = judged(CheckId.ACCEL_FORCE, [measure(3.0, 0.1)], good="", remedy="mend")
    told = failed.because_of(CheckId.SENSOR_IDS)
    assert told.reason == f"{failed.reason} This follows from sensor_ids, which failed."
    assert told.remedy == "Mend sensor_ids first, then check again."
    assert (told.value, told.sd, told.evidence) == (failed.value, failed.sd, failed.evidence)
    report = Report((told, unknown(CheckId.VIBRATION, "not heard")))
    assert report.summary == "0 of 2 checks pass; accel_force, vibration could not be checked."


@pytest.mark.parametrize(
    ("autopilot", "parameters", "said"),
    [
        ("ardupilot", {"ARMING_CHECK": 1}, []),
        ("ardupilot", {"ARMING_CHECK": 6}, ["ARMING_CHECK is 6, 1 is everything"]),
        ("ardupilot", {"ARMING_SKIPCHK": 4}, ["ARMING_SKIPCHK is 4, 0 skips nothing"]),
        ("ardupilot", {"COMPASS_ENABLE": 0}, ["COMPASS_ENABLE is 0"]),
        ("ardupilot", {"SYS_HAS_MAG": 0}, []),
        ("px4", {"COM_ARM_MAG_STR": 0}, ["COM_ARM_MAG_STR is 0: the strength of the field is not checked"]),
        ("px4", {"COM_ARM_MAG_ANG": -1}, ["COM_ARM_MAG_ANG is negative: compasses are not compared"]),
        ("px4", {"COM_ARM_MAG_ANG": 0}, []),
        ("px4", {"SYS_HAS_MAG": 0}, ["SYS_HAS_MAG is 0"]),
        ("px4", {"ARMING_CHECK": 0}, []),
    ],
)
def test_each_check_that_a_parameter_switches_off_is_told(autopilot, parameters, said):
    assert self_report.switched_off(autopilot, parameters) == said
    assert self_report.arming_checks(unheard(autopilot, parameters)).verdict in ((WARN,) if said else (PASS, UNKNOWN))


def test_arming_parameters_that_were_not_all_read_prove_nothing():
    some = {"ARMING_CHECK": 1}
    assert self_report.arming_checks(unheard("ardupilot", some, complete=False)).verdict == UNKNOWN
    every = {**some, "ARMING_SKIPCHK": 0, "COMPASS_ENABLE": 1}
    assert self_report.arming_checks(unheard("ardupilot", every, complete=False)).verdict == PASS
    assert self_report.arming_checks(unheard("ardupilot", {"ARMING_CHECK": 0}, complete=False)).verdict == WARN
    assert self_report.arming_checks(unheard("other", every)).verdict == UNKNOWN


@pytest.mark.parametrize(
    ("text", "failed", "explained"),
    [
        ("PreArm: Accels inconsistent", CheckId.ACCEL_FORCE, True),
        ("PreArm: Accels inconsistent", CheckId.GYRO_REST, False),
        ("PreArm: Gyros inconsistent", CheckId.GYRO_REST, True),
        ("PreArm: Compasses inconsistent", CheckId.COMPASS_FIELD, True),
        ("PreArm: Compasses inconsistent", CheckId.COMPASS_DIRECTION, True),
        ("PreArm: Compasses inconsistent", CheckId.SENSOR_IDS, True),
        ("PreArm: Compass calibration running", CheckId.ONBOARD_CALIBRATION, True),
        ("PreArm: Battery low", CheckId.SENSOR_IDS, False),
        ("PreArm: Gyros inconsistent", CheckId.TEMPERATURE, True),
        ("PreArm: Gyros inconsistent", CheckId.VIBRATION, False),
    ],
)
def test_a_text_is_explained_by_a_failed_check_of_the_same_sensor(text, failed, explained):
    view = OwnView(present=True, ready=False, texts=(text,))
    found = self_report.vehicle_prearm(view, "ardupilot", {}, [failed])
    assert found.verdict == (WARN if explained else FAIL)
    assert (f"This follows from {failed}." in found.reason) == explained


def test_a_vehicle_that_is_not_ready_and_says_nothing_is_explained_by_what_failed_alone():
    found = self_report.vehicle_prearm(OwnView(present=True, ready=False), "px4", {}, [CheckId.SENSOR_IDS])
    assert (found.verdict, "This follows from sensor_ids." in found.reason) == (Verdict.WARN, True)
    found = self_report.vehicle_prearm(OwnView(present=True, ready=False), "px4", {}, [])
    assert found.verdict == FAIL
    assert "it says that it is not ready, and not why" in found.reason


@pytest.mark.parametrize(
    ("view", "line"),
    [
        (OwnView(), "SYS_STATUS was not heard"),
        (
            OwnView(present=True, ready=True),
            "SYS_STATUS: the prearm check is present and switched on; the vehicle says that it is ready",
        ),
        (
            OwnView(present=True, ready=False),
            "SYS_STATUS: the prearm check is present and switched on; the vehicle says that it is not ready",
        ),
        (OwnView(present=False), "SYS_STATUS: the prearm check is not among what is present and switched on"),
    ],
)
def test_what_sys_status_said_is_evidence(view, line):
    evidence = self_report.vehicle_prearm(view, "px4", {}, []).evidence
    assert line in evidence
    assert "its checks were not run on request" in evidence
    asked = dataclasses.replace(view, asked=True)
    assert "its checks were run on request" in self_report.vehicle_prearm(asked, "px4", {}, []).evidence


@pytest.mark.parametrize(("level", "verdict"), [(2.4, PASS), (2.6, WARN), (3.0, FAIL)])
def test_a_level_of_vibration_is_known_to_a_twentieth(level, verdict):
    assert vibration(unheard(shaking=Shaking((0.1, level, 0.1), (0, 0, 0)))).verdict == verdict
    assert vibration(unheard(shaking=Shaking((), ()))).verdict == PASS


@pytest.mark.parametrize(("calibrating", "verdict"), [(None, UNKNOWN), (True, FAIL), (False, PASS)])
def test_a_calibration_of_its_own_stands_against_arming(calibrating, verdict):
    found = self_report.onboard_calibration(unheard(view=OwnView(calibrating=calibrating)))
    assert found.verdict == verdict
    assert bool(found.remedy) == (calibrating is True)


def state(kind, verdict, at=1.0, advice="Do it."):
    return SensorState(kind, verdict, "", "", advice, at, None, None)


def test_a_summary_of_tiles_names_what_needs_something_now():
    good, old, bad = state("gyro", PASS), state("accel", WARN, advice="Old."), state("mag", FAIL, advice="Gone.")
    assert summary([good, old, bad]) == (FAIL, "Needs now: compass. Gone.")
    assert summary([good, old]) == (WARN, "Needs now: accelerometer. Old.")
    both = [state("gyro", WARN, advice="First."), old, state("thermal", WARN)]
    assert summary(both) == (WARN, "Needs now: gyro, accelerometer and temperature. First.")
    never = state("thermal", UNKNOWN, at=None)
    assert summary([good, never]) == (UNKNOWN, "Not calibrated here yet: temperature.")
    assert summary([good])[0] == PASS
    assert summary([never, state("mag", UNKNOWN, at=None)])[1].startswith("Nothing was calibrated here yet.")


@pytest.mark.parametrize(
    ("seconds", "said"),
    [
        (0.0, "just now"),
        (119.0, "just now"),
        (120.0, "2 minutes"),
        (3599.0, "59 minutes"),
        (3600.0, "1 hour "),
        (7300.0, "2 hours"),
        (86400.0, "1 day "),
        (86400.0 * 9.9, "9 days"),
    ],
)
def test_when_it_was_calibrated_is_told_in_whole_units(make_fit, seconds, said):  # noqa: F811
    fit = make_fit(Sensor.GYRO, 0, offset=[0.01] * 3)
    done = FinishedCalibration("gyro", "job", NOW - seconds, (fit,))
    gyro = sensor_states([done], healthy(2, redundant=True).snapshot())[0]
    assert (gyro.at, gyro.temperature) == (done.at, 32.0)
    assert f" {said}" in gyro.text
    assert " 32 °C" in gyro.text


def tile(fits, kind, procedure=None):
    done = FinishedCalibration(procedure or kind, "job", NOW - 60.0, tuple(fits))
    found = sensor_states([done], healthy(2, redundant=True).snapshot())
    return next(s for s in found if s.kind == kind)


def test_the_quality_told_is_that_of_the_worst_unit(make_fit):  # noqa: F811
    sds = (0.01, 0.04)
    accels = [make_fit(Sensor.ACCEL, i, offset=[0.1] * 3, offset_sd=sd) for i, sd in enumerate(sds)]
    assert " 0.04 m/s²" in tile(accels, "accel").text
    gyros = [make_fit(Sensor.GYRO, i, offset=[0.1] * 3, offset_sd=sd) for i, sd in enumerate(sds)]
    assert f" {math.degrees(0.04):.2g} deg/s" in tile(gyros, "gyro").text
    mags = [make_fit(Sensor.MAG, i, quality={"heading_sd_deg": sd}) for i, sd in enumerate((0.5, 1.5))]
    assert " 1.5 deg" in tile(mags, "mag").text
    assert " deg" not in tile([make_fit(Sensor.MAG, 0)], "mag").text


def test_a_drift_is_known_over_the_narrowest_range(make_fit):  # noqa: F811
    spans = ((0.0, 50.0), (10.0, 40.0))
    fits = [
        make_fit(Sensor.GYRO, i, polynomial=ThermalPolynomial(25.0, low, high, [[1e-4]] * 3))
        for i, (low, high) in enumerate(spans)
    ]
    found = tile(fits, "thermal")
    assert " 30 °C" in found.text
    assert "°C" not in tile([make_fit(Sensor.GYRO, 0)], "thermal").text


def test_a_fit_of_another_sensor_tells_nothing_of_this_tile(make_fit):  # noqa: F811
    both = [make_fit(Sensor.ACCEL, 0, offset_sd=0.5), make_fit(Sensor.GYRO, 0, offset_sd=0.001)]
    assert tile(both, "gyro", "imu-multi").text.endswith(f"Offset known to {math.degrees(0.001):.2g} deg/s.")
    other = FinishedCalibration("mag-rings", "job", NOW, ())
    states = sensor_states([other], healthy(2, redundant=True).snapshot())
    assert [s.at is not None for s in states] == [False, False, True, False]
