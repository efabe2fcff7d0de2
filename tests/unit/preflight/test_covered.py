"""Which temperatures a calibration covers, who calibrates gyroscopes, and how a change is told."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.preflight import history
from mavcal.calib.preflight.check import Verdict
from mavcal.calib.preflight.history import Changed, Covered, calibrates_gyros, corrected_by, covered_by
from mavcal.calib.recording import Channel, Sensor, Stage
from tests.unit.preflight.vehicle import DAY_S, NOW, healthy

ARDUPILOT, PX4 = 2, 3
IN_FORCE = "the temperature calibration in force"


def curve(low: float = 0.0, high: float = 60.0, enabled: int = 1) -> dict[str, float | int]:
    return {"INS_TCAL1_ENABLE": enabled, "INS_TCAL1_TMIN": low, "INS_TCAL1_TMAX": high}


def px4_curve(low: float = 0.0, high: float = 60.0, enabled: int = 1) -> dict[str, float | int]:
    ids = {"CAL_ACC0_ID": 77, "TC_A0_ID": 77}
    return {**ids, "TC_A_ENABLE": enabled, "TC_A0_TMIN": low, "TC_A0_TMAX": high}


@pytest.mark.parametrize(
    ("parameters", "found"),
    [
        (curve(-10.0, 50.0), Covered(-10.0, 50.0, IN_FORCE)),
        (curve(enabled=0), None),
        (curve(enabled=2), None),
        (curve(50.0, 50.0), None),
        (curve(60.0, 0.0), None),
        ({"INS_TCAL1_ENABLE": 1, "INS_TCAL1_TMIN": 0.0}, None),
        ({}, None),
    ],
)
def test_a_curve_counts_where_it_is_enabled_and_has_a_range(parameters, found):
    assert corrected_by("ardupilot", parameters, Sensor.ACCEL, 0) == found
    assert corrected_by("ardupilot", parameters, Sensor.GYRO, 0) == found
    assert corrected_by("ardupilot", parameters, Sensor.ACCEL, 1) is None


def test_a_curve_of_px4_is_that_of_the_sensor_s_own_id():
    assert corrected_by("px4", px4_curve(5.0, 45.0), Sensor.ACCEL, 0) == Covered(5.0, 45.0, IN_FORCE)
    assert corrected_by("px4", px4_curve(enabled=0), Sensor.ACCEL, 0) is None
    every = {f"TC_A{k}_ID": 100 + k for k in range(4)}
    assert corrected_by("px4", {**px4_curve(), **every}, Sensor.ACCEL, 0) is None


@pytest.mark.parametrize(
    ("parameters", "measured", "low", "high"),
    [
        ({"INS_ACC1_CALTEMP": 30.0}, None, 10.0, 50.0),
        ({"INS_ACC1_CALTEMP": 30.0}, 0.0, 10.0, 50.0),
        ({"INS_ACC1_CALTEMP": -300.0}, 5.0, -15.0, 25.0),
        ({"INS_ACC1_CALTEMP": -70.0}, 5.0, -15.0, 25.0),
        ({"INS_ACC1_CALTEMP": -69.0}, 5.0, -89.0, -49.0),
        ({}, 5.0, -15.0, 25.0),
        ({**curve(), "INS_ACC1_CALTEMP": 30.0}, 5.0, 0.0, 60.0),
    ],
)
def test_the_vehicle_s_own_temperature_goes_before_that_of_the_job_and_a_curve_before_both(
    parameters, measured, low, high
):
    found = covered_by("ardupilot", parameters, Sensor.ACCEL, 0, measured)
    assert (found.low, found.high) == (low, high)


def test_how_it_is_known_is_said():
    said = covered_by("ardupilot", {"INS_ACC1_CALTEMP": 30.0}, Sensor.ACCEL, 0, None).how
    assert said == "the temperature of its calibration, 30 degC, give or take 20"
    job = covered_by("ardupilot", {}, Sensor.ACCEL, 0, 5.0).how
    assert job == "the temperature of the verified job, 5 degC, give or take 20"
    assert covered_by("ardupilot", {"INS_ACC1_CALTEMP": -300.0}, Sensor.ACCEL, 0, None) is None


def test_a_unit_that_the_autopilot_has_no_row_for_is_covered_by_its_job_alone():
    assert covered_by("ardupilot", curve(), Sensor.ACCEL, 9, None) is None
    assert covered_by("other", curve(), Sensor.ACCEL, 0, 20.0).low == 0.0


@pytest.mark.parametrize(
    ("autopilot", "parameters", "by_itself"),
    [
        ("ardupilot", {}, True),
        ("ardupilot", {"INS_GYR_CAL": 0}, False),
        ("ardupilot", {"INS_GYR_CAL": 1}, True),
        ("ardupilot", {"IMU_GYRO_CAL_EN": 0}, True),
        ("px4", {"IMU_GYRO_CAL_EN": 0}, False),
        ("px4", {}, True),
        ("other", {"INS_GYR_CAL": 0}, True),
    ],
)
def test_a_vehicle_calibrates_its_gyroscopes_unless_its_own_switch_is_off(autopilot, parameters, by_itself):
    assert calibrates_gyros(autopilot, parameters) is by_itself


def test_a_change_is_told_with_both_values_and_what_is_gone_as_not_there():
    changed = Changed("INS_ACCOFFS_X", Sensor.ACCEL, 0.25, 0.5).text
    assert all(token in changed for token in ("INS_ACCOFFS_X", "0.25 ->", "-> 0.5"))
    gone = Changed("CAL_ACC0_ID", Sensor.ACCEL, 4711, None).text
    assert all(token in gone for token in ("CAL_ACC0_ID", "4711 ->", "not there"))


@pytest.mark.parametrize(("shift", "changed"), [(0.0, False), (5e-8, False), (3e-6, True), (-3e-6, True)])
def test_a_parameter_is_as_verified_within_the_digits_of_a_float32(shift, changed):
    vehicle = healthy(ARDUPILOT, redundant=True)
    verified = float(vehicle.parameters["INS_ACCOFFS_X"])
    vehicle.parameters["INS_ACCOFFS_X"] = verified * (1.0 + shift)
    assert bool(history.changes(vehicle.snapshot())) == changed


def test_a_parameter_that_is_gone_is_a_change_only_where_all_were_read():
    vehicle = healthy(ARDUPILOT, redundant=True)
    del vehicle.parameters["INS_ACCOFFS_X"]
    snapshot = vehicle.snapshot()
    assert [c.now for c in history.changes(snapshot)] == [None]
    partly = dataclasses.replace(snapshot, complete=False)
    assert history.changes(partly) == ()
    check = history.parameters_changed(partly)
    assert check.verdict == Verdict.UNKNOWN
    assert check.remedy == "Check again on a faster link."


@pytest.mark.parametrize(("days", "verdict"), [(0.0, Verdict.PASS), (364.0, Verdict.PASS), (366.0, Verdict.WARN)])
def test_a_calibration_is_old_after_a_year(days, verdict):
    snapshot = healthy(ARDUPILOT, redundant=True).snapshot()
    entry = dataclasses.replace(snapshot.history[-1], at=NOW - days * DAY_S)
    check = history.calibration_age(dataclasses.replace(snapshot, history=(entry,)))
    assert (check.verdict, check.value) == (verdict, pytest.approx(days))


def test_a_calibration_from_the_future_is_no_day_old():
    snapshot = healthy(ARDUPILOT, redundant=True).snapshot()
    entry = dataclasses.replace(snapshot.history[-1], at=NOW + DAY_S)
    assert history.calibration_age(dataclasses.replace(snapshot, history=(entry,))).value == 0.0


def test_three_changes_are_listed_and_more_are_counted():
    vehicle = healthy(ARDUPILOT, redundant=True)
    for axis in "XYZ":
        vehicle.parameters[f"INS_ACCOFFS_{axis}"] = 0.5
    three = history.parameters_changed(vehicle.snapshot()).reason
    assert three.startswith("3 parameters are not as verified: ")
    assert "…" not in three
    vehicle.parameters["INS_ACC2OFFS_X"] = 0.5
    four = history.parameters_changed(vehicle.snapshot())
    assert four.reason.endswith(" ….")
    assert (four.value, sum("-> 0.5" in line for line in four.evidence)) == (4.0, 4)


@pytest.mark.parametrize(
    ("degrees", "verdict"),
    [(39.0, Verdict.PASS), (41.0, Verdict.WARN), (42.0, Verdict.FAIL), (1.0, Verdict.PASS), (-2.0, Verdict.FAIL)],
)
def test_a_temperature_at_the_edge_of_the_covered_ones_is_no_failure_yet(degrees, verdict):
    vehicle = healthy(ARDUPILOT, redundant=True)
    for number in (1, 2, 3):
        vehicle.parameters[f"INS_TCAL{number}_ENABLE"] = 0
        vehicle.parameters[f"INS_ACC{number}_CALTEMP"] = 20.0
    vehicle.temperatures = [degrees] * vehicle.imus
    assert history.temperature(vehicle.snapshot()).verdict == verdict


def test_a_unit_that_learns_its_temperature_calibration_is_no_pass():
    vehicle = healthy(ARDUPILOT, redundant=True)
    before = history.temperature(vehicle.snapshot())
    vehicle.parameters["INS_TCAL2_ENABLE"] = 2
    check = history.temperature(vehicle.snapshot())
    assert before.verdict == Verdict.PASS
    assert check.verdict == Verdict.WARN
    assert check.reason.startswith("INS_TCAL2_ENABLE is 2: inertial unit 2 learns its temperature calibration")


def test_without_a_thermometer_the_temperature_is_unknown():
    snapshot = healthy(ARDUPILOT).snapshot()
    bare = snapshot.recording.with_channels(c for c in snapshot.recording.channels if c.sensor != Sensor.TEMPERATURE)
    check = history.temperature(dataclasses.replace(snapshot, recording=bare))
    assert check.verdict == Verdict.UNKNOWN
    assert "No temperature" in check.reason


def test_the_median_of_the_thermometer_counts():
    snapshot = healthy(ARDUPILOT).snapshot()
    t = np.arange(5.0)
    warm = Channel(Sensor.TEMPERATURE, 0, t, np.array([30.0, 31.0, 32.0, 33.0, 500.0]), "degC", Stage.RAW, "IMU")
    others = (c for c in snapshot.recording.channels if c.sensor != Sensor.TEMPERATURE)
    made = dataclasses.replace(snapshot, recording=snapshot.recording.with_channels([*others, warm]))
    assert any("(32.0 degC)" in line for line in history.temperature(made).evidence)
