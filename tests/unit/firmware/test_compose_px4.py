from __future__ import annotations

import numpy as np
import pytest

from calib import STANDARD_GRAVITY
from calib.firmware import px4
from calib.firmware.compose import ComposeOptions, compose
from calib.recording import Sensor
from calib.triad import ThermalPolynomial


def after(plan, parameters):
    return {**parameters, **{c.name: c.new for c in plan.changes}}


def live(plan, parameters, sensor, instance=0):
    """What is in PX4's memory after the plan was written, one parameter after the other, without a restart."""
    memory = px4.Px4Calibration.load(parameters, sensor, instance)
    stored = dict(parameters)
    for change in plan.changes:
        stored[change.name] = change.new
        memory = memory.update(stored)
    return px4.calibration_in_force(stored, sensor, instance, memory)


def rebooted(plan, parameters, sensor, instance=0):
    return px4.calibration_in_force(after(plan, parameters), sensor, instance)


def test_accelerometer_offset_and_scale(px4_parameters, px4_fingerprint, make_fit):
    fit = make_fit(Sensor.ACCEL, offset=[0.31, -0.22, 0.17], matrix=np.diag([1.021, 0.984, 1.013]), matrix_sd=1e-4)
    plan = compose([fit], px4_parameters, px4_fingerprint)
    for model in (live(plan, px4_parameters, Sensor.ACCEL), rebooted(plan, px4_parameters, Sensor.ACCEL)):
        np.testing.assert_allclose(model.offset, fit.model.offset, rtol=1e-6)
        np.testing.assert_allclose(model.matrix, fit.model.matrix, rtol=1e-6, atol=1e-12)
    assert not plan.needs_reboot
    assert not plan.losses
    assert plan.after == ()
    assert [c.name for c in plan.changes if c.session] == ["SENS_IMU_AUTOCAL"]
    names = [c.name for c in plan.changes]
    assert max(names.index(f"CAL_ACC0_{a}OFF") for a in "XYZ") < min(names.index(f"CAL_ACC0_{a}SCALE") for a in "XYZ")


@pytest.mark.parametrize("seed", range(20))
def test_the_order_of_writing_brings_every_component_into_memory(px4_parameters, px4_fingerprint, make_fit, seed):
    """Or the plan says that a restart is needed; after one, or where it says a loss, the prediction holds."""
    rng = np.random.default_rng(seed)
    size = 10 ** rng.uniform(-3, -0.5)
    parameters = px4_parameters | {f"CAL_ACC0_{a}OFF": v for a, v in zip("XYZ", rng.normal(0, 0.05, 3), strict=True)}
    parameters |= {f"CAL_ACC0_{a}SCALE": v for a, v in zip("XYZ", rng.normal(1, 0.01, 3), strict=True)}
    fit = make_fit(
        Sensor.ACCEL, offset=rng.normal(0, size, 3), matrix=np.diag(rng.normal(1, size / 5, 3)), matrix_sd=1e-4
    )
    plan = compose([fit], parameters, px4_fingerprint)
    later = rebooted(plan, parameters, Sensor.ACCEL)
    what = {loss.what for loss in plan.losses}
    if "offset" not in what:
        np.testing.assert_allclose(later.offset, fit.model.offset, atol=1e-7)
    if "scale and cross terms" not in what:
        np.testing.assert_allclose(later.matrix, fit.model.matrix, atol=1e-6)
    now = live(plan, parameters, Sensor.ACCEL)
    if not plan.needs_reboot:
        np.testing.assert_allclose(now.offset, later.offset, atol=1e-7)
        np.testing.assert_allclose(now.matrix, later.matrix, atol=1e-7)


def test_what_is_there_already_needs_no_session_settings_either(px4_parameters, px4_fingerprint, make_fit):
    fit = make_fit(Sensor.GYRO, offset=[0.0132, -0.0284, 0.0057])
    plan = compose([fit], px4_parameters, px4_fingerprint)
    held = px4_parameters | {c.name: c.new for c in plan.changes if not c.session}
    assert compose([fit], held, px4_fingerprint).changes == ()


