"""Installed sensors: announced by parameters, heard, and alive; a healthy sensor that stands still is not accused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.preflight.check import CheckId, Report, Verdict
from mavcal.calib.preflight.installed import announced
from mavcal.calib.preflight.liveness import census
from mavcal.calib.preflight.movement import movement
from mavcal.calib.preflight.run import preflight
from mavcal.calib.recording import Recording, Sensor
from tests.unit.preflight.faults import FAULTS, report_of, use_all
from tests.unit.preflight.vehicle import BenchVehicle, healthy

AP_BOTH = {"INS_ACC_ID": 1, "INS_ACC2_ID": 2, "INS_GYR_ID": 3, "INS_GYR2_ID": 4}
PX4_BOTH = {"CAL_ACC0_ID": 1, "CAL_ACC1_ID": 2, "CAL_GYRO0_ID": 3, "CAL_GYRO1_ID": 4}
RANKED = {"COMPASS_DEV_ID": 7, "COMPASS_DEV_ID2": 8, "COMPASS_PRIO1_ID": 8, "COMPASS_PRIO2_ID": 7}
A, G, M = Sensor.ACCEL, Sensor.GYRO, Sensor.MAG


@pytest.mark.parametrize(
    ("autopilot", "parameters", "expected"),
    [
        ("ardupilot", AP_BOTH, {(A, 0), (A, 1), (G, 0), (G, 1)}),
        ("ardupilot", AP_BOTH | {"INS_USE2": 0}, {(A, 0), (G, 0)}),
        ("ardupilot", {"COMPASS_DEV_ID": 7, "COMPASS_DEV_ID2": 8, "COMPASS_USE2": 0}, {(M, 0)}),
        # ranks tell what streams as what, and the switch counts by rank
        ("ardupilot", RANKED | {"COMPASS_USE": 0}, {(M, 1)}),
        ("ardupilot", {"COMPASS_DEV_ID": 7, "COMPASS_ENABLE": 0}, set()),
        ("ardupilot", {"INS4_ACC_ID": 9}, {(A, 3)}),
        ("px4", {"CAL_ACC0_ID": 1, "CAL_GYRO0_ID": 2, "CAL_MAG0_ID": 3}, {(A, 0), (G, 0), (M, 0)}),
        ("px4", {"CAL_MAG0_ID": 3, "CAL_MAG0_PRIO": 0, "CAL_MAG1_ID": 4, "CAL_MAG1_PRIO": 75}, {(M, 1)}),
        # a unit of which one half is switched off is not published at all, and the next one takes its number
        ("px4", PX4_BOTH | {"CAL_GYRO0_PRIO": 0}, {(A, 0), (G, 0)}),
        ("px4", {"CAL_MAG0_ID": 3, "SYS_HAS_MAG": 0}, set()),
        ("generic", {"CAL_MAG0_ID": 3}, set()),
    ],
)  # fmt: skip
def test_what_is_announced_and_used(
    autopilot: str, parameters: dict[str, int], expected: set[tuple[Sensor, int]]
) -> None:
    assert set(announced(autopilot, parameters)) == expected


def three(seed: int, **noises: float) -> BenchVehicle:
    """A vehicle with three of everything, all in use, of one noise each."""
    found = (healthy(other, redundant=True) for other in range(seed, seed + 400, 2))
    vehicle = next(v for v in found if v.imus == 3 and len(v.mag_errors) == 3)
    use_all(vehicle)
    for sensor in (A, G, M):
        vehicle.noises[sensor] = [noises.get(sensor.value, vehicle.noises[sensor][0])] * 3
    return vehicle


def dead(vehicle: BenchVehicle) -> tuple[Report, tuple[str, ...]]:
    report = preflight(vehicle.snapshot())
    return report, report.check(CheckId.SENSORS_HEARD).suspects


@pytest.mark.parametrize("first", [1, 2])
@pytest.mark.parametrize(("sensor", "how", "name"), [
    (M, "zero", "compass 3"), (M, "nan", "compass 3"), (A, "zero", "accelerometer 3"), (A, "nan", "accelerometer 3"),
    (G, "nan", "gyroscope 3"),
])  # fmt: skip
def test_a_sensor_that_reads_nothing_fails_by_name(first: int, sensor: Sensor, how: str, name: str) -> None:
    vehicle = three(first)
    vehicle.dead[sensor, 2] = how
    report, suspects = dead(vehicle)
    assert [c.id for c in report.checks if c.verdict == Verdict.FAIL] == [CheckId.SENSORS_HEARD], report.summary
    assert suspects == (name,)
    assert name.capitalize() in report.check(CheckId.SENSORS_HEARD).reason
    of = {M: CheckId.COMPASS_FIELD, A: CheckId.ACCEL_FORCE, G: CheckId.GYRO_REST}[sensor]
    assert "All" not in report.check(of).reason  # two of three
    assert report.check(of).verdict == Verdict.PASS


@pytest.mark.parametrize("first", [1, 2])
def test_healthy_sensors_that_stand_still_are_not_accused(first: int) -> None:
    """Far below a step of the stream every reading is the same, of every sensor."""
    vehicle = three(first, accel=1e-5, gyro=1e-6, mag=1e-4)
    report, suspects = dead(vehicle)
    assert suspects == ()
    check = report.check(CheckId.SENSORS_HEARD)
    assert check.verdict == Verdict.UNKNOWN  # a frozen compass reads the same
    assert "Not one step of change was seen in compass 1" in check.reason
    assert "Turn the vehicle" in check.remedy


@pytest.mark.parametrize("first", [1, 2])
def test_inertial_sensors_that_stand_still_pass_beside_living_compasses(first: int) -> None:
    check = dead(three(first, accel=1e-5, gyro=1e-6))[0].check(CheckId.SENSORS_HEARD)
    assert check.verdict == Verdict.PASS


@pytest.mark.parametrize("first", [1, 2])
def test_a_quiet_compass_beside_noisy_ones_is_not_accused(first: int) -> None:
    """An RM3100 averaged over 100 ms has .05 mG beside 1 mG of another part."""
    vehicle = three(first)
    vehicle.noises[M] = [0.1, 0.1, 0.002]
    assert dead(vehicle)[1] == ()


@pytest.mark.parametrize("first", [1, 2])
def test_a_gyroscope_without_noise_is_dead_where_the_stream_would_show_it(first: int) -> None:
    vehicle = three(first, gyro=5e-4)
    vehicle.dead[G, 0] = "frozen"
    _, suspects = dead(vehicle)
    assert suspects == (("gyroscope 1",) if first == 2 else ())  # ArduPilot streams the first one without rounding


@pytest.mark.parametrize("first", [1, 2])
def test_a_noisy_sibling_is_no_measure_for_a_quiet_sensor(first: int) -> None:
    vehicle = three(first, gyro=2e-5)
    vehicle.noises[G][2] = 0.05
    report, suspects = dead(vehicle)
    assert suspects == ()
    assert report.check(CheckId.GYRO_NOISE).suspects == ("gyroscope 3",)


def test_what_the_link_did_not_bring_is_no_sensors_fault() -> None:
    snapshot = three(2).snapshot()
    few = [c.take(np.arange(len(c)) < 16) for c in snapshot.recording.channels]
    thin = dataclasses.replace(
        snapshot,
        recording=snapshot.recording.with_channels(few),
        messages={0: 16, 1: 16, 2: 16},
    )
    report = preflight(thin)
    check = report.check(CheckId.SENSORS_HEARD)
    assert check.verdict == Verdict.UNKNOWN
    assert "says nothing of the sensors" in check.reason
    for of in (CheckId.COMPASS_FIELD, CheckId.COMPASS_DIRECTION, CheckId.GYRO_REST, CheckId.ACCEL_FORCE):
        assert report.check(of).verdict == Verdict.UNKNOWN
        assert "the link's fault" in report.check(of).reason
        assert "ompass" not in report.check(of).remedy


def test_a_stream_of_repeats_is_a_dead_sensor() -> None:
    """PX4 goes on sending the compass with the inertial unit's old time stamp: nothing of that unit is new."""
    vehicle = three(1)
    snapshot = vehicle.snapshot()
    still = [c.take(slice(0, 1)) if c.sensor in (A, G) and c.instance == 1 else c for c in snapshot.recording.channels]
    report = preflight(dataclasses.replace(snapshot, recording=snapshot.recording.with_channels(still)))
    assert report.check(CheckId.SENSORS_HEARD).suspects == ("accelerometer 2", "gyroscope 2")


