from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.compose.ardupilot import ardupilot_coefficients, recentre
from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial

CURVE = ThermalPolynomial(25.0, 10.0, 60.0, [[7e-3, 6e-5, 1e-7], [-4e-3, -3e-5, 2e-7], [9e-3, 4e-5, 0.0]])
SHAPE_ONLY = tuple(f"offset_{a}" for a in "xyz")


def after(plan, parameters):
    return {**parameters, **{c.name: c.new for c in plan.changes}}


def test_recentring_keeps_the_curve_up_to_its_constant():
    t = np.linspace(12, 58, 20)
    new = ThermalPolynomial(35.0, 10.0, 60.0, 1e-6 * ardupilot_coefficients(CURVE))
    np.testing.assert_allclose(new(t) + CURVE(35.0), CURVE(t), atol=1e-12)
    np.testing.assert_array_equal(recentre(3, 2.0), [[1, 4, 12], [0, 1, 6], [0, 0, 1]])


@pytest.mark.parametrize("caltemp", [5.0, 22.0, 71.0])
def test_the_shape_leaves_the_offset_right_at_its_own_temperature(
    ardupilot_parameters, ardupilot_fingerprint, make_fit, caltemp
):
    parameters = ardupilot_parameters | {"INS_ACCOFFS_X": 0.2, "INS_ACC1_CALTEMP": caltemp}
    fit = make_fit(Sensor.ACCEL, polynomial=CURVE, polynomial_sd=1e-5, undetermined=SHAPE_ONLY)
    plan = compose([fit], parameters, ardupilot_fingerprint)
    assert not plan.blockers
    assert not plan.needs_reboot
    assert "INS_ACCOFFS_X" not in {c.name for c in plan.changes}
    model = ardupilot.calibration_in_force(after(plan, parameters), Sensor.ACCEL, 0)
    np.testing.assert_allclose(model.apply([[0.2, 0, 0]], np.array([caltemp])), np.zeros((1, 3)), atol=1e-6)
    drift = model.apply(np.zeros((1, 3)), np.array([50.0])) - model.apply(np.zeros((1, 3)), np.array([20.0]))
    np.testing.assert_allclose(drift, [CURVE(20.0) - CURVE(50.0)], atol=1e-6)