def test_a_scale_within_one_percent_is_lost_with_its_cost(px4_parameters, px4_fingerprint, make_fit):
    fit = make_fit(Sensor.ACCEL, offset=[0.3, 0, 0], matrix=np.diag([1.004, 0.997, 1.005]), matrix_sd=1e-4)
    plan = compose([fit], px4_parameters, px4_fingerprint)
    assert not any("SCALE" in c.name for c in plan.changes)
    (loss,) = plan.losses
    assert loss.cost == pytest.approx(STANDARD_GRAVITY * (1 - 1 / 1.005), rel=1e-6)
    assert "never reach PX4's memory" in loss.text


def test_a_small_change_of_a_large_offset_needs_a_restart(px4_parameters, px4_fingerprint, make_fit):
    parameters = px4_parameters | {"CAL_ACC0_XOFF": 0.05}
    fit = make_fit(Sensor.ACCEL, offset=[0.057, 0, 0], matrix=np.diag([1.03, 1.0, 1.0]), matrix_sd=1e-4)
    plan = compose([fit], parameters, px4_fingerprint)
    (change,) = [c for c in plan.changes if c.name == "CAL_ACC0_XOFF"]
    assert change.needs_reboot
    assert "after a restart" in change.why
    assert live(plan, parameters, Sensor.ACCEL).offset[0] == pytest.approx(0.05)
    assert rebooted(plan, parameters, Sensor.ACCEL).offset[0] == pytest.approx(0.057)


def test_a_fine_offset_is_lost_unless_the_thermal_term_can_hold_it(px4_parameters, px4_fingerprint, make_fit):
    fit = make_fit(Sensor.ACCEL, offset=[0.004, -0.003, 0.005], matrix=np.diag([1.03, 1.0, 1.0]), matrix_sd=1e-4)
    (loss,) = compose([fit], px4_parameters, px4_fingerprint).losses
    assert (loss.what, loss.cost) == ("offset", pytest.approx(np.linalg.norm([0.004, -0.003, 0.005])))

    parameters = px4_parameters | {"TC_A_ENABLE": 1, "TC_A0_ID": 1310988, "TC_A0_TREF": 25.0}
    parameters |= {"TC_A0_TMIN": 0.0, "TC_A0_TMAX": 60.0}
    parameters |= {f"TC_A0_X{k}_{a}": 0.001 if k == 1 else 0.0 for k in range(4) for a in range(3)}
    plan = compose([fit], parameters, px4_fingerprint)
    assert not plan.losses
    assert not plan.needs_reboot
    for model in (live(plan, parameters, Sensor.ACCEL), rebooted(plan, parameters, Sensor.ACCEL)):
        raw = fit.model.invert([[0, 0, -9.8]])
        np.testing.assert_allclose(model.apply(raw, np.array([32.0])), [[0, 0, -9.8]], atol=1e-6)


def test_gyro_small_offset_is_taken_at_boot_only(px4_parameters, px4_fingerprint, make_fit):
    fit = make_fit(Sensor.GYRO, offset=[0.004, -0.003, 0.005])
    plan = compose([fit], px4_parameters, px4_fingerprint)
    assert plan.needs_reboot
    np.testing.assert_allclose(rebooted(plan, px4_parameters, Sensor.GYRO).offset, fit.model.offset, rtol=1e-6)
    assert any("IMU_GYRO_CAL_EN" in text for text in plan.warnings)

    large = make_fit(Sensor.GYRO, offset=[0.0132, -0.0284, 0.0057])
    plan = compose([large], px4_parameters, px4_fingerprint)
    assert not plan.needs_reboot
    np.testing.assert_allclose(live(plan, px4_parameters, Sensor.GYRO).offset, large.model.offset, rtol=1e-6)


def test_an_empty_row_needs_the_device_id(px4_parameters, px4_fingerprint, make_fit):
    parameters = px4_parameters | {"CAL_GYRO0_ID": 0}
    fit = make_fit(Sensor.GYRO, offset=[0.0132, -0.0284, 0.0057])
    assert "CAL_GYRO0_ID is 0" in compose([fit], parameters, px4_fingerprint).blockers[0]
    options = ComposeOptions(device_ids={(Sensor.GYRO, 0): 1310988})
    plan = compose([fit], parameters, px4_fingerprint, options=options)
    assert (plan.changes[-1].name, plan.changes[-1].new, plan.changes[-1].kind) == ("CAL_GYRO0_ID", 1310988, "int32")
    np.testing.assert_allclose(live(plan, parameters, Sensor.GYRO).offset, fit.model.offset, rtol=1e-6)


