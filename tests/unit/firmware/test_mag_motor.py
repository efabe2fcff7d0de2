"""Motor compensation as parameters: signs, units, the one kind for all compasses, corrupt values."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calib.firmware import ardupilot
from calib.firmware.draft import Draft
from calib.firmware.mag_motor import compose_motors, corrupt_compensation
from calib.firmware.options import ComposeOptions
from calib.fit import FitResult, FitStatus, parameter_names
from calib.mag.motor import METHOD
from calib.recording import ParameterEntry, ParameterTimeline, Sensor
from calib.triad import TriadModel

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
        kind: {"interference": term, "held_out_rms": rms}
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
    draft = Draft(parameters, ComposeOptions())
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
    assert any("compass 2" in text for text in plan_blockers)


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
