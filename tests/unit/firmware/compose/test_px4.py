from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.firmware.compose.plan import ComposeOptions, compose
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial


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
    return ThermalPolynomial(t_ref, 15.0, 60.0, [[7e-3, 6e-5, 2e-7], [-4e-3, -3e-5, 0.0], [9e-3, 4e-5, 0.0]])


@pytest.mark.parametrize("writer", [0, 1])
def test_thermal_gyro_is_absolute(px4_parameters, px4_fingerprint, make_fit, writer):
    """While PX4's own writer runs, it would rewrite a new CAL_GYRO before the restart: X0 holds the offset then."""
    px4_parameters |= {"IMU_GYRO_CAL_EN": writer, "CAL_GYRO0_XOFF": 0.05}
    fit = make_fit(Sensor.GYRO, offset=[0.0132, -0.0284, 0.0057], polynomial=cubic(), polynomial_sd=1e-5)
    plan = compose([fit], px4_parameters, px4_fingerprint)
    assert plan.needs_reboot
    assert not plan.blockers
    model = rebooted(plan, px4_parameters, Sensor.GYRO)
    t = np.linspace(5, 70, 50)
    np.testing.assert_allclose(model.apply(np.zeros((50, 3)), t), fit.model.apply(np.zeros((50, 3)), t), atol=1e-7)
    names = [c.name for c in plan.changes]
    assert names.index("TC_G0_X2_2") < names.index("TC_G_ENABLE")
    assert ("CAL_GYRO0_XOFF" in names) == (writer == 0)
    assert ("TC_G0_X0_0" in names) == (writer == 1 or "TC_G0_X0_0" not in px4_parameters)


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
    assert "TC_G_ENABLE" in compose([fit], px4_parameters, px4_fingerprint).blockers[0]


def compensated(px4_parameters, slope=0.001, **more):
    """The accelerometer's temperature compensation runs, with a constant of its own."""
    parameters = px4_parameters | {"TC_A_ENABLE": 1, "TC_A0_ID": 1310988, "TC_A0_TREF": 25.0}
    parameters |= {"TC_A0_TMIN": 0.0, "TC_A0_TMAX": 60.0}
    parameters |= {f"TC_A0_X{k}_{a}": slope if k == 1 else 0.0 for k in range(4) for a in range(3)}
    return parameters | more


def test_a_fine_change_of_a_large_offset_goes_into_the_running_thermal_term(px4_parameters, px4_fingerprint, make_fit):
    offset = {"CAL_ACC0_XOFF": 0.2, "CAL_ACC0_YOFF": -0.1, "CAL_ACC0_ZOFF": 0.3, "TC_A0_X0_1": 0.02}
    parameters = compensated(px4_parameters, slope=0.0, TC_A0_X1_0=0.001, **offset)
    fit = make_fit(Sensor.ACCEL, offset=[0.212, -0.085, 0.305], matrix=np.diag([1.03, 1.0, 1.0]), matrix_sd=1e-4)
    plan = compose([fit], parameters, px4_fingerprint)
    changes = {c.name: c for c in plan.changes}
    assert changes["TC_A0_X0_0"].new == pytest.approx(0.212 - 0.2 - 7.0 * 0.001, rel=1e-5)
    assert changes["TC_A0_X0_1"].new == pytest.approx(0.02 + (-0.085 - 0.02) + 0.1, rel=1e-5)
    assert changes["TC_A0_X0_2"].new == pytest.approx(0.305 - 0.3, rel=1e-5)
    assert (changes["TC_A0_X0_0"].unit, changes["TC_A0_X0_0"].sd) == ("m/s2", pytest.approx(1e-3))
    assert not any(name.endswith("OFF") for name in changes)
    assert not plan.needs_reboot
    model = live(plan, parameters, Sensor.ACCEL)
    raw = fit.model.invert([[0, 0, -9.8]])
    np.testing.assert_allclose(model.apply(raw, np.array([32.0])), [[0, 0, -9.8]], atol=1e-6)


def test_a_fine_offset_before_a_compensation_that_a_restart_starts_is_held_by_it(
    px4_parameters, px4_fingerprint, make_fit
):
    rest = make_fit(Sensor.ACCEL, offset=[0.004, -0.003, 0.005], matrix=np.diag([1.03, 1.0, 1.0]), matrix_sd=1e-4)
    plan = compose([rest, shape(make_fit)], px4_parameters, px4_fingerprint)
    assert not [loss for loss in plan.losses if loss.what == "offset"]
    model = rebooted(plan, px4_parameters, Sensor.ACCEL)
    raw = rest.model.invert([[0, 0, -9.8]])
    np.testing.assert_allclose(model.apply(raw, np.array([rest.temperature])), [[0, 0, -9.8]], atol=1e-6)


