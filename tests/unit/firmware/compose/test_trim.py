from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.compose.fitted import Pair
from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.firmware.compose.px4 import compose_imu
from mavcal.calib.firmware.compose.trim import adjust_trim, force_when_level, trim_from_force, trim_under
from mavcal.calib.firmware.options import ComposeOptions
from mavcal.calib.firmware.plan import ParameterKind
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.firmware.rotations import euler_matrix
from mavcal.calib.fit import FitStatus
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import TriadModel


def after(plan, parameters):
    return {**parameters, **{c.name: c.new for c in plan.changes}}


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.05, -0.12), (-0.17, 0.03)])
def test_a_level_vehicle_reads_minus_the_third_row_of_the_rotation(roll, pitch):
    vehicle_from_board = euler_matrix(np.degrees(roll), np.degrees(pitch), 0.0)
    np.testing.assert_allclose(
        vehicle_from_board @ force_when_level(roll, pitch), [0, 0, -STANDARD_GRAVITY], atol=1e-12
    )
    np.testing.assert_allclose(trim_from_force(force_when_level(roll, pitch)), [roll, pitch], atol=1e-15)


def test_an_offset_of_one_percent_of_gravity_turns_the_level_by_a_hundredth_of_a_radian():
    # the old calibration left 0.0980665 m/s2 on y: level read roll atan(-0.01)
    old, new = TriadModel(), TriadModel([0.0, 0.0980665, 0.0])
    roll, pitch = trim_under(np.arctan(-0.01), 0.0, old, new, None)
    assert roll == pytest.approx(0.0, abs=1e-6)
    assert pitch == pytest.approx(0.0, abs=1e-12)


