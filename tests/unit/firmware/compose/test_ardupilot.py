from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.compose.plan import ComposeOptions, compose
from mavcal.calib.firmware.limits import limit_of
from mavcal.calib.firmware.plan import ParameterKind
from mavcal.calib.fit import FitStatus
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import TriadModel

SHEARED = np.array([[1.02, 0.004, -0.002], [0.004, 0.97, 0.003], [-0.002, 0.003, 1.01]])


def new_values(plan):
    return {change.name: change.new for change in plan.changes}


def written(plan, parameters):
    return {**parameters, **new_values(plan)}


def test_gyro_offsets_of_every_instance_under_their_own_names(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    fits = [make_fit(Sensor.GYRO, i, offset=[0.01 * (i + 1), -0.02, 0.005]) for i in (0, 1)]
    plan = compose(fits, ardupilot_parameters, ardupilot_fingerprint)
    values = new_values(plan)
    assert values["INS_GYROFFS_X"] == float(np.float32(0.01))
    assert values["INS_GYR2OFFS_X"] == float(np.float32(0.02))
    assert values["INS_GYR1_CALTEMP"] == values["INS_GYR2_CALTEMP"] == 32.0
    assert not plan.blockers
    assert all(c.kind == ParameterKind.REAL32 for c in plan.changes)
    assert any("INS_GYR_CAL = 1" in text for text in plan.warnings)
    assert {c.name: c.sd for c in plan.changes}["INS_GYROFFS_X"] == pytest.approx(1e-3)


def test_gyro_offsets_survive_the_boot_only_if_the_operator_says_so(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    options = ComposeOptions(keep_gyro_at_boot=True)
    plan = compose(
        [make_fit(Sensor.GYRO, offset=[0.01] * 3)], ardupilot_parameters, ardupilot_fingerprint, options=options
    )
    (change,) = [c for c in plan.changes if c.name == "INS_GYR_CAL"]
    assert (change.old, change.new, change.kind, change.session) == (1, 0, ParameterKind.INT8, False)
    assert not plan.warnings


def test_accelerometer_is_corrected_as_fitted_up_to_the_announced_loss(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    fit = make_fit(Sensor.ACCEL, offset=[0.3, -0.2, 0.15], matrix=SHEARED, matrix_sd=1e-4)
    plan = compose(
        [fit, make_fit(Sensor.ACCEL, 1, offset=[0.1] * 3, matrix_sd=1e-4)], ardupilot_parameters, ardupilot_fingerprint
    )
    model = ardupilot.calibration_in_force(written(plan, ardupilot_parameters), Sensor.ACCEL, 0)
    np.testing.assert_allclose(model.offset, [0.3, -0.2, 0.15], rtol=1e-7)
    np.testing.assert_allclose(np.diag(model.matrix), np.diag(SHEARED), rtol=1e-7)
    (loss,) = [x for x in plan.losses if x.instance == 0]
    directions = np.random.default_rng(1).normal(size=(200_000, 3))
    truth = STANDARD_GRAVITY * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    left = np.linalg.norm(model.apply(fit.model.invert(truth)) - truth, axis=1).max()
    assert left == pytest.approx(loss.cost, rel=1e-3)
    assert left <= loss.cost + 1e-6
    assert loss.unit == "m/s2"


def test_the_reference_temperature_is_written_before_the_offset_and_scale_last(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    plan = compose(
        [make_fit(Sensor.ACCEL, offset=[0.1] * 3, matrix=SHEARED, matrix_sd=1e-4)],
        ardupilot_parameters,
        ardupilot_fingerprint,
    )
    assert [c.name for c in plan.changes] == [
        "INS_ACC1_CALTEMP",
        *(f"INS_ACCOFFS_{a}" for a in "XYZ"),
        *(f"INS_ACCSCAL_{a}" for a in "XYZ"),
    ]


def test_sd_of_the_scale_is_that_of_the_symmetric_part(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    angle = 0.3
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    fit = make_fit(Sensor.ACCEL, offset=[0.1] * 3, matrix=turn @ SHEARED, matrix_sd=0.0)
    # the covariance of the turned matrix: the entries of C = Q S, S_ij with sd 1e-4
    jacobian = np.zeros((9, 6))
    for k, (i, j) in enumerate([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]):
        unit = np.zeros((3, 3))
        unit[i, j] = unit[j, i] = 1.0
        jacobian[:, k] = (turn @ unit).ravel()
    covariance = fit.covariance.copy()
    covariance[3:12, 3:12] = 1e-8 * jacobian @ jacobian.T
    object.__setattr__(fit, "covariance", covariance)
    plan = compose([fit], ardupilot_parameters, ardupilot_fingerprint)
    sds = {c.name: c.sd for c in plan.changes}
    assert [sds[f"INS_ACCSCAL_{a}"] for a in "XYZ"] == pytest.approx([1e-4] * 3, rel=1e-9)
    (mounting,) = [x for x in plan.losses if x.what == "mounting"]
    assert mounting.cost == pytest.approx(2 * STANDARD_GRAVITY * np.sin(angle / 2), rel=1e-9)


def test_code_76_only_if_every_used_accelerometer_deserves_it(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    one = [make_fit(Sensor.ACCEL, 0, offset=[0.1] * 3, matrix_sd=1e-4)]
    plan = compose(one, ardupilot_parameters, ardupilot_fingerprint)
    assert plan.after == ()
    assert any("accelerometer 2 is in use but was never calibrated" in text for text in plan.warnings)

    both = [*one, make_fit(Sensor.ACCEL, 1, offset=[0.1] * 3, matrix_sd=1e-4)]
    (after,) = compose(both, ardupilot_parameters, ardupilot_fingerprint).after
    assert (after.command, after.params) == (241, (0, 0, 0, 0, 76, 0, 0))

    for change in ({"INS_ACC2OFFS_Y": 0.05}, {"INS_USE2": 0}):
        assert compose(one, ardupilot_parameters | change, ardupilot_fingerprint).after == (after,)
    absent = {"INS_ACC2OFFS_Y": 0.05, "INS_ACC2SCAL_X": 0.0, "INS_ACC2SCAL_Y": 0.0, "INS_ACC2SCAL_Z": 0.0}
    assert compose(one, ardupilot_parameters | absent, ardupilot_fingerprint).after == ()


@pytest.mark.parametrize(
    ("offset", "matrix", "name"),
    [
        ([3.6, 0, 0], None, "INS_ACCOFFS_X"),
        ([0, 0, -3.51], None, "INS_ACCOFFS_Z"),
        ([0, 0, 0], np.diag([1.0, 1.21, 1.0]), "INS_ACCSCAL_Y"),
        ([0, 0, 0], np.diag([1.0, 1.0, 0.79]), "INS_ACCSCAL_Z"),
    ],
)
def test_values_beyond_the_limits_block_the_plan(
    ardupilot_parameters, ardupilot_fingerprint, make_fit, offset, matrix, name
):
    fit = make_fit(Sensor.ACCEL, offset=offset, matrix=matrix, matrix_sd=1e-4)
    limit = limit_of(name)
    (text,) = compose([fit], ardupilot_parameters, ardupilot_fingerprint).blockers
    assert text.startswith(name)
    assert f" {limit.low:g} ..." in text
    assert f" {limit.high:g} " in text


def test_relative_and_refused_fits_are_not_written(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    relative = make_fit(Sensor.GYRO, offset=[0.01] * 3, relative=True)
    assert "relative" in compose([relative], ardupilot_parameters, ardupilot_fingerprint).blockers[0]
    refused = make_fit(Sensor.GYRO, 1, status=FitStatus.REFUSED, message="it turned")
    plan = compose([refused], ardupilot_parameters, ardupilot_fingerprint)
    assert plan.changes == ()
    assert any("nothing to write" in text for text in plan.blockers)
    plan = compose([refused, make_fit(Sensor.GYRO, offset=[0.01] * 3)], ardupilot_parameters, ardupilot_fingerprint)
    assert not plan.blockers
    assert any("it turned" in text for text in plan.warnings)


def test_an_undetermined_gyro_axis_stays_and_an_accelerometer_axis_blocks(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    fit = make_fit(Sensor.GYRO, offset=[0.01] * 3, undetermined=("offset_z",))
    plan = compose([fit], ardupilot_parameters, ardupilot_fingerprint)
    assert "INS_GYROFFS_Z" not in new_values(plan)
    assert "INS_GYROFFS_Y" in new_values(plan)
    assert any("offset of z is not determined" in text for text in plan.warnings)
    fit = make_fit(Sensor.ACCEL, offset=[0.01] * 3, matrix_sd=1e-3, undetermined=("offset_z",))
    assert compose([fit], ardupilot_parameters, ardupilot_fingerprint).blockers


def test_an_offset_taken_with_scale_one_does_not_join_another_scale(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    fit = make_fit(Sensor.ACCEL, offset=[0.1] * 3)
    assert not compose([fit], ardupilot_parameters, ardupilot_fingerprint).blockers
    (text,) = compose([fit], ardupilot_parameters | {"INS_ACCSCAL_X": 1.01}, ardupilot_fingerprint).blockers
    assert "assumes scales of [1.0, 1.0, 1.0]" in text
    fit = dataclasses.replace(fit, model=TriadModel(fit.model.offset, np.diag([1.01, 1.0, 1.0])))
    assert not compose([fit], ardupilot_parameters | {"INS_ACCSCAL_X": 1.01}, ardupilot_fingerprint).blockers


def test_parameters_that_the_vehicle_does_not_have_block(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    plan = compose([make_fit(Sensor.GYRO, 2, offset=[0.01] * 3)], ardupilot_parameters, ardupilot_fingerprint)
    assert "INS_GYR3OFFS_X" in plan.blockers[0]
    assert "INS_GYR3OFFS_X" not in new_values(plan)


def test_an_unknown_temperature_is_not_pretended(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    fit = make_fit(Sensor.ACCEL, offset=[0.1] * 3, matrix_sd=1e-4, temperature=None)
    plan = compose([fit], ardupilot_parameters | {"INS_ACC1_CALTEMP": 25.0}, ardupilot_fingerprint)
    assert new_values(plan)["INS_ACC1_CALTEMP"] == -300.0
    plan = compose([fit], ardupilot_parameters | {"INS_TCAL1_ENABLE": 1}, ardupilot_fingerprint)
    assert any("INS_ACC1_CALTEMP cannot be written" in text for text in plan.blockers)


def test_values_that_are_already_there_are_not_written_again(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    fit = make_fit(Sensor.GYRO, offset=[0.01, -0.02, 0.005])
    first = compose([fit], ardupilot_parameters, ardupilot_fingerprint)
    again = compose([fit], written(first, ardupilot_parameters), ardupilot_fingerprint)
    assert again.changes == ()
    assert again.snapshot_sha256 != first.snapshot_sha256


def test_a_gyro_result_that_dies_at_the_next_boot_is_said_first_with_the_way_to_keep_it(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    refused = make_fit(Sensor.GYRO, 1, status=FitStatus.REFUSED, message="it moved")
    plan = compose([refused, make_fit(Sensor.GYRO, offset=[0.01] * 3)], ardupilot_parameters, ardupilot_fingerprint)
    assert plan.warnings[0].startswith("the next boot discards these gyro offsets")
    assert "keep_gyro_at_boot (--keep-gyro-at-boot)" in plan.warnings[0]


def test_a_sensor_that_cannot_be_written_does_not_keep_the_others_from_it(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    broken = make_fit(Sensor.ACCEL, 1, offset=[9.0, 0.0, 0.0], matrix_sd=1e-4)
    good = make_fit(Sensor.ACCEL, 0, offset=[0.1, 0.0, 0.0], matrix_sd=1e-4)
    plan = compose([good, broken], ardupilot_parameters, ardupilot_fingerprint)
    assert not plan.blockers
    assert {c.instance for c in plan.changes} == {0}
    (text,) = [w for w in plan.warnings if "left out" in w]
    assert text.startswith("accel 2 is left out: INS_ACC2OFFS_X would be 9 m/s2")
    assert not plan.after  # code 76 would mark the second one as calibrated
    assert any("accelerometer 2 is in use but was never calibrated" in w for w in plan.warnings)
    assert compose([broken], ardupilot_parameters, ardupilot_fingerprint).blockers


def test_only_the_sensors_that_were_asked_for_are_planned(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    fits = [make_fit(Sensor.GYRO, i, offset=[0.01, 0.02, 0.03]) for i in (0, 1)]
    one = ComposeOptions(only=((Sensor.GYRO, 1),))
    plan = compose(fits, ardupilot_parameters, ardupilot_fingerprint, options=one)
    assert {(c.sensor, c.instance) for c in plan.changes} == {(Sensor.GYRO, 1)}
    unknown = ComposeOptions(only=((Sensor.GYRO, 1), (Sensor.ACCEL, 0)))
    plan = compose(fits, ardupilot_parameters, ardupilot_fingerprint, options=unknown)
    assert "there is no accel0 to plan for; there are: gyro0, gyro1" in plan.blockers[0]


def test_the_level_is_that_of_the_first_accelerometer_whichever_is_planned(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    parameters = ardupilot_parameters | {"AHRS_TRIM_X": 0.02, "AHRS_TRIM_Y": -0.01}
    fits = [make_fit(Sensor.ACCEL, i, offset=[0.3, 0.2, 0.1], matrix_sd=1e-4) for i in (0, 1)]
    names = [
        {c.name for c in compose(fits, parameters, ardupilot_fingerprint, options=ComposeOptions(only=only)).changes}
        for only in ((), ((Sensor.ACCEL, 0),), ((Sensor.ACCEL, 1),))
    ]
    assert ["AHRS_TRIM_X" in found for found in names] == [True, True, False]


def test_a_recording_without_a_board_id_is_written_only_as_confirmed(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    fit = make_fit(Sensor.GYRO, offset=[0.01] * 3)
    said = "the recording does not say which board it is of"
    options = ComposeOptions(unproved_origin=said)
    (blocker,) = compose([fit], ardupilot_parameters, ardupilot_fingerprint, options=options).blockers
    assert blocker.startswith(said)
    assert blocker.endswith("Confirm it with the plan option confirm_other_unit (--confirm-other-unit)")
    options = ComposeOptions(unproved_origin=said, confirm_other_unit=True)
    plan = compose([fit], ardupilot_parameters, ardupilot_fingerprint, options=options)
    assert not plan.blockers
    assert plan.warnings[0] == f"{said}; the operator has confirmed that it is of this vehicle"