def test_an_offset_too_fine_for_the_memory_goes_into_the_thermal_constant_that_a_restart_starts(
    px4_parameters, px4_fingerprint, make_fit
):
    """At the reference temperature of the drift the compensation takes nothing of it: all of it must find a place."""
    offset = [0.004, -0.003, 0.005]
    rest = make_fit(Sensor.ACCEL, offset=offset, offset_sd=1e-3, temperature=cubic().t_ref)
    plan = compose([rest, shape(make_fit)], px4_parameters, px4_fingerprint)
    constants = [c for c in plan.changes if c.name.startswith("TC_A0_X0_")]
    assert [c.new for c in constants] == pytest.approx(offset, rel=1e-6)
    assert [c.sd for c in constants] == pytest.approx([1e-3] * 3)
    assert not any(c.name.startswith("CAL_ACC0_") and c.name.endswith("OFF") for c in plan.changes)
    assert not [loss for loss in plan.losses if loss.what == "offset"]
    model = rebooted(plan, px4_parameters, Sensor.ACCEL)
    np.testing.assert_allclose(model.apply([offset], np.array([cubic().t_ref])), np.zeros((1, 3)), atol=1e-8)


def test_an_offset_of_unknown_temperature_is_refused_while_the_compensation_runs(
    px4_parameters, px4_fingerprint, make_fit
):
    fit = make_fit(Sensor.ACCEL, offset=[0.3, -0.2, 0.1], matrix_sd=1e-4, temperature=None)
    (blocker,) = compose([fit], compensated(px4_parameters), px4_fingerprint).blockers
    assert "the temperature during the calibration is not known" in blocker
    assert compose([fit], px4_parameters, px4_fingerprint).blockers == ()


def test_an_offset_is_not_written_without_the_axis_that_its_fit_leaves_open(px4_parameters, px4_fingerprint, make_fit):
    known = {"offset": [0.3, -0.2, 0.1], "matrix": np.diag([1.03, 1.0, 1.0]), "undetermined": ("offset_y",)}
    plan = compose([make_fit(Sensor.ACCEL, matrix_sd=1e-4, **known)], px4_parameters, px4_fingerprint)
    assert "the offset of y is not determined, and the others do not hold without it" in plan.blockers[0]
    assert not [c for c in plan.changes if c.name.startswith("CAL_ACC0")]


def test_a_gyroscopes_open_axis_keeps_its_value_and_its_own_uncertainty(px4_parameters, px4_fingerprint, make_fit):
    parameters = px4_parameters | {"CAL_GYRO0_YOFF": 0.04}
    fit = make_fit(Sensor.GYRO, offset=[0.0132, -0.0284, 0.0057], undetermined=("offset_y",))
    plan = compose([fit], parameters, px4_fingerprint)
    assert not plan.blockers
    assert any("the offset of y is not determined and stays as it is" in text for text in plan.warnings)
    model = rebooted(plan, parameters, Sensor.GYRO)
    np.testing.assert_allclose(model.offset, [0.0132, 0.04, 0.0057], rtol=1e-6)
    assert {c.name: c.sd for c in plan.changes if "CAL_GYRO0" in c.name} == {
        "CAL_GYRO0_XOFF": pytest.approx(1e-3),
        "CAL_GYRO0_ZOFF": pytest.approx(1e-3),
    }


def test_a_scale_that_the_fit_leaves_open_is_refused(px4_parameters, px4_fingerprint, make_fit):
    known = {"offset": [0.3, -0.2, 0.1], "matrix": np.diag([1.03, 1.0, 0.97]), "undetermined": ("matrix_zz",)}
    plan = compose([make_fit(Sensor.ACCEL, matrix_sd=1e-4, **known)], px4_parameters, px4_fingerprint)
    assert "matrix_zz are not determined" in plan.blockers[0]
    assert not [c for c in plan.changes if "SCALE" in c.name]


def test_a_disabled_sensor_is_said_to_be(px4_parameters, px4_fingerprint, make_fit):
    fit = make_fit(Sensor.GYRO, offset=[0.0132, -0.0284, 0.0057])

    def told(priority):
        return [
            text
            for text in compose([fit], px4_parameters | {"CAL_GYRO0_PRIO": priority}, px4_fingerprint).warnings
            if "disabled" in text
        ]

    assert told(0) == ["gyro 1 is disabled (CAL_GYRO0_PRIO = 0); it stays so"]
    assert told(-1) == told(50) == []


@pytest.mark.parametrize(("rows", "guessed"), [({}, False), ({"CAL_GYRO1_ID": 7}, True)])
def test_the_one_filled_row_is_no_guess(px4_parameters, px4_fingerprint, make_fit, rows, guessed):
    fit = make_fit(Sensor.GYRO, offset=[0.0132, -0.0284, 0.0057])
    plan = compose([fit], px4_parameters | rows, px4_fingerprint)
    assert any("gyro 1" in text and "CAL_GYRO0_ID" in text for text in plan.warnings) == guessed