def test_ardupilot_keeps_the_same_physical_attitude_level(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    parameters = ardupilot_parameters | {"AHRS_TRIM_X": 0.02, "AHRS_TRIM_Y": -0.01}
    matrix = np.diag([1.01, 0.98, 1.015])
    fit = make_fit(Sensor.ACCEL, offset=[0.3, -0.2, 0.15], matrix=matrix, matrix_sd=1e-4)
    plan = compose([fit], parameters, ardupilot_fingerprint)
    raw = ardupilot.calibration_in_force(parameters, Sensor.ACCEL, 0).invert(force_when_level(0.02, -0.01))
    read = ardupilot.calibration_in_force(after(plan, parameters), Sensor.ACCEL, 0).apply(raw)
    changed = {c.name: c for c in plan.changes}
    trim = [changed["AHRS_TRIM_X"].new, changed["AHRS_TRIM_Y"].new]
    level = euler_matrix(*np.degrees(trim), 0.0) @ read
    np.testing.assert_allclose(level[:2] / level[2], [0, 0], atol=1e-7)
    assert changed["AHRS_TRIM_X"].sd == pytest.approx(1e-3 / STANDARD_GRAVITY)
    assert [c.name for c in plan.changes][-2:] == ["AHRS_TRIM_X", "AHRS_TRIM_Y"]


def test_a_level_that_was_never_measured_is_asked_for(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    fit = make_fit(Sensor.ACCEL, offset=[0.3, -0.2, 0.15], matrix_sd=1e-4)
    plan = compose([fit], ardupilot_parameters, ardupilot_fingerprint)
    assert not any("TRIM" in c.name for c in plan.changes)
    assert any("run the level job" in text for text in plan.warnings)


def test_px4_keeps_the_same_physical_attitude_level(px4_parameters, px4_fingerprint, make_fit):
    parameters = px4_parameters | {"SENS_BOARD_X_OFF": 1.5, "SENS_BOARD_Y_OFF": -0.8, "SENS_BOARD_Z_OFF": 3.0}
    fit = make_fit(Sensor.ACCEL, offset=[0.3, -0.2, 0.15], matrix=np.diag([1.03, 0.98, 1.02]), matrix_sd=1e-4)
    plan = compose([fit], parameters, px4_fingerprint)
    raw = px4.calibration_in_force(parameters, Sensor.ACCEL, 0).invert([0, 0, -STANDARD_GRAVITY])
    read = px4.calibration_in_force(after(plan, parameters), Sensor.ACCEL, 0).apply(raw)
    np.testing.assert_allclose(read[:2] / read[2], [0, 0], atol=1e-6)
    assert {c.unit for c in plan.changes if "SENS_BOARD" in c.name} == {"deg"}


@pytest.mark.parametrize(("offset", "said"), [(0.7, "4.1 deg"), (0.05, "0.3 deg"), (0.02, "")])
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_level_that_is_turned_noticeably_is_said(
    autopilot, offset, said, ardupilot_parameters, ardupilot_fingerprint, px4_parameters, px4_fingerprint, make_fit
):
    parameters = {
        "ardupilot": ardupilot_parameters | {"AHRS_TRIM_X": 0.02, "AHRS_TRIM_Y": -0.01},
        "px4": px4_parameters | {"SENS_BOARD_X_OFF": 1.5, "SENS_BOARD_Y_OFF": -0.8},
    }[autopilot]
    fit = make_fit(Sensor.ACCEL, offset=[0.0, offset, 0.0], matrix_sd=1e-4)
    plan = compose([fit], parameters, {"ardupilot": ardupilot_fingerprint, "px4": px4_fingerprint}[autopilot])
    notes = [text for text in plan.warnings if "level trim is turned" in text]
    assert len(notes) == bool(said)
    if said:
        assert f"turned by {said} with the new calibration of accel 1" in notes[0]
        assert "run the level job" in notes[0]
        assert any(c.name in ("AHRS_TRIM_X", "SENS_BOARD_X_OFF") for c in plan.changes)


def level_fit(make_fit, roll, pitch, **more):
    native = {"roll": roll, "pitch": pitch, "roll_sd": 1e-4, "pitch_sd": 2e-4}
    return make_fit(Sensor.ACCEL, method="level", native=native, **more)


def test_the_level_job_writes_roll_and_pitch(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    parameters = ardupilot_parameters | {"AHRS_TRIM_X": 0.02}
    plan = compose([level_fit(make_fit, 0.03, -0.015)], parameters, ardupilot_fingerprint)
    values = {c.name: (c.new, c.sd) for c in plan.changes}
    assert values == {
        "AHRS_TRIM_X": (float(np.float32(0.03)), pytest.approx(1e-4)),
        "AHRS_TRIM_Y": (float(np.float32(-0.015)), pytest.approx(2e-4)),
    }


def test_the_level_job_on_px4_starts_from_the_trim_in_force(px4_parameters, px4_fingerprint, make_fit):
    parameters = px4_parameters | {"SENS_BOARD_X_OFF": 2.0, "SENS_BOARD_Y_OFF": -1.0, "SENS_BOARD_Z_OFF": 30.0}
    board = force_when_level(0.06, 0.05)  # what the board reads on the level surface
    streamed = euler_matrix(2.0, -1.0, 30.0) @ board
    plan = compose([level_fit(make_fit, *trim_from_force(streamed))], parameters, px4_fingerprint)
    values = after(plan, parameters)
    assert values["SENS_BOARD_X_OFF"] == pytest.approx(np.degrees(0.06), abs=1e-5)
    assert values["SENS_BOARD_Y_OFF"] == pytest.approx(np.degrees(0.05), abs=1e-5)


def test_more_than_ten_degrees_is_refused(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    plan = compose([level_fit(make_fit, 0.2, 0.0)], ardupilot_parameters, ardupilot_fingerprint)
    assert "more than 10 deg" in plan.blockers[0]
    refused = level_fit(make_fit, 0.0, 0.0, status=FitStatus.REFUSED, message="not at rest")
    assert compose([refused], ardupilot_parameters, ardupilot_fingerprint).changes == ()


def levelled(make_fit, offset, **more):
    return make_fit(Sensor.ACCEL, offset=offset, matrix=np.diag([1.03, 1.0, 1.0]), matrix_sd=1e-4, **more)


def trim_changes(plan):
    return [c.name for c in plan.changes if "TRIM" in c.name or "SENS_BOARD" in c.name]


def test_a_trim_that_the_new_calibration_would_push_beyond_ten_degrees_is_left_alone(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    parameters = ardupilot_parameters | {"AHRS_TRIM_X": np.radians(9.0), "AHRS_TRIM_Y": 0.0}
    plan = compose([levelled(make_fit, [0.0, 0.4, 0.0])], parameters, ardupilot_fingerprint)
    assert any("would exceed 10 deg" in text for text in plan.warnings)
    assert not plan.blockers
    assert trim_changes(plan) == []
    inside = compose([levelled(make_fit, [0.0, -0.4, 0.0])], parameters, ardupilot_fingerprint)
    assert trim_changes(inside) == ["AHRS_TRIM_X"]
    assert not any("exceed" in text for text in inside.warnings)


def test_a_trim_is_not_rewritten_for_less_than_is_noticed(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    parameters = ardupilot_parameters | {"AHRS_TRIM_X": 0.02, "AHRS_TRIM_Y": 0.01}
    fits = {y: make_fit(Sensor.ACCEL, offset=[0.0, y, 0.03], offset_sd=1e-5, matrix_sd=1e-4) for y in (0.0, 0.01)}
    plans = {y: compose([fit], parameters, ardupilot_fingerprint) for y, fit in fits.items()}
    assert plans[0.0].changes
    assert trim_changes(plans[0.0]) == []
    assert trim_changes(plans[0.01]) == ["AHRS_TRIM_X", "AHRS_TRIM_Y"]


def test_a_trim_that_hangs_on_an_unknown_temperature_is_not_carried_over(px4_parameters, px4_fingerprint, make_fit):
    parameters = px4_parameters | {"SENS_BOARD_X_OFF": 1.5, "SENS_BOARD_Y_OFF": -0.8, "TC_A0_ID": 1310988}
    parameters |= {"TC_A0_TREF": 25.0, "TC_A0_TMIN": 0.0, "TC_A0_TMAX": 60.0}
    parameters |= {f"TC_A0_X{k}_{a}": 0.001 for k in range(4) for a in range(3)}
    fit = levelled(make_fit, [0.3, -0.2, 0.15], temperature=None)
    assert trim_changes(compose([fit], parameters, px4_fingerprint)) == ["SENS_BOARD_X_OFF", "SENS_BOARD_Y_OFF"]
    draft = Draft(parameters, ComposeOptions(), ParameterKind.INT32)
    compose_imu(draft, [Pair(Subject(Sensor.ACCEL, 0), fit, None)])
    draft.set_integer("TC_A_ENABLE", 1, Rank.THERMAL_ENABLE, "", kind=ParameterKind.INT32)
    adjust_trim(draft, "px4", [fit])
    plan = draft.plan(px4_fingerprint)
    assert any("cannot be carried over without a temperature" in text for text in plan.warnings)
    assert trim_changes(plan) == []


def test_a_vehicle_that_lists_no_trim_gets_none(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    del ardupilot_parameters["AHRS_TRIM_Y"]
    plan = compose([levelled(make_fit, [0.3, -0.2, 0.15])], ardupilot_parameters, ardupilot_fingerprint)
    assert plan.changes
    assert trim_changes(plan) == []
    assert not any("level" in text for text in plan.warnings)


def test_a_calibration_of_scale_zero_has_no_level_to_carry_over(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    parameters = ardupilot_parameters | {"AHRS_TRIM_X": 0.02, "INS_ACCSCAL_X": 0.0}
    plan = compose([levelled(make_fit, [0.3, -0.2, 0.15])], parameters, ardupilot_fingerprint)
    assert any("the level trim cannot be carried over" in text for text in plan.warnings)
    assert trim_changes(plan) == []


def test_a_level_within_its_uncertainty_agrees(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    parameters = ardupilot_parameters | {"AHRS_TRIM_X": 0.03, "AHRS_TRIM_Y": -0.015}
    plan = compose([level_fit(make_fit, 0.0301, -0.0151)], parameters, ardupilot_fingerprint)
    assert plan.nothing_to_write
    assert plan.agreements
    assert trim_changes(compose([level_fit(make_fit, 0.0306, -0.0151)], parameters, ardupilot_fingerprint)) == [
        "AHRS_TRIM_X",
        "AHRS_TRIM_Y",
    ]