def test_a_row_without_a_sensor_hides_no_compass_that_stands_still() -> None:
    """PX4 without noise: its first compass is dead, and its second one never was there."""
    vehicle = three(1)
    heard = (device for key, device in vehicle.verified.device_ids.items() if not key.endswith("2"))
    vehicle.verified = dataclasses.replace(vehicle.verified, heard=frozenset(heard))
    vehicle.parameters |= {f"CAL_{kind}2_PRIO": 50 for kind in ("ACC", "GYRO", "MAG")}
    vehicle.lost = frozenset({2})
    snapshot = vehicle.snapshot()
    still = [
        dataclasses.replace(c, values=np.broadcast_to(c.values[:1], c.values.shape).copy()) if c.sensor == M else c
        for c in snapshot.recording.channels
    ]
    report = preflight(dataclasses.replace(snapshot, recording=snapshot.recording.with_channels(still)))
    check = report.check(CheckId.SENSORS_HEARD)
    assert check.verdict == Verdict.WARN
    assert "Not one step of change was seen in compass 1, compass 2" in check.reason


def test_a_compass_whose_correction_was_not_read_is_not_dead() -> None:
    snapshot = three(1).snapshot()
    rest = [c for c in snapshot.recording.channels if c.sensor != M]
    unread = dataclasses.replace(
        snapshot,
        recording=snapshot.recording.with_channels(rest),
        uncorrected=frozenset({(M, 0), (M, 1), (M, 2)}),
        complete=False,
    )
    assert preflight(unread).check(CheckId.SENSORS_HEARD).verdict == Verdict.UNKNOWN