def test_what_writes_the_same_parameters_is_named_only_where_it_does(px4_parameters, px4_fingerprint, make_fit):
    gyro = make_fit(Sensor.GYRO, offset=[0.0132, -0.0284, 0.0057])
    accel = make_fit(Sensor.ACCEL, offset=[0.3, -0.2, 0.1], matrix_sd=1e-4)

    def warned(fit, enabled):
        plan = compose([fit], px4_parameters | {"IMU_GYRO_CAL_EN": enabled}, px4_fingerprint)
        return any("IMU_GYRO_CAL_EN" in text for text in plan.warnings)

    assert warned(gyro, 1)
    assert not warned(gyro, 0)
    assert not warned(accel, 1)
    off = compose([gyro], px4_parameters | {"SENS_IMU_AUTOCAL": 0}, px4_fingerprint)
    assert not [c for c in off.changes if c.session]


def test_a_drift_that_px4_cannot_hold_is_refused_before_anything_of_it_is_planned(
    px4_parameters, px4_fingerprint, make_fit
):
    steep = ThermalPolynomial(35.0, 15.0, 60.0, [[7e-3, 6e-5, 1e-7, 1e-9]] * 3)
    short = ThermalPolynomial(35.0, 30.0, 38.0, [[7e-3]] * 3)
    for polynomial, text in (
        (steep, "a polynomial of degree 4 cannot be stored; fit again with degree 3"),
        (short, "the drift is known from 30.0 to 38.0 degC only; at least 10 degC are needed"),
    ):
        fit = make_fit(Sensor.GYRO, offset=[0.0132, -0.0284, 0.0057], polynomial=polynomial, polynomial_sd=1e-5)
        plan = compose([fit], px4_parameters, px4_fingerprint)
        assert text in plan.blockers[0]
        assert not [c for c in plan.changes if c.name.startswith("TC_")]


def test_an_axis_without_a_determined_drift_is_not_compensated_and_named(px4_parameters, px4_fingerprint, make_fit):
    open_axis = ("poly1_y", "poly2_y", "poly3_y")
    fit = make_fit(
        Sensor.GYRO,
        offset=[0.0132, -0.0284, 0.0057],
        polynomial=cubic(),
        polynomial_sd=1e-5,
        undetermined=open_axis,
    )
    plan = compose([fit], px4_parameters | {"IMU_GYRO_CAL_EN": 0}, px4_fingerprint)
    values = {c.name: c.new for c in plan.changes}
    assert any("the drift of the y axis is not determined and is not compensated" in text for text in plan.warnings)
    assert [values.get(f"TC_G0_X{k}_1", 0.0) for k in range(4)] == [0.0] * 4
    assert values["TC_G0_X1_0"] == pytest.approx(7e-3)
    assert values["TC_G0_X1_2"] == pytest.approx(9e-3)


def test_a_drift_of_a_lower_degree_clears_the_powers_above_it(px4_parameters, px4_fingerprint, make_fit):
    held = {f"TC_G0_X{k}_{a}": 0.5 for k in range(4) for a in range(3)} | {"IMU_GYRO_CAL_EN": 0}
    line = ThermalPolynomial(35.0, 15.0, 60.0, [[7e-3], [-4e-3], [9e-3]])
    fit = make_fit(Sensor.GYRO, offset=[0.0132, -0.0284, 0.0057], polynomial=line, polynomial_sd=1e-5)
    values = after(compose([fit], px4_parameters | held, px4_fingerprint), px4_parameters | held)
    assert [values[f"TC_G0_X{k}_0"] for k in range(4)] == pytest.approx([0.0, 7e-3, 0.0, 0.0])
    assert (values["TC_G0_TREF"], values["TC_G0_TMIN"], values["TC_G0_TMAX"]) == (35.0, 15.0, 60.0)
    assert (values["TC_G0_ID"], values["TC_G_ENABLE"]) == (1310988, 1)


def test_a_drift_of_an_accelerometer_that_was_never_calibrated_says_what_comes_next(
    px4_parameters, px4_fingerprint, make_fit
):
    plan = compose([shape(make_fit)], px4_parameters, px4_fingerprint)
    assert "accel 1 was never calibrated: calibrate it after this, with the compensation running" in plan.warnings
    values = {c.name: c.new for c in plan.changes}
    assert [values.get(f"TC_A0_X0_{a}", 0.0) for a in range(3)] == [0.0] * 3
    assert values["TC_A0_X1_0"] == pytest.approx(7e-3)


