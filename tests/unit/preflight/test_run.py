"""A preflight of simulated vehicles: a healthy one passes, and a fault is found by its own check alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.firmware.plan import Value
from mavcal.calib.preflight.check import CheckId, OwnView, Verdict
from mavcal.calib.preflight.run import looked_up, preflight
from mavcal.calib.recording import Sensor
from tests.unit.preflight.faults import FAULTS, Fault, report_of
from tests.unit.preflight.vehicle import about, healthy

SEEDS = range(1, 9)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_healthy_vehicle_passes(seed: int) -> None:
    report = report_of(None, seed)
    assert report.verdict == Verdict.PASS, report.summary
    assert [check.id for check in report.checks] == list(CheckId)


@pytest.mark.sampled
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
@pytest.mark.parametrize("seed", SEEDS)
def test_a_fault_fails_the_right_check_alone(fault: Fault, seed: int) -> None:
    report = report_of(fault, seed)
    failed = [check.id for check in report.checks if check.verdict == Verdict.FAIL]
    assert len(failed) == 1
    assert failed[0] in fault.right
    assert report.verdict == Verdict.FAIL


@pytest.mark.parametrize(("seed", "name"), [(1, "CAL_ACC0_XOFF"), (2, "INS_ACCOFFS_X")])
def test_an_attitude_that_a_changed_offset_has_bent_is_left_to_that_change(seed: int, name: str) -> None:
    vehicle = healthy(seed, redundant=True)
    vehicle.parameters[name] = float(vehicle.verified.parameters[name]) + 1.0
    vehicle.tilt_error = 0.05
    report = preflight(vehicle.snapshot())
    assert [check.id for check in report.checks if check.verdict == Verdict.FAIL] == [CheckId.PARAMETERS_CHANGED]
    assert "follows from parameters_changed" in report.check(CheckId.ATTITUDE).reason


def test_every_value_has_its_uncertainty() -> None:
    for check in report_of(None, 1).checks:
        assert (check.value is None) == (check.sd is None), check.id


def test_a_moved_vehicle_is_not_judged() -> None:
    snapshot = healthy(3, redundant=True).snapshot()
    sway = [
        dataclasses.replace(c, values=c.values + 0.05 * np.sin(2.0 * c.t)[:, None]) if c.sensor == Sensor.GYRO else c
        for c in snapshot.recording.channels
    ]
    report = preflight(dataclasses.replace(snapshot, recording=snapshot.recording.with_channels(sway)))
    for of in (CheckId.GYRO_REST, CheckId.GYRO_NOISE, CheckId.ACCEL_FORCE, CheckId.COMPASS_DIRECTION):
        assert report.check(of).verdict == Verdict.UNKNOWN
        assert "moved" in report.check(of).reason


def test_one_sick_gyroscope_is_no_movement() -> None:
    snapshot = healthy(3, redundant=True).snapshot()
    sick = [
        dataclasses.replace(c, values=c.values + np.where(c.t < 3.0, 0.05, -0.05)[:, None])
        if c.sensor == Sensor.GYRO and c.instance == 0
        else c
        for c in snapshot.recording.channels
    ]
    report = preflight(dataclasses.replace(snapshot, recording=snapshot.recording.with_channels(sick)))
    assert report.check(CheckId.GYRO_NOISE).verdict == Verdict.FAIL


def test_without_a_position_the_field_is_not_compared() -> None:
    snapshot = healthy(2, redundant=True).snapshot()
    rest = [c for c in snapshot.recording.channels if c.sensor != Sensor.POSITION]
    report = preflight(dataclasses.replace(snapshot, recording=snapshot.recording.with_channels(rest)))
    assert report.check(CheckId.COMPASS_FIELD).verdict == Verdict.UNKNOWN
    assert report.check(CheckId.COMPASS_DIRECTION).verdict == Verdict.PASS  # the compasses agree


def test_a_running_calibration_explains_what_the_sensors_read() -> None:
    vehicle = healthy(5, redundant=True)
    vehicle.accel_errors[0] = np.array([0.0, 0.0, 0.5])
    view = OwnView(present=True, ready=True, calibrating=True)
    report = preflight(dataclasses.replace(vehicle.snapshot(), view=view))
    assert report.check(CheckId.ONBOARD_CALIBRATION).verdict == Verdict.FAIL
    assert report.check(CheckId.ACCEL_FORCE).verdict == Verdict.UNKNOWN


def test_the_same_heading_error_of_all_compasses_shows_with_a_known_heading() -> None:
    vehicle = healthy(4, redundant=True)
    turn = about(vehicle.body_from_ned @ np.array([0.0, 0.0, 1.0]), np.radians(30.0))
    vehicle.mag_turns = [turn @ own for own in vehicle.mag_turns]
    snapshot = vehicle.snapshot()
    rest = [c for c in snapshot.recording.channels if c.sensor != Sensor.ATTITUDE]
    snapshot = dataclasses.replace(snapshot, recording=snapshot.recording.with_channels(rest))
    nose = vehicle.body_from_ned.T @ np.array([1.0, 0.0, 0.0])
    heading = float(np.degrees(np.arctan2(nose[1], nose[0]))) % 360.0
    assert preflight(snapshot).check(CheckId.COMPASS_DIRECTION).verdict == Verdict.PASS
    known = preflight(dataclasses.replace(snapshot, heading=heading)).check(CheckId.COMPASS_DIRECTION)
    assert known.verdict == Verdict.FAIL
    assert known.value == pytest.approx(30.0, abs=4.0)


def test_a_sensor_that_is_not_there_is_unknown() -> None:
    snapshot = healthy(4).snapshot()
    rest = [c for c in snapshot.recording.channels if c.sensor != Sensor.MAG]
    report = preflight(dataclasses.replace(snapshot, recording=snapshot.recording.with_channels(rest)))
    assert report.check(CheckId.COMPASS_FIELD).verdict == Verdict.UNKNOWN
    assert report.check(CheckId.COMPASS_DIRECTION).verdict == Verdict.UNKNOWN


def test_a_sensor_that_was_calibrated_meanwhile_has_no_verdict() -> None:
    vehicle = healthy(3, redundant=True)
    vehicle.gyro_errors[0] = np.array([0.05, 0.0, 0.0])
    report = preflight(dataclasses.replace(vehicle.snapshot(), rewritten=("CAL_GYRO0_XOFF",)))
    check = report.check(CheckId.GYRO_REST)
    assert check.verdict == Verdict.UNKNOWN
    assert "CAL_GYRO0_XOFF" in check.reason
    assert report.check(CheckId.ACCEL_FORCE).verdict == Verdict.PASS


@pytest.mark.parametrize("seed", SEEDS)
def test_a_check_needs_no_parameter_that_is_not_read_from_a_vehicle(seed: int) -> None:
    snapshot = dataclasses.replace(healthy(seed, redundant=True).snapshot(), history=())
    autopilot, every = snapshot.identity.autopilot or "", snapshot.parameters
    read: dict[str, Value] = {}
    asked: set[str] = set()
    while missing := looked_up(autopilot, read, ()) - asked:
        asked |= missing
        read |= {name: every[name] for name in missing if name in every}
    assert preflight(dataclasses.replace(snapshot, parameters=read)) == preflight(snapshot)