@pytest.mark.parametrize(
    ("known", "priority", "verdict"),
    [(True, 50, Verdict.FAIL), (True, -1, Verdict.FAIL), (False, 50, Verdict.WARN), (False, -1, Verdict.PASS)],
)
def test_a_row_of_px4_whose_sensor_never_sends(known: bool, priority: int, verdict: Verdict) -> None:
    """PX4 keeps the rows of sensors that are gone, and its simulator comes with rows for sensors that it has not.

    A verified calibration of the others had these rows too, which makes no dead sensor of them.
    """
    vehicle = three(1)
    if not known:
        heard = (device for key, device in vehicle.verified.device_ids.items() if not key.endswith("2"))
        vehicle.verified = dataclasses.replace(vehicle.verified, heard=frozenset(heard))
    vehicle.parameters |= {f"CAL_{kind}2_PRIO": priority for kind in ("ACC", "GYRO", "MAG")}
    vehicle.lost = frozenset({2})
    report, suspects = dead(vehicle)
    check = report.check(CheckId.SENSORS_HEARD)
    assert check.verdict == verdict, check.reason
    assert ("compass 3" in suspects) == (verdict != Verdict.PASS)


def test_one_that_is_not_used_may_be_dead() -> None:
    vehicle = three(2)
    vehicle.parameters["COMPASS_USE3"] = 0
    vehicle.dead[M, 2] = "zero"
    report, suspects = dead(vehicle)
    assert (suspects, report.check(CheckId.SENSORS_HEARD).verdict) == ((), Verdict.PASS)


def test_a_bias_of_one_gyroscope_is_no_turn_that_the_others_missed() -> None:
    vehicle = three(2, gyro=2e-5)
    vehicle.gyro_errors[1] = np.array([0.0, 0.0, 0.3])
    snapshot = vehicle.snapshot()
    found = census(snapshot, announced("ardupilot", vehicle.parameters), movement(snapshot.recording))
    assert not found.dead


def test_the_vehicle_that_turned_is_not_judged_at_rest() -> None:
    fault = next(f for f in FAULTS if f.name == "frozen-gyro")
    report = report_of(fault, 2)
    assert report.check(CheckId.GYRO_REST).verdict == Verdict.UNKNOWN
    assert "was moved" in report.check(CheckId.GYRO_REST).reason


def test_px4_that_estimates_nothing_tells_that_a_sensor_stands_still() -> None:
    """It drops a sensor after 100 equal readings, and sends no attitude without one."""
    vehicle = three(1, gyro=1e-6)
    assert vehicle.autopilot == "px4"
    whole = vehicle.snapshot()
    others = [c for c in whole.recording.channels if c.sensor != Sensor.ATTITUDE]
    silent = dataclasses.replace(whole, recording=Recording(tuple(others)))
    assert not preflight(whole).check(CheckId.SENSORS_HEARD).suspects
    assert "gyroscope 1" in preflight(silent).check(CheckId.SENSORS_HEARD).suspects