def test_the_constant_of_a_drift_carries_the_uncertainty_of_the_curve_down_to_its_temperature(
    px4_parameters, px4_fingerprint, make_fit
):
    parameters = px4_parameters | {"CAL_ACC0_XOFF": 0.2, "CAL_ACC0_YOFF": -0.1}
    options = ComposeOptions(accel_temperature={0: 22.0})
    plan = compose([shape(make_fit)], parameters, px4_fingerprint, options=options)
    (constant,) = [c for c in plan.changes if c.name == "TC_A0_X0_0"]
    distance = 22.0 - 35.0
    sds = 1e-5 * np.array([1.0, 0.1, 0.01])
    assert constant.sd == pytest.approx(np.sqrt(((sds * distance ** np.arange(1, 4)) ** 2).sum()))
    assert constant.new == pytest.approx(-cubic()(22.0)[0], rel=1e-5)


def test_a_fine_change_counts_by_the_axes_that_were_measured(px4_parameters, px4_fingerprint, make_fit):
    """3.7 sd of one axis are more than chance for two axes, and would not be for three."""
    held = px4_parameters | {"CAL_GYRO0_XOFF": 0.05, "CAL_GYRO0_YOFF": 0.04}
    fit = make_fit(Sensor.GYRO, offset=[0.0537, 0.0, 0.0], undetermined=("offset_y",))
    plan = compose([fit], held, px4_fingerprint)
    assert not plan.agreements
    assert [(c.name, c.needs_reboot) for c in plan.changes if not c.session] == [("CAL_GYRO0_XOFF", True)]


def test_a_drift_beside_a_calibration_leaves_no_constant(px4_parameters, px4_fingerprint, make_fit):
    rest = make_fit(Sensor.ACCEL, offset=[0.31, -0.22, 0.17], matrix=np.diag([1.02, 0.98, 1.01]), matrix_sd=1e-4)
    held = px4_parameters | {"CAL_ACC0_XOFF": 0.2}
    options = ComposeOptions(accel_temperature={0: 22.0})
    values = after(compose([rest, shape(make_fit)], held, px4_fingerprint, options=options), held)
    assert [values[f"TC_A0_X0_{a}"] for a in range(3)] == [0.0] * 3


def test_an_open_axis_of_a_running_compensation_stands_in_the_way(px4_parameters, px4_fingerprint, make_fit):
    """The offset that stays behind would refer to another temperature than the two that are written."""
    running = px4_parameters | {"TC_G_ENABLE": 1, "TC_G0_ID": 1310988, "TC_G0_TREF": 25.0}
    running |= {"TC_G0_TMIN": 0.0, "TC_G0_TMAX": 60.0}
    running |= {f"TC_G0_X{k}_{a}": 0.001 if k == 1 else 0.0 for k in range(4) for a in range(3)}
    fit = make_fit(Sensor.GYRO, offset=[0.0132, 0.0, 0.0057], undetermined=("offset_y",))
    assert "the others do not hold without it" in compose([fit], running, px4_fingerprint).blockers[0]
    assert not compose([fit], px4_parameters, px4_fingerprint).blockers
    thermal = make_fit(
        Sensor.GYRO, offset=[0.0132, 0.0, 0.0057], undetermined=("offset_y",), polynomial=cubic(), polynomial_sd=1e-5
    )
    assert not compose([thermal], px4_parameters, px4_fingerprint).blockers


def test_a_drift_has_nowhere_to_go_when_other_sensors_hold_every_thermal_row(px4_parameters, px4_fingerprint, make_fit):
    parameters = compensated(px4_parameters) | {f"TC_A{slot}_ID": 4711 + slot for slot in range(4)}
    (blocker,) = compose([shape(make_fit)], parameters, px4_fingerprint).blockers
    assert "accel 1" in blocker
    assert "free row" in blocker
    free = compose([shape(make_fit)], parameters | {"TC_A1_ID": 0}, px4_fingerprint)
    assert not any("free row" in text for text in free.blockers)


def test_a_fine_offset_of_a_gyroscope_goes_into_its_running_thermal_term(px4_parameters, px4_fingerprint, make_fit):
    rest = make_fit(Sensor.GYRO, offset=[0.002, -0.001, 0.003], offset_sd=1e-5)
    parameters = px4_parameters | {"TC_G_ENABLE": 1, "TC_G0_ID": px4_parameters["CAL_GYRO0_ID"], "TC_G0_TREF": 25.0}
    parameters |= {"TC_G0_TMIN": 0.0, "TC_G0_TMAX": 60.0}
    parameters |= {f"TC_G0_X{k}_{a}": 0.0 for k in range(4) for a in range(3)}
    plan = compose([rest], parameters, px4_fingerprint)
    assert {c.name for c in plan.changes if not c.session} == {f"TC_G0_X0_{a}" for a in range(3)}
