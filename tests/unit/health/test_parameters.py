"""What parameters say of a calibration: never made, or of a compass that is not used."""

from __future__ import annotations

import pytest

from mavcal.calib.health.channels import in_use, never_calibrated
from mavcal.calib.recording import Identity, ParameterTimeline, Recording, Sensor


def vehicle(parameters, autopilot="ardupilot"):
    return Recording((), identity=Identity(autopilot), parameters=ParameterTimeline.constant(parameters))


def px4_rows(kind, offset=0.0, scale=1.0):
    return {
        f"CAL_{kind}0_ID": 77,
        f"CAL_{kind}0_PRIO": 50,
        **{f"CAL_{kind}0_{a}OFF": offset for a in "XYZ"},
        **{f"CAL_{kind}0_{a}SCALE": scale for a in "XYZ"},
    }


NEUTRAL = {
    Sensor.ACCEL: {f"INS_ACCOFFS_{a}": 0.0 for a in "XYZ"} | {f"INS_ACCSCAL_{a}": 1.0 for a in "XYZ"},
    Sensor.GYRO: {f"INS_GYROFFS_{a}": 0.0 for a in "XYZ"},
    Sensor.MAG: {f"COMPASS_OFS_{a}": 0.0 for a in "XYZ"} | {f"COMPASS_DIA_{a}": 1.0 for a in "XYZ"},
}


@pytest.mark.parametrize("sensor", NEUTRAL)
def test_offsets_of_zero_and_scales_of_one_are_no_calibration(sensor):
    neutral = NEUTRAL[sensor]
    assert never_calibrated(vehicle(neutral), sensor, 0)
    for name, value in neutral.items():
        assert not never_calibrated(vehicle({**neutral, name: value + 0.001}), sensor, 0), name


def test_scales_of_zero_are_those_of_a_compass_that_was_never_calibrated():
    zeros = NEUTRAL[Sensor.MAG] | {f"COMPASS_DIA_{a}": 0.0 for a in "XYZ"}
    assert never_calibrated(vehicle(zeros), Sensor.MAG, 0)


def test_parameters_that_the_log_does_not_have_say_nothing():
    assert not never_calibrated(vehicle({}), Sensor.ACCEL, 0)
    partly = {name: value for name, value in NEUTRAL[Sensor.ACCEL].items() if not name.endswith("OFFS_Y")}
    assert not never_calibrated(vehicle(partly), Sensor.ACCEL, 0)
    offsets = {name: value for name, value in NEUTRAL[Sensor.ACCEL].items() if "OFFS" in name}
    assert never_calibrated(vehicle(offsets), Sensor.ACCEL, 0)


def test_a_unit_beyond_the_rows_of_the_autopilot_was_not_left_uncalibrated():
    assert not never_calibrated(vehicle(NEUTRAL[Sensor.ACCEL]), Sensor.ACCEL, 5)
    assert not never_calibrated(vehicle(NEUTRAL[Sensor.MAG]), Sensor.MAG, 3)
    assert not never_calibrated(vehicle(px4_rows("ACC"), "px4"), Sensor.ACCEL, 4)


def test_each_unit_is_judged_by_its_own_row():
    second = {f"INS_ACC2OFFS_{a}": 0.3 for a in "XYZ"}
    both = vehicle(NEUTRAL[Sensor.ACCEL] | second)
    assert never_calibrated(both, Sensor.ACCEL, 0)
    assert not never_calibrated(both, Sensor.ACCEL, 1)


@pytest.mark.parametrize(("sensor", "kind"), [(Sensor.ACCEL, "ACC"), (Sensor.GYRO, "GYRO"), (Sensor.MAG, "MAG")])
def test_rows_of_px4_are_read_by_their_own_names(sensor, kind):
    assert never_calibrated(vehicle(px4_rows(kind), "px4"), sensor, 0)
    assert not never_calibrated(vehicle(px4_rows(kind, offset=0.02), "px4"), sensor, 0)
    assert not never_calibrated(vehicle(px4_rows(kind), "ardupilot"), sensor, 0)


@pytest.mark.parametrize(
    ("parameters", "instance", "used"),
    [
        ({}, 0, True),
        ({"COMPASS_USE": 0}, 0, False),
        ({"COMPASS_USE": 0}, 1, True),
        ({"COMPASS_USE2": 0}, 1, False),
        ({"COMPASS_USE3": 0}, 2, False),
        ({"COMPASS_USE": 1, "COMPASS_ENABLE": 0}, 0, False),
        ({"MAG_ENABLE": 0}, 0, False),
        ({"MAG_ENABLE": 0, "COMPASS_ENABLE": 1}, 0, True),
        ({"COMPASS_USE": 0}, 3, True),
    ],
)
def test_a_compass_is_used_unless_its_own_switch_or_that_of_all_is_off(parameters, instance, used):
    assert in_use(vehicle(parameters), Sensor.MAG, instance) is used


def test_the_switch_of_a_compass_is_not_that_of_an_accelerometer():
    assert in_use(vehicle({"COMPASS_USE": 0, "COMPASS_ENABLE": 0}), Sensor.ACCEL, 0)
