from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.procedures.level import SPEC, LevelProcedure, roll_pitch
from mavcal.calib.procedures.protocol import Done, GaveUp
from mavcal.calib.procedures.spec import ProcedureContext
from mavcal.calib.recording import Identity

CONTEXT = ProcedureContext(identity=Identity(autopilot="other"), parameters={"X": 1.0})


def run(recording, context=CONTEXT, **options):
    procedure = LevelProcedure(SPEC.validated(options), context)
    procedure.feed(recording)
    procedure.end()
    return procedure


def good(bench):
    return replace(bench().accels[0], offset=(0.0, 0.0, 0.0), sensitivity=np.eye(3))


@pytest.mark.parametrize(("roll", "pitch"), [(3.0, -2.0), (-7.0, 4.0), (0.0, 0.0)])
def test_roll_and_pitch_of_the_board_are_found_within_their_uncertainty(bench, roll, pitch):
    pose = Rotation.from_euler("ZYX", [40.0, pitch, roll], degrees=True)
    procedure = run(bench(accels=(good(bench),)).hold(10.0, pose).record())
    assert isinstance(procedure.outcome, Done)
    (fit,) = procedure.outcome.results
    assert abs(fit.native["roll"] - math.radians(roll)) < 4.5 * fit.native["roll_sd"]
    assert abs(fit.native["pitch"] - math.radians(pitch)) < 4.5 * fit.native["pitch_sd"]
    assert max(fit.quality["roll_sd_deg"], fit.quality["pitch_sd_deg"]) <= 0.05


def test_signs_with_literal_numbers():
    roll, pitch = roll_pitch(np.array([0.0, 9.80665, 0.0]))  # on the left side the right side points up
    assert (roll, pitch) == pytest.approx((-math.pi / 2, 0.0))
    roll, pitch = roll_pitch(np.array([1.0, 0.0, -9.7]))  # the nose is up
    assert pitch == pytest.approx(math.atan2(1.0, 9.7))
    assert roll == 0.0


def test_the_calibration_in_force_of_ardupilot_is_applied(bench):
    offset = (0.31, -0.22, 0.17)
    accel = replace(good(bench), offset=offset)
    parameters = {f"INS_ACCOFFS_{a}": v for a, v in zip("XYZ", offset, strict=True)}
    parameters |= {f"INS_ACCSCAL_{a}": 1.0 for a in "XYZ"} | {"AHRS_ORIENTATION": 0, "INS_TCAL1_ENABLE": 0}
    context = ProcedureContext(identity=Identity(autopilot="ardupilot"), parameters=parameters)
    (fit,) = run(bench(accels=(accel,)).hold(10.0).record(), context).outcome.results
    assert abs(fit.native["roll"]) < 4.5 * fit.native["roll_sd"]
    assert not fit.relative


def test_an_uncalibrated_accelerometer_is_refused(bench):
    accel = replace(good(bench), offset=(0.0, 0.0, 0.6))
    outcome = run(bench(accels=(accel,)).hold(10.0).record()).outcome
    assert isinstance(outcome, GaveUp)
    assert "not calibrated" in outcome.cause


def test_a_vehicle_on_a_slope_is_refused(bench):
    pose = Rotation.from_euler("ZYX", [0.0, 0.0, 14.0], degrees=True)
    outcome = run(bench(accels=(good(bench),)).hold(10.0, pose).record()).outcome
    assert isinstance(outcome, GaveUp)
    assert "tilted by 14 deg" in outcome.cause


def test_a_vehicle_in_the_hand_is_not_level(bench):
    outcome = run(bench(accels=(good(bench),)).hold(60.0, tremor=1.5).record(), patience=20.0).outcome
    assert isinstance(outcome, GaveUp)
    assert "no rest" in outcome.cause


def test_units_that_disagree_are_named(bench):
    accels = (good(bench), replace(good(bench), offset=(0.28, 0.0, 0.0)))
    outcome = run(bench(accels=accels, gyros=bench().gyros * 2).hold(10.0).record()).outcome
    assert isinstance(outcome, Done)
    assert any(" 1.7 deg" in w for w in outcome.results[0].warnings)
