"""Motor compensation as parameters: signs, units, the one kind for all compasses, corrupt values."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.compose.draft import INTEGERS, Draft
from mavcal.calib.firmware.compose.mag_motor import compose_motors, corrupt_compensation
from mavcal.calib.firmware.options import ComposeOptions
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.fit import FitResult, FitStatus, parameter_names
from mavcal.calib.mag.motor_drives import METHOD
from mavcal.calib.recording import ParameterEntry, ParameterTimeline, Sensor
from mavcal.calib.triad import TriadModel

INTERFERENCE = {"current": [0.3, -0.2, 0.4], "throttle": [12.0, -8.0, 16.0]}  # uT per A, uT at full throttle


def ardupilot_parameters(**changed):
    values: dict[str, float | int] = {"COMPASS_MOTCT": 0, "AHRS_ORIENTATION": 0}
    for slot, digit in enumerate(("", "2")):
        values |= {f"COMPASS_{stem}{digit}_{a}": 0.0 for stem in ("OFS", "ODI", "MOT") for a in "XYZ"}
        values |= {f"COMPASS_DIA{digit}_{a}": 1.0 for a in "XYZ"}
        values |= {
            f"COMPASS_DEV_ID{digit}": 100 + slot,
            f"COMPASS_PRIO{slot + 1}_ID": 100 + slot,
            f"COMPASS_SCALE{digit}": 1.0,
            f"COMPASS_ORIENT{digit}": 0,
            "COMPASS_EXTERNAL" if not digit else "COMPASS_EXTERN2": 0,
        }
    return values | changed


def motor_fit(instance=0, drive="current", proposed=True, model=None, current_rms=0.4, throttle_rms=0.9):
    candidates = {
        kind: {"interference": term, "held_out_rms": rms, "proposed": True}
        for (kind, term), rms in zip(INTERFERENCE.items(), (current_rms, throttle_rms), strict=True)
    }
    native = {
        "proposed": proposed,
        "drive": drive if proposed else None,
        "held_out_rms_before": 1.8,
        "held_out_rms_after": candidates.get(drive, {"held_out_rms": 0.2})["held_out_rms"] if proposed else 1.8,
        "candidates": candidates,
    }
    return FitResult(
        method=METHOD,
        sensor=Sensor.MAG,
        instance=instance,
        status=FitStatus.OK,
        message="",
        model=model or TriadModel(),
        covariance=np.zeros((len(parameter_names()),) * 2),
        unit="uT",
        n_samples=1000,
        n_used=1000,
        residual_rms=0.1,
        condition_number=1.0,
        native=native,
    )


def composed(fits, parameters, autopilot="ardupilot"):
    draft = Draft(parameters, ComposeOptions(), INTEGERS[autopilot])
    compose_motors(draft, autopilot, fits)
    return draft


def test_what_is_written_takes_the_motors_field_off_as_the_firmware_adds_it():
    draft = composed([motor_fit()], ardupilot_parameters())
    amperes = np.array([0.0, 10.0, 25.0])
    added = ardupilot.motor_term(draft.predicted, 0, None, amperes)
    assert np.allclose(added, -np.outer(amperes, INTERFERENCE["current"]), atol=1e-5)
    assert draft.predicted["COMPASS_MOTCT"] == 2
    assert draft.predicted["COMPASS_MOT_X"] == pytest.approx(-3.0)


def test_the_term_is_carried_to_the_matrix_that_will_be_in_force():
    changed = {"COMPASS_DIA_X": 2.0}
    draft = composed([motor_fit()], ardupilot_parameters(**changed))
    assert draft.predicted["COMPASS_MOT_X"] == pytest.approx(-6.0)
    assert draft.predicted["COMPASS_MOT_Y"] == pytest.approx(2.0)


def test_one_kind_for_all_compasses_and_the_cost_is_said():
    fits = [motor_fit(0), motor_fit(1, drive="throttle", current_rms=0.6, throttle_rms=0.5)]
    draft = composed(fits, ardupilot_parameters())
    assert draft.predicted["COMPASS_MOTCT"] == 2
    assert draft.predicted["COMPASS_MOT2_X"] == pytest.approx(-3.0)


def test_nothing_proposed_writes_nothing_and_takes_off_what_does_not_help():
    assert composed([motor_fit(proposed=False)], ardupilot_parameters()).predicted == ardupilot_parameters()
    held = ardupilot_parameters(COMPASS_MOTCT=2, COMPASS_MOT_X=5.0)
    taken = composed([motor_fit(proposed=False)], held).predicted
    assert taken["COMPASS_MOT_X"] == 0.0
    assert taken["COMPASS_MOTCT"] == 0


def test_a_compass_outside_the_plan_blocks_a_change_of_kind():
    held = ardupilot_parameters(COMPASS_MOTCT=1, COMPASS_MOT2_X=40.0)
    plan_blockers = composed([motor_fit()], held)._blockers
    assert any("Compass 2" in text for text in plan_blockers)


def timeline(parameters):
    return ParameterTimeline(tuple(ParameterEntry(0.0, n, v) for n, v in parameters.items()), end_observed=True)


def test_corrupt_parameters_are_named_and_sound_ones_are_not():
    assert corrupt_compensation("ardupilot", timeline(ardupilot_parameters()), 0) == ""
    bad = timeline(ardupilot_parameters(COMPASS_MOT_Y=math.nan))
    assert "COMPASS_MOT_Y = nan" in corrupt_compensation("ardupilot", bad, 0)
    assert corrupt_compensation("ardupilot", bad, 1) == ""
    absurd = timeline(ardupilot_parameters(COMPASS_MOTCT=2, COMPASS_MOT_X=1e6))
    assert "COMPASS_MOT_X = 1e+06" in corrupt_compensation("ardupilot", absurd, 0)
    assert corrupt_compensation(None, bad, 0) == ""


def px4_parameters(rows=2, **changed):
    values: dict[str, float | int] = {"CAL_MAG_COMP_TYP": 0, "SENS_BOARD_ROT": 0}
    values |= {f"SENS_BOARD_{a}_OFF": 0.0 for a in "XYZ"}
    for slot in range(4):
        values |= {f"CAL_MAG{slot}_{a}{stem}": 0.0 for stem in ("OFF", "ODIAG", "COMP") for a in "XYZ"}
        values |= {f"CAL_MAG{slot}_{a}SCALE": 1.0 for a in "XYZ"}
        values |= {f"CAL_MAG{slot}_ID": 100 + slot if slot < rows else 0, f"CAL_MAG{slot}_ROT": 0}
        values |= {f"CAL_MAG{slot}_PRIO": 50}
    return values | changed


@pytest.mark.parametrize(("drive", "kind"), [("current", 2), ("throttle", 1)])
def test_on_px4_it_is_subtracted_at_the_sensor_in_gauss_per_kiloampere_or_at_full_thrust(drive, kind):
    matrix = np.array([[1.1, 0.02, 0.0], [0.02, 0.95, 0.01], [0.0, 0.01, 1.05]])
    better = {"current_rms": 0.4, "throttle_rms": 0.9} if drive == "current" else {"current_rms": 0.9}
    better |= {} if drive == "current" else {"throttle_rms": 0.4}
    fit = motor_fit(drive=drive, model=TriadModel(np.zeros(3), matrix), **better)
    draft = composed([fit], px4_parameters(), "px4")
    written = np.array([draft.predicted[f"CAL_MAG0_{a}COMP"] for a in "XYZ"])
    per_unit = -np.linalg.solve(matrix, INTERFERENCE[drive]) / 100.0  # 100 uT to the gauss
    assert np.allclose(written, per_unit * (1000.0 if drive == "current" else 1.0), rtol=1e-6)
    assert draft.predicted["CAL_MAG_COMP_TYP"] == kind
    changes = {change.name: change for change in draft.changes}
    assert changes["CAL_MAG0_XCOMP"].unit == ("gauss/kA" if drive == "current" else "gauss")
    assert changes["CAL_MAG_COMP_TYP"].kind == "int32"
    assert changes["CAL_MAG_COMP_TYP"].why == f"compensate against {drive}"


def test_what_is_written_on_px4_takes_the_motors_field_off():
    draft = composed([motor_fit()], px4_parameters(), "px4")
    amperes = np.array([0.0, 10.0, 25.0])
    added = px4.motor_term(draft.predicted, 0, None, {0: amperes})
    assert np.allclose(added, -np.outer(amperes, INTERFERENCE["current"]), atol=1e-5)


def test_the_units_of_ardupilot_are_told_apart():
    units = {}
    for drive, rms in (("current", (0.4, 0.9)), ("throttle", (0.9, 0.4))):
        fit = motor_fit(drive=drive, current_rms=rms[0], throttle_rms=rms[1])
        draft = composed([fit], ardupilot_parameters())
        units |= {drive: {c.name: c.unit for c in draft.changes}["COMPASS_MOT_X"]}
        assert {c.name: c.kind for c in draft.changes}["COMPASS_MOTCT"] == "int8"
    assert units == {"current": "mGauss/A", "throttle": "mGauss"}


def test_counts_are_refused():
    fit = dataclasses.replace(motor_fit(), unit="counts")
    draft = composed([fit], ardupilot_parameters())
    assert draft._blockers == ["mag 1: the fit is in counts, parameters are in gauss"]
    assert draft.changes == ()
    idle = dataclasses.replace(motor_fit(proposed=False), unit="counts")
    assert composed([idle], ardupilot_parameters())._blockers == []


def test_the_kind_stays_for_a_compass_outside_the_plan_that_uses_it():
    held = ardupilot_parameters(COMPASS_MOTCT=2, COMPASS_MOT_X=5.0, COMPASS_MOT2_Y=7.0)
    draft = composed([motor_fit(proposed=False)], held)
    assert draft.predicted["COMPASS_MOT_X"] == 0.0
    assert draft.predicted["COMPASS_MOT2_Y"] == 7.0
    changed = composed([motor_fit()], px4_parameters(CAL_MAG_COMP_TYP=1, CAL_MAG1_YCOMP=0.5), "px4")
    (blocker,) = changed._blockers
    assert "CAL_MAG_COMP_TYP would change from 1 to 2 for every compass. Compass 2" in blocker


def test_the_cost_of_the_one_kind_is_that_of_the_hidden_data():
    fits = [motor_fit(0), motor_fit(1, drive="throttle", current_rms=0.6, throttle_rms=0.5)]
    (loss,) = composed(fits, ardupilot_parameters()).losses
    assert loss.cost == pytest.approx(0.1)
    assert (loss.sensor, loss.instance, loss.unit) == (Sensor.MAG, 1, "uT")
    assert "best against throttle" in loss.text
    assert "written against current: 0.1 uT more" in loss.text


def test_limits_of_a_compensation_on_px4_depend_on_its_kind():
    def told(**changed):
        return corrupt_compensation("px4", timeline(px4_parameters(**changed)), 0)

    assert told(CAL_MAG_COMP_TYP=1, CAL_MAG0_XCOMP=9.9) == ""
    assert "CAL_MAG0_XCOMP = 10.1" in told(CAL_MAG_COMP_TYP=1, CAL_MAG0_XCOMP=10.1)
    assert told(CAL_MAG_COMP_TYP=2, CAL_MAG0_XCOMP=999.0) == ""
    assert "CAL_MAG0_XCOMP = -1001" in told(CAL_MAG_COMP_TYP=2, CAL_MAG0_XCOMP=-1001.0)
    assert "CAL_MAG0_XCOMP = 1001" in told(CAL_MAG_COMP_TYP=3, CAL_MAG0_XCOMP=1001.0)
    assert told(CAL_MAG_COMP_TYP=0, CAL_MAG0_XCOMP=1e6) == ""
    assert "CAL_MAG0_XCOMP = 0.1" in told(CAL_MAG_COMP_TYP=math.nan, CAL_MAG0_XCOMP=0.1)


def test_a_parameter_that_was_corrupt_at_any_end_of_the_recording_is_named():
    entries = [ParameterEntry(0.0, n, v) for n, v in ardupilot_parameters(COMPASS_OFS_Z=math.inf).items()]
    mended = ParameterTimeline((*entries, ParameterEntry(5.0, "COMPASS_OFS_Z", 1.0)), end_observed=True)
    assert "COMPASS_OFS_Z = inf" in corrupt_compensation("ardupilot", mended, 0)
    assert corrupt_compensation("ardupilot", timeline({"COMPASS_OFS_X": 0.0}), 3) == ""


def test_nothing_to_take_off_changes_no_kind():
    assert composed([motor_fit(proposed=False)], px4_parameters(), "px4").changes == ()
    taken = composed([motor_fit(proposed=False)], px4_parameters(CAL_MAG_COMP_TYP=1), "px4")
    assert [(c.name, c.new, c.why) for c in taken.changes] == [("CAL_MAG_COMP_TYP", 0, "no compass needs compensation")]
    assert composed([], px4_parameters(CAL_MAG_COMP_TYP=1), "px4").changes == ()


def test_a_kind_that_hidden_data_do_not_want_is_not_written_in_place_of_the_best():
    fit = motor_fit(drive="current")
    wanted = {**fit.native["candidates"]}
    wanted["current"] = {**wanted["current"], "proposed": False}
    fit = dataclasses.replace(fit, native={**fit.native, "candidates": wanted})
    assert composed([fit], ardupilot_parameters()).predicted["COMPASS_MOTCT"] == 1
