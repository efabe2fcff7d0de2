"""Age, ids, changed parameters and temperature beside the verified calibrations."""

from __future__ import annotations

import dataclasses

import pytest

from mavcal.calib.firmware.plan import Value
from mavcal.calib.preflight import history
from mavcal.calib.preflight.check import Snapshot, Verdict
from mavcal.calib.recording import Sensor
from tests.unit.preflight.vehicle import DAY_S, NOW, healthy

ARDUPILOT, PX4 = 2, 3


def snapshot(seed: int = ARDUPILOT, **parameters: Value) -> Snapshot:
    vehicle = healthy(seed, redundant=True)
    vehicle.parameters.update(parameters)
    return vehicle.snapshot()


def with_level(seed: int, name: str, now: float) -> Snapshot:
    """Healthy, but for a level that was verified as 0.01 and is `now`."""
    found = snapshot(seed)
    verified = dataclasses.replace(found.history[-1], parameters={**found.history[-1].parameters, name: 0.01})
    return dataclasses.replace(found, history=(verified,), parameters={**found.parameters, name: now})


def test_without_a_verified_calibration_nothing_is_known() -> None:
    bare = dataclasses.replace(snapshot(), history=())
    for check in (history.calibration_age(bare), history.sensor_check(bare), history.parameters_changed(bare)):
        assert check.verdict == Verdict.UNKNOWN
        assert "No verified calibration" in check.reason


def test_age_alone_is_a_warning() -> None:
    found = snapshot()
    old = dataclasses.replace(found.history[0], at=NOW - 400 * DAY_S)
    check = history.calibration_age(dataclasses.replace(found, history=(old,)))
    assert (check.verdict, check.value) == (Verdict.WARN, pytest.approx(400.0))


def test_the_newest_calibration_of_a_sensor_counts() -> None:
    found = snapshot()
    old = dataclasses.replace(found.history[0], at=NOW - 400 * DAY_S, device_ids={"accel0": 5})
    newer = dataclasses.replace(found, history=(old, *found.history))
    assert history.calibration_age(newer).verdict == Verdict.PASS
    assert history.sensor_check(newer).verdict == Verdict.PASS


def test_a_changed_parameter_is_named_with_both_values() -> None:
    found = snapshot(INS_ACCOFFS_X=0.5)
    changed = history.changes(found)
    assert [(c.name, c.sensor, c.now) for c in changed] == [("INS_ACCOFFS_X", Sensor.ACCEL, 0.5)]
    check = history.parameters_changed(found)
    assert check.verdict == Verdict.FAIL
    assert "INS_ACCOFFS_X" in check.reason
    assert "-> 0.5" in check.evidence[0]


@pytest.mark.parametrize(("seed", "name"), [(ARDUPILOT, "AHRS_TRIM_X"), (PX4, "SENS_BOARD_Y_OFF")])
def test_a_level_that_was_saved_in_the_field_is_a_warning(seed: int, name: str) -> None:
    found = with_level(seed, name, 0.02)
    check = history.parameters_changed(found)
    assert (check.verdict, check.value) == (Verdict.WARN, 1.0)
    assert name in check.reason
    assert "level" in check.remedy
    assert history.changes(found)[0].sensor is None  # no sensor is the worse for it


@pytest.mark.parametrize(("seed", "name"), [(ARDUPILOT, "AHRS_TRIM_X"), (PX4, "SENS_BOARD_Y_OFF")])
def test_a_level_that_was_reset_or_changed_with_others_fails(seed: int, name: str) -> None:
    assert history.parameters_changed(with_level(seed, name, 0.0)).verdict == Verdict.FAIL
    other = "INS_ACCOFFS_X" if seed == ARDUPILOT else "CAL_ACC0_XOFF"
    found = with_level(seed, name, 0.02)
    both = dataclasses.replace(found, parameters={**found.parameters, other: 0.5})
    check = history.parameters_changed(both)
    assert (check.verdict, check.value) == (Verdict.FAIL, 2.0)


def test_gyro_offsets_that_the_vehicle_rewrites_are_no_change() -> None:
    assert not history.changes(snapshot(INS_GYROFFS_X=0.3))
    assert history.changes(snapshot(INS_GYROFFS_X=0.3, INS_GYR_CAL=0))


def test_an_id_that_was_reset_is_a_changed_parameter_and_one_of_another_part_a_new_sensor() -> None:
    reset = snapshot(PX4, CAL_ACC0_ID=0, CAL_ACC1_ID=0, CAL_ACC2_ID=0)
    assert history.sensor_check(reset).verdict == Verdict.PASS
    assert {c.name for c in history.changes(reset)} >= {"CAL_ACC0_ID", "CAL_ACC1_ID"}
    other = snapshot(PX4, CAL_ACC0_ID=4711)
    check = history.sensor_check(other)
    assert check.verdict == Verdict.FAIL
    assert "4711" in check.reason
    assert not [c for c in history.changes(other) if c.sensor == Sensor.ACCEL]


def test_an_equal_board_is_known_by_the_unique_id() -> None:
    found = snapshot()
    other = dataclasses.replace(found, identity=dataclasses.replace(found.identity, uid="other"))
    check = history.sensor_check(other)
    assert check.verdict == Verdict.FAIL
    assert "other" in check.reason


@pytest.mark.parametrize(
    ("name", "sensor"),
    [
        ("INS_ACCOFFS_X", Sensor.ACCEL),
        ("INS_ACC2SCAL_Y", Sensor.ACCEL),
        ("INS4_ACCOFFS_Z", Sensor.ACCEL),
        ("INS_TCAL1_ACC1_X", Sensor.ACCEL),
        ("INS_GYR2OFFS_X", Sensor.GYRO),
        ("COMPASS_OFS2_X", Sensor.MAG),
        ("CAL_MAG0_XOFF", Sensor.MAG),
        ("TC_G0_X1_0", Sensor.GYRO),
        ("AHRS_ORIENTATION", None),
    ],
)
def test_whose_parameter_it_is(name: str, sensor: Sensor | None) -> None:
    assert history.sensor_of(name) == sensor


def test_a_calibration_at_one_temperature_covers_a_span_around_it() -> None:
    vehicle = healthy(ARDUPILOT, redundant=True)
    for number in (1, 2, 3):
        vehicle.parameters[f"INS_TCAL{number}_ENABLE"] = 0
        vehicle.parameters[f"INS_ACC{number}_CALTEMP"] = 20.0
    vehicle.temperatures = [45.0] * vehicle.imus
    check = history.temperature(vehicle.snapshot())
    assert check.verdict == Verdict.FAIL
    assert check.value == pytest.approx(25.0, abs=0.2)


def test_an_unknown_calibration_temperature_is_that_of_the_verified_job() -> None:
    vehicle = healthy(ARDUPILOT, redundant=True)
    for number in (1, 2, 3):
        vehicle.parameters[f"INS_TCAL{number}_ENABLE"] = 0
        vehicle.parameters[f"INS_ACC{number}_CALTEMP"] = -300.0
    found = vehicle.snapshot()
    assert history.temperature(found).verdict == Verdict.PASS
    without = dataclasses.replace(found.history[0], temperatures={})
    check = history.temperature(dataclasses.replace(found, history=(without,)))
    assert check.verdict == Verdict.UNKNOWN