def test_rows_are_found_by_device_and_the_guess_is_said(px4_parameters, px4_fingerprint, make_fit):
    parameters = px4_parameters | {"CAL_ACC0_ID": 0, "CAL_ACC1_ID": 11, "CAL_ACC2_ID": 22}
    fits = [make_fit(Sensor.ACCEL, i, offset=[0.1 * (i + 1), 0, 0], matrix_sd=1e-4) for i in (0, 1)]
    plan = compose(fits, parameters, px4_fingerprint)
    values = {c.name: c.new for c in plan.changes}
    assert values["CAL_ACC1_XOFF"] == pytest.approx(0.1)
    assert values["CAL_ACC2_XOFF"] == pytest.approx(0.2)
    assert sum("do not say which device" in text for text in plan.warnings) == 2


def cubic(t_ref=35.0):
    return ThermalPolynomial(t_ref, 15.0, 60.0, [[7e-3, 6e-5, 1e-7], [-4e-3, -3e-5, 0.0], [9e-3, 4e-5, 0.0]])


def test_thermal_gyro_is_absolute(px4_parameters, px4_fingerprint, make_fit):
    fit = make_fit(Sensor.GYRO, offset=[0.0132, -0.0284, 0.0057], polynomial=cubic(), polynomial_sd=1e-5)
    plan = compose([fit], px4_parameters, px4_fingerprint)
    assert plan.needs_reboot
    assert not plan.blockers
    model = rebooted(plan, px4_parameters, Sensor.GYRO)
    t = np.linspace(5, 70, 50)
    np.testing.assert_allclose(model.apply(np.zeros((50, 3)), t), fit.model.apply(np.zeros((50, 3)), t), atol=1e-7)
    names = [c.name for c in plan.changes]
    assert names.index("TC_G0_X3_2") < names.index("TC_G_ENABLE") < names.index("CAL_GYRO0_XOFF")


def shape(make_fit, **more):
    undetermined = tuple(f"offset_{a}" for a in "xyz")
    return make_fit(Sensor.ACCEL, polynomial=cubic(), polynomial_sd=1e-5, undetermined=undetermined, **more)


def test_thermal_shape_of_an_accelerometer_keeps_the_offset_at_its_own_temperature(
    px4_parameters, px4_fingerprint, make_fit
):
    parameters = px4_parameters | {"CAL_ACC0_XOFF": 0.2, "CAL_ACC0_YOFF": -0.1}
    plan = compose([shape(make_fit)], parameters, px4_fingerprint)
    (loss,) = plan.losses
    assert loss.what == "temperature drift"
    assert "does not store at which temperature" in loss.text
    assert not [c for c in plan.changes if c.name.startswith("TC_")]

    options = ComposeOptions(accel_temperature={0: 22.0})
    plan = compose([shape(make_fit)], parameters, px4_fingerprint, options=options)
    model = rebooted(plan, parameters, Sensor.ACCEL)
    np.testing.assert_allclose(model.apply([[0.2, -0.1, 0.0]], np.array([22.0])), np.zeros((1, 3)), atol=1e-6)
    drift = model.apply(np.zeros((1, 3)), np.array([50.0])) - model.apply(np.zeros((1, 3)), np.array([22.0]))
    np.testing.assert_allclose(drift, cubic()([22.0]) - cubic()([50.0]), atol=1e-6)


def test_thermal_and_six_faces_in_one_plan(px4_parameters, px4_fingerprint, make_fit):
    rest = make_fit(Sensor.ACCEL, offset=[0.31, -0.22, 0.17], matrix=np.diag([1.02, 0.98, 1.01]), matrix_sd=1e-4)
    plan = compose([rest, shape(make_fit)], px4_parameters, px4_fingerprint)
    model = rebooted(plan, px4_parameters, Sensor.ACCEL)
    np.testing.assert_allclose(
        model.apply([[0.31, -0.22, 0.17]], np.array([rest.temperature])), np.zeros((1, 3)), atol=1e-6
    )


def test_compensation_that_does_not_run_blocks(px4_parameters, px4_fingerprint, make_fit):
    del px4_parameters["TC_G_ENABLE"]
    fit = make_fit(Sensor.GYRO, offset=[0.0132, -0.0284, 0.0057], polynomial=cubic())
    assert "does not list TC_G_ENABLE" in compose([fit], px4_parameters, px4_fingerprint).blockers[0]
