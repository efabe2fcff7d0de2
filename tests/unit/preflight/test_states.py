"""The tiles: what was calibrated, how good it is, and what it needs."""

from __future__ import annotations

import dataclasses

from mavcal.calib.firmware.plan import LeftOut
from mavcal.calib.fit import FitResult
from mavcal.calib.preflight.check import Snapshot, Verdict
from mavcal.calib.preflight.states import FinishedCalibration, SensorState, sensor_states, summary
from mavcal.calib.recording import Sensor
from tests.unit.firmware.conftest import make_fit  # noqa: F401 - a fixture
from tests.unit.preflight.vehicle import DAY_S, NOW, healthy


def snapshot(**parameters: float) -> Snapshot:
    vehicle = healthy(2, redundant=True)
    vehicle.parameters.update(parameters)
    return vehicle.snapshot()


def finished(fit: FitResult, kind: str, days: float) -> FinishedCalibration:
    return FinishedCalibration(kind, "job", NOW - days * DAY_S, (fit,))


def by_kind(states: tuple[SensorState, ...]) -> dict[str, SensorState]:
    return {state.kind: state for state in states}


def test_what_was_never_calibrated_here_says_so_and_what_to_begin_with():
    states = sensor_states([], snapshot())
    assert [state.kind for state in states] == ["gyro", "accel", "mag", "thermal"]
    assert all(state.verdict == Verdict.UNKNOWN and state.advice for state in states)
    assert summary(states)[1].startswith("Nothing was calibrated here yet")


def test_a_good_one_says_when_at_what_temperature_and_how_good(make_fit):  # noqa: F811
    fit = make_fit(Sensor.GYRO, 0, offset=[0.01] * 3)
    gyro = by_kind(sensor_states([finished(fit, "gyro", 3.0)], snapshot()))["gyro"]
    assert gyro.verdict == Verdict.PASS
    assert gyro.text == "Calibrated 3 days ago at 32 °C. Offset known to 0.057 deg/s."
    assert gyro.advice == ""


def test_the_newest_counts_and_an_old_one_warns(make_fit):  # noqa: F811
    fit = make_fit(Sensor.ACCEL, 0, offset=[0.1] * 3)
    old, new = finished(fit, "accel-six-face", 500.0), finished(fit, "accel", 1.0)
    assert by_kind(sensor_states([old], snapshot()))["accel"].label == "old"
    assert by_kind(sensor_states([old, new], snapshot()))["accel"].verdict == Verdict.PASS


def test_parameters_that_were_changed_since_then_come_first(make_fit):  # noqa: F811
    fit = make_fit(Sensor.ACCEL, 0, offset=[0.1] * 3)
    states = sensor_states([finished(fit, "accel", 1.0)], snapshot(INS_ACCOFFS_X=0.5))
    accel = by_kind(states)["accel"]
    assert (accel.verdict, accel.label) == (Verdict.FAIL, "changed")
    assert "INS_ACCOFFS_X" in accel.advice
    assert summary(states) == (Verdict.FAIL, f"Needs now: accelerometer. {accel.advice}")


def test_another_sensor_is_named(make_fit):  # noqa: F811
    found = snapshot()
    was = dataclasses.replace(found.history[0], device_ids={"mag0": 5})
    fit = make_fit(Sensor.MAG, 0, quality={"heading_sd_deg": 0.21})
    states = sensor_states([finished(fit, "mag", 1.0)], dataclasses.replace(found, history=(was,)))
    assert by_kind(states)["mag"].label == "other sensor"


def test_a_temperature_far_from_that_of_the_calibration_warns(make_fit):  # noqa: F811
    fit = make_fit(Sensor.ACCEL, 0, offset=[0.1] * 3, temperature=-20.0)
    accel = by_kind(sensor_states([finished(fit, "accel", 1.0)], snapshot()))["accel"]
    assert (accel.verdict, accel.label) == (Verdict.WARN, "other temperature")


def test_one_that_turns_serves_both_sensors(make_fit):  # noqa: F811
    fits = (make_fit(Sensor.ACCEL, 0, offset=[0.1] * 3), make_fit(Sensor.GYRO, 0, offset=[0.1] * 3))
    both = FinishedCalibration("imu-multi", "job", NOW - 60.0, fits)
    states = by_kind(sensor_states([both], snapshot()))
    assert states["accel"].at == states["gyro"].at == both.at
    assert states["mag"].at is None


def test_a_sensor_that_fell_out_makes_its_tile_red_whatever_the_job_was(make_fit):  # noqa: F811
    dead = (LeftOut(Sensor.GYRO, 0, "it is frozen: it repeats one value"),)
    fit = make_fit(Sensor.GYRO, 1, offset=[0.01] * 3)
    part = dataclasses.replace(finished(fit, "gyro", 3.0), left_out=dead, dead=dead)
    gyro = by_kind(sensor_states([part], snapshot()))["gyro"]
    assert (gyro.verdict, gyro.label) == (Verdict.FAIL, "left out")
    assert gyro.text == "Gyro 1 was left out: it is frozen: it repeats one value."
    whole = finished(fit, "gyro", 2.0)
    assert by_kind(sensor_states([part, whole], snapshot()))["gyro"].verdict == Verdict.PASS, "it was mended"
    accel = finished(make_fit(Sensor.ACCEL, 0, offset=[0.1] * 3), "accel", 1.0)
    later = dataclasses.replace(accel, dead=dead)
    states = by_kind(sensor_states([part, whole, later], snapshot()))
    assert (states["gyro"].verdict, states["accel"].verdict) == (Verdict.FAIL, Verdict.PASS)


def test_a_sensor_that_was_measured_and_not_written_warns(make_fit):  # noqa: F811
    out = (LeftOut(Sensor.GYRO, 1, "it has no row"),)
    part = dataclasses.replace(finished(make_fit(Sensor.GYRO, 0, offset=[0.01] * 3), "gyro", 3.0), left_out=out)
    gyro = by_kind(sensor_states([part], snapshot()))["gyro"]
    assert gyro.verdict == Verdict.WARN
    assert "Gyro 2" in gyro.advice
    assert out[0].reason in gyro.advice
