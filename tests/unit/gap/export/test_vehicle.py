"""Effects that are calibrations: with the plan written, the firmware corrects them away."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.export import ParameterFormat
from mavcal.calib.firmware.names import ardupilot_compass_names, ardupilot_imu_names
from mavcal.calib.firmware.rotations import rotation_matrix
from mavcal.calib.gap.export import Target, exported
from mavcal.calib.gap.export.sensor_errors import REFERENCE_TEMPERATURE
from mavcal.calib.gap.export.vehicle import _reference, corrected_model, vehicle_plan
from mavcal.calib.gap.schema import EffectEstimate, Unknown
from mavcal.calib.recording import Identity, ParameterEntry, ParameterTimeline, Recording, Sensor
from mavcal.calib.triad import ThermalPolynomial, TriadModel
from tests.parameter_files import read_parameters

from .making import effect, report

INTEGERS = {"id", "use", "priority", "external", "rotation", "motor_type", "thermal_id", "thermal_enable"}


def parameters(**changed: float) -> dict[str, float | int]:
    """One calibrated inertial unit and compass of an ArduPilot."""
    values: dict[str, float | int] = {"AHRS_ORIENTATION": 0, "INS_GYR_CAL": 1, "COMPASS_LEARN": 0}
    values |= {"AHRS_TRIM_X": 0.0, "AHRS_TRIM_Y": 0.0, "COMPASS_OFFS_MAX": 1800.0}
    for names in (*(ardupilot_imu_names(s, 0) for s in (Sensor.ACCEL, Sensor.GYRO)), ardupilot_compass_names(0, 0)):
        for role, name in names.items():
            if "TCAL" in name and not name.endswith("ENABLE"):
                continue
            values[name] = 0 if role in INTEGERS else (1.0 if role.startswith("scale_") else 0.0)
    values |= {"INS_ACC_ID": 2753028, "INS_GYR_ID": 2753029, "INS_USE": 1}
    values |= {"COMPASS_DEV_ID": 97539, "COMPASS_PRIO1_ID": 97539, "COMPASS_USE": 1, "COMPASS_EXTERNAL": 1}
    values |= {"INS_ACCOFFS_X": 0.1, "INS_ACCSCAL_Y": 1.01, "INS_GYROFFS_Z": 0.002}
    values |= {"COMPASS_OFS_X": 5.0, "COMPASS_OFS_Y": 13.0, "COMPASS_OFS_Z": -18.0}
    return {**values, **changed}


def flown(values: dict[str, float | int]) -> Recording:
    entries = tuple(ParameterEntry(0.0, name, value) for name, value in values.items())
    identity = Identity("ardupilot", 2, (4, 7, 0), "0123")
    return Recording((), parameters=ParameterTimeline(entries, end_observed=True), identity=identity)


CASES = {
    "accelerometer": (
        Sensor.ACCEL,
        (effect("accel_bias", bias=(0.3, -0.2, 0.15)), effect("accel_scale", scale=(0.02, -0.01, 0.015))),
    ),
    "gyroscope": (Sensor.GYRO, (effect("gyro_bias", bias=(0.01, -0.015, 0.008)),)),
    "compass": (
        Sensor.MAG,
        (
            effect("mag_hard_iron", hard_iron=(-6.0, 4.0, -3.0)),
            effect("mag_soft_iron", soft_iron={"xx": 0.05, "yy": -0.03, "zz": -0.02, "xy": 0.03, "yz": -0.01}),
        ),
    ),
}


def affected(sensor: Sensor, effects: tuple[EffectEstimate, ...], values: dict[str, float | int]) -> tuple[object, ...]:
    """Truth in body axes, and the raw reading of a sensor with the effects, as the diagnosis states them."""
    from mavcal.calib.gap.export.sensor_errors import sensors_with

    truth = {Sensor.ACCEL: 9.0, Sensor.GYRO: 2.0, Sensor.MAG: 40.0}[sensor] * np.random.default_rng(3).normal(
        size=(50, 3)
    )
    force = ardupilot.calibration_in_force(values, sensor, 0)
    turn = ardupilot.mounting(values, sensor, 0)
    ideal = truth @ (turn @ np.linalg.inv(force.matrix)).T  # at the sensor's scale, in body axes
    errors = sensors_with(effects).errors[sensor, 1]
    seen = ideal @ errors.matrix.T + errors.bias
    return truth, seen @ turn + force.offset


@pytest.mark.parametrize("orientation", [0, 2])
@pytest.mark.parametrize("name", CASES)
def test_with_the_plan_in_force_the_effects_are_gone(name: str, orientation: int) -> None:
    sensor, effects = CASES[name]
    values = parameters(AHRS_ORIENTATION=orientation)
    truth, raw = affected(sensor, effects, values)
    before = ardupilot.calibration_in_force(values, sensor, 0).apply(raw)
    plan, left = vehicle_plan(report(*effects), flown(values))
    assert plan.blockers == ()
    assert left == ()
    after = ardupilot.calibration_in_force(values | {c.name: c.new for c in plan.changes}, sensor, 0).apply(raw)
    ratio = np.sum(after * truth) / np.sum(truth * truth) if sensor is Sensor.MAG else 1.0  # a field's length is free
    assert np.abs(before - truth).max() > 100.0 * np.abs(after - ratio * truth).max()
    np.testing.assert_allclose(after, ratio * truth, atol=2e-3 * np.abs(truth).max())
    assert ratio == pytest.approx(1.0, abs=0.05)


def test_the_file_is_that_of_a_job_and_names_what_no_calibration_takes_away() -> None:
    found = report(effect("accel_bias", bias=(0.3, 0, 0)), effect("accel_vibration", amplitude=(4, 4, 4)))
    made = exported(found, flown(parameters()), Target.VEHICLE, form=ParameterFormat.PARAM)
    values = read_parameters(made.text, ParameterFormat.PARAM)
    assert values["INS_ACCOFFS_X"] == pytest.approx(0.4)
    assert "# plan" in made.text
    assert [text.split(":")[0] for text in made.not_held] == ["accel_vibration of instance 1"]


def unlikely(id_: str, instances: tuple[int, ...] = (1,), **groups: object) -> EffectEstimate:
    found = effect(id_, instances, **groups)
    return dataclasses.replace(found, evidence=dataclasses.replace(found.evidence, probability=0.49))


def test_nothing_is_written_to_a_sensor_of_which_an_effect_is_doubtful() -> None:
    found = report(
        effect("accel_bias", bias=(0.3, 0, 0)), unlikely("accel_scale", scale=(0.1, 0, 0)), CASES["gyroscope"][1][0]
    )
    plan, left = vehicle_plan(found, flown(parameters()))
    names = {c.name for c in plan.changes}
    assert {"INS_GYROFFS_X", "INS_GYROFFS_Y", "INS_GYROFFS_Z"} <= names
    assert not [name for name in names if name.startswith("INS_ACC")]
    assert [text.split(":")[0] for text in left] == ["accel_scale of instance 1", "accel_bias of instance 1"]
    assert "probability of 0.49" in left[0]


def test_of_two_sensors_the_one_that_is_sure_is_written() -> None:
    one = parameters()
    two = {name.replace("INS_ACC", "INS_ACC2", 1): v for name, v in one.items() if name.startswith("INS_ACC")}
    found = report(effect("accel_bias", (1, 2), bias=(0.3, 0, 0)), unlikely("accel_scale", (2,), scale=(0.1, 0, 0)))
    plan, left = vehicle_plan(found, flown(one | two))
    names = {c.name for c in plan.changes}
    assert "INS_ACCOFFS_X" in names
    assert not [name for name in names if name.startswith("INS_ACC2")]
    assert "not of accel 2" in left[1]


def test_what_is_unknown_is_said_beside_a_plan() -> None:
    found = report(effect("accel_bias", bias=(0.3, 0, 0)))
    beside = Unknown(flag=True, share=0.3, shape="a line at 3 Hz on accel.z")
    plan, left = vehicle_plan(dataclasses.replace(found, unknown=beside), flown(parameters()))
    assert plan.changes
    assert left == ("something unknown, beside which all was estimated: a line at 3 Hz on accel.z",)


def test_of_what_is_less_likely_than_not_there_is_no_plan() -> None:
    with pytest.raises(FirmwareError, match=r"accel_bias of instance 1: it has a probability of 0\.49"):
        vehicle_plan(report(unlikely("accel_bias", bias=(0.3, 0, 0))), flown(parameters()))


def test_an_offset_without_an_error_of_its_own_is_not_written() -> None:
    bias = effect("accel_bias", bias=(0.3, 0, 0))
    loose = dataclasses.replace(bias.params[0], se=np.inf)
    with pytest.raises(FirmwareError, match=r"bias\.x has no finite error"):
        vehicle_plan(report(dataclasses.replace(bias, params=(loose, *bias.params[1:]))), flown(parameters()))


def test_a_vehicle_that_nobody_knows_gets_nothing() -> None:
    with pytest.raises(FirmwareError, match="parameters"):
        vehicle_plan(report(effect("accel_bias", bias=(1, 0, 0))), Recording(()))
    with pytest.raises(FirmwareError, match="no effect of the report is a calibration"):
        vehicle_plan(report(effect("accel_delay", delay_s=0.01)), flown(parameters()))


@pytest.mark.parametrize(("low", "high"), [(-10.0, 60.0), (18.0, 22.0), (35.0, 80.0)])
@pytest.mark.parametrize("drifts", [False, True])
def test_a_curve_in_force_keeps_the_temperatures_that_it_was_measured_in(low: float, high: float, drifts: bool) -> None:
    """The range of the flight, 20 to 30 degC, is that of what the flight shows; the curve in force has its own."""
    found = [effect("gyro_temp_linear", per_degc=(1e-4, 0.0, 0.0), t_ref=25.0)] if drifts else []
    found.append(effect("gyro_bias", bias=(0.01, 0.0, 0.0)))
    before = ThermalPolynomial(25.0, low, high, np.array([[2e-4], [0.0], [1e-4]]))
    force = TriadModel([0.1, 0.2, 0.3], np.eye(3), before)
    model = corrected_model(force, np.eye(3), found, (Sensor.GYRO, 1), 25.0, (20.0, 30.0))
    assert model.polynomial is not None
    assert (model.polynomial.t_min, model.polynomial.t_max) == (low, high)
    np.testing.assert_allclose(model.polynomial.coefficients[:, 0], [2e-4 + 1e-4 * drifts, 0.0, 1e-4], atol=1e-12)
    assert model.polynomial.t_ref == 25.0
    np.testing.assert_allclose(model.offset, [0.11, 0.2, 0.3])
    plain = corrected_model(TriadModel(), np.eye(3), found, (Sensor.GYRO, 1), 25.0, (20.0, 30.0))
    assert (plain.polynomial is not None) == drifts
    if plain.polynomial is not None:
        assert (plain.polynomial.t_min, plain.polynomial.t_max) == (20.0, 30.0)


@pytest.mark.parametrize("number", [0, 2, 14])
def test_a_drift_is_found_along_the_body_and_taken_away_along_the_sensor(number: int) -> None:
    mounting = rotation_matrix("ardupilot", number)
    found = [
        effect("gyro_temp_linear", per_degc=(1e-4, 2e-4, 0.0), t_ref=25.0),
        effect("gyro_bias", bias=(0.01, 0.0, 0.02)),
    ]
    model = corrected_model(TriadModel(matrix=mounting), mounting, found, (Sensor.GYRO, 1), 25.0, (20.0, 30.0))
    assert model.polynomial is not None
    np.testing.assert_allclose(model.polynomial.coefficients[:, 0], mounting.T @ [1e-4, 2e-4, 0.0], atol=1e-12)
    np.testing.assert_allclose(model.offset, mounting.T @ [0.01, 0.0, 0.02], atol=1e-12)


def test_drifts_are_stated_where_the_one_in_force_is() -> None:
    found = [effect("gyro_temp_linear", per_degc=(1e-4, 0.0, 0.0), t_ref=28.0)]
    curve = ThermalPolynomial(35.0, 0.0, 60.0, np.zeros((3, 1)))
    assert _reference(found, TriadModel(polynomial=curve)) == 35.0
    assert _reference(found, TriadModel()) == 28.0
    assert _reference([effect("gyro_bias", bias=(0.01, 0.0, 0.0))], TriadModel()) == REFERENCE_TEMPERATURE