def test_an_unknown_caltemp_declines_the_accelerometer_and_keeps_the_gyroscope(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    accel = make_fit(Sensor.ACCEL, polynomial=CURVE, polynomial_sd=1e-5, undetermined=SHAPE_ONLY)
    gyro = make_fit(Sensor.GYRO, offset=[0.01, 0.02, 0.03], polynomial=CURVE, polynomial_sd=1e-5)
    plan = compose([accel, gyro], ardupilot_parameters, ardupilot_fingerprint)
    assert not plan.blockers
    (loss,) = plan.losses
    assert loss.sensor == Sensor.ACCEL
    assert "INS_ACC1_CALTEMP does not say" in loss.text
    values = {c.name: c.new for c in plan.changes}
    assert {values[f"INS_TCAL1_ACC{k}_{a}"] for k in (1, 2, 3) for a in "XYZ"} == {0.0}
    model = ardupilot.calibration_in_force(after(plan, ardupilot_parameters), Sensor.GYRO, 0)
    t = np.linspace(5, 70, 30)
    np.testing.assert_allclose(
        model.apply(np.zeros((30, 3)), t), fit_apply := gyro.model.apply(np.zeros((30, 3)), t), atol=1e-6
    )
    assert fit_apply.shape == (30, 3)
    names = [c.name for c in plan.changes]
    assert names.index("INS_GYR1_CALTEMP") < names.index("INS_TCAL1_GYR1_X") < names.index("INS_TCAL1_ENABLE")
    assert names.index("INS_TCAL1_ENABLE") < names.index("INS_GYROFFS_X")
    assert {c.name: c.old for c in plan.changes}["INS_TCAL1_GYR1_X"] is None

    alone = compose([accel], ardupilot_parameters, ardupilot_fingerprint)
    assert "nothing to write: accel 1: its drift is not written" in alone.blockers[0]


def test_both_sensors_share_the_range_that_both_know(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    narrow = ThermalPolynomial(35.0, 20.0, 55.0, CURVE.coefficients)
    parameters = ardupilot_parameters | {"INS_ACC1_CALTEMP": 30.0}
    fits = [
        make_fit(Sensor.ACCEL, polynomial=CURVE, undetermined=SHAPE_ONLY),
        make_fit(Sensor.GYRO, offset=[0.01] * 3, polynomial=narrow),
    ]
    values = {c.name: c.new for c in compose(fits, parameters, ardupilot_fingerprint).changes}
    assert (values["INS_TCAL1_TMIN"], values["INS_TCAL1_TMAX"]) == (20.0, 55.0)


def test_coefficients_in_force_of_the_other_sensor_stay_in_their_range(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    parameters = ardupilot_parameters | {"INS_TCAL1_ENABLE": 1, "INS_TCAL1_TMIN": 15.0, "INS_TCAL1_TMAX": 50.0}
    parameters |= {f"INS_TCAL1_{s}{k}_{a}": 0.0 for s in ("ACC", "GYR") for k in (1, 2, 3) for a in "XYZ"}
    parameters |= {"INS_TCAL1_ACC1_X": 500.0}
    fit = make_fit(Sensor.GYRO, offset=[0.01] * 3, polynomial=CURVE)
    values = after(compose([fit], parameters, ardupilot_fingerprint), parameters)
    assert (values["INS_TCAL1_TMIN"], values["INS_TCAL1_TMAX"]) == (15.0, 50.0)
    assert values["INS_TCAL1_ACC1_X"] == 500.0


def test_a_declined_axis_is_not_compensated(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    declined = tuple(f"poly{k}_x" for k in (1, 2, 3))
    curve = ThermalPolynomial(35.0, 10.0, 60.0, CURVE.coefficients * [[0.0], [1.0], [1.0]])
    fit = make_fit(
        Sensor.GYRO, offset=[0.01] * 3, polynomial=curve, polynomial_sd=1e-6, undetermined=("offset_x", *declined)
    )
    plan = compose([fit], ardupilot_parameters, ardupilot_fingerprint)
    changes = {c.name: c for c in plan.changes}
    assert (changes["INS_TCAL1_GYR1_X"].new, changes["INS_TCAL1_GYR1_X"].sd) == (0.0, None)
    assert changes["INS_TCAL1_GYR1_Y"].sd is not None
    assert any("drift of the x axis is not determined" in text for text in plan.warnings)
    assert "INS_GYROFFS_X" not in changes
    assert "INS_GYROFFS_Y" in changes
    assert not plan.blockers


def test_a_unit_without_any_drift_is_left_out_and_does_not_block_the_others(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    nothing = (*SHAPE_ONLY, *(f"poly{k}_{a}" for a in "xyz" for k in (1, 2, 3)))
    flat = ThermalPolynomial(35.0, 10.0, 60.0, np.zeros((3, 3)))
    fits = [
        make_fit(Sensor.GYRO, 0, offset=[0.01] * 3, polynomial=CURVE),
        make_fit(Sensor.GYRO, 1, polynomial=flat, undetermined=nothing),
    ]
    plan = compose(fits, ardupilot_parameters, ardupilot_fingerprint)
    assert not plan.blockers
    assert not any("TCAL2" in c.name or c.name.startswith("INS_GYR2") for c in plan.changes)
    assert any("gyro 2 is left out" in text for text in plan.warnings)


@pytest.mark.parametrize(
    ("change", "polynomial", "text"),
    [
        ({"INS_TCAL1_ENABLE": 2}, CURVE, "learning"),
        ({}, ThermalPolynomial(35.0, 30.0, 38.0, CURVE.coefficients), "at least 10 degC"),
        ({}, ThermalPolynomial(35.0, 10.0, 60.0, np.ones((3, 4)) * 1e-6), "degree 4"),
    ],
)
def test_what_cannot_be_stored_blocks(ardupilot_parameters, ardupilot_fingerprint, make_fit, change, polynomial, text):
    fit = make_fit(Sensor.GYRO, offset=[0.01] * 3, polynomial=polynomial)
    plan = compose([fit], ardupilot_parameters | change, ardupilot_fingerprint)
    assert any(text in b for b in plan.blockers)


def test_a_board_without_the_feature_blocks(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    del ardupilot_parameters["INS_TCAL1_ENABLE"]
    fit = make_fit(Sensor.GYRO, offset=[0.01] * 3, polynomial=CURVE)
    plan = compose([fit], ardupilot_parameters, ardupilot_fingerprint)
    assert "INS_TCAL1_ENABLE" in plan.blockers[0]
    assert not any("TCAL1" in change.name for change in plan.changes)


@pytest.mark.parametrize(("apart", "written"), [(0.0, False), (2e-4, False), (2e-3, True)])
def test_an_offset_that_still_holds_at_its_temperature_is_left_alone(
    ardupilot_parameters, ardupilot_fingerprint, make_fit, apart, written
):
    fit = make_fit(
        Sensor.GYRO, offset=[0.01, 0.02, 0.03], polynomial=CURVE, polynomial_sd=1e-6, offset_sd=2e-5, temperature=25.0
    )
    stored = fit.model.bias(22.0) + np.array([apart, 0.0, 0.0])
    parameters = ardupilot_parameters | {"INS_GYR1_CALTEMP": 22.0}
    parameters |= {f"INS_GYROFFS_{a}": float(v) for a, v in zip("XYZ", stored, strict=True)}
    names = {c.name for c in compose([fit], parameters, ardupilot_fingerprint).changes}
    assert ("INS_GYROFFS_X" in names) is written
    assert "INS_GYR1_CALTEMP" not in names
    assert "INS_TCAL1_GYR1_X" in names
