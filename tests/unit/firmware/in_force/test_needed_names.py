"""Names that a job asks for, counted to the last."""

from __future__ import annotations

import pytest

from mavcal.calib.firmware.in_force.fingerprint import SETTINGS
from mavcal.calib.firmware.in_force.needed import needed
from mavcal.calib.recording import Sensor

PX4_SETTINGS = {name for name in SETTINGS if name.startswith(("SENS_", "IMU_"))}
ARDUPILOT_ALWAYS = set(SETTINGS) - PX4_SETTINGS | {"AHRS_ORIENTATION"}
PX4_ALWAYS = PX4_SETTINGS | {"SENS_BOARD_ROT"} | {f"SENS_BOARD_{a}_OFF" for a in "XYZ"}


def asked(autopilot, sensor, known=None, *, drift=False):
    always = PX4_ALWAYS if autopilot == "px4" else ARDUPILOT_ALWAYS
    found = needed(autopilot, [sensor], known or {}, drift=drift)
    assert always <= found
    return set(found - always)


def imu(stem, use, caltemp, enable):
    return {f"{stem}_ID", use, f"{caltemp}_CALTEMP", enable} | {f"{stem}OFFS_{a}" for a in "XYZ"}


FIRST = imu("INS_GYR", "INS_USE", "INS_GYR1", "INS_TCAL1_ENABLE")
SECOND = imu("INS_GYR2", "INS_USE2", "INS_GYR2", "INS_TCAL2_ENABLE")
FOURTH = imu("INS4_GYR", "INS4_USE", "INS4_GYR", "INS4_TCAL_ENABLE")


def test_no_sensor_needs_the_settings_alone():
    assert needed("ardupilot", [], {}, drift=False) == ARDUPILOT_ALWAYS
    assert needed("px4", [], {}, drift=False) == PX4_ALWAYS
    assert asked("px4", Sensor.TEMPERATURE) == asked("ardupilot", Sensor.TEMPERATURE) == set()


def test_rows_of_ardupilot_s_units_follow_their_ids():
    ids = {"INS_GYR2_ID", "INS_GYR3_ID"}
    assert asked("ardupilot", Sensor.GYRO) == FIRST | ids
    assert asked("ardupilot", Sensor.GYRO, {"INS_GYR2_ID": 5}) == FIRST | ids | SECOND
    far = {"INS_GYR3_ID": 7}
    third = asked("ardupilot", Sensor.GYRO, far)
    assert third >= FIRST | ids | {"INS_GYR3OFFS_X", "INS4_GYR_ID"}
    assert "INS5_GYR_ID" not in third
    fourth = asked("ardupilot", Sensor.GYRO, far | {"INS4_GYR_ID": 9})
    assert fourth - third == FOURTH - {"INS4_GYR_ID"} | {"INS5_GYR_ID"}


def test_coefficients_follow_their_switch():
    curve = {f"INS_TCAL1_GYR{k}_{a}" for k in (1, 2, 3) for a in "XYZ"} | {"INS_TCAL1_TMIN", "INS_TCAL1_TMAX"}
    ids = {"INS_GYR2_ID", "INS_GYR3_ID"}
    assert asked("ardupilot", Sensor.GYRO, {"INS_TCAL1_ENABLE": 1}) == FIRST | ids | curve
    assert asked("ardupilot", Sensor.GYRO, drift=True) == FIRST | ids | curve


COMPASS_IDS = ["COMPASS_DEV_ID", *(f"COMPASS_DEV_ID{k}" for k in range(2, 9))]
RANKS = [f"COMPASS_PRIO{k}_ID" for k in (1, 2, 3)]


@pytest.mark.parametrize(
    ("known", "every"),
    [
        ({}, False),
        ({"COMPASS_DEV_ID": 5, "COMPASS_PRIO1_ID": 5, "COMPASS_PRIO2_ID": 0}, False),
        ({"COMPASS_DEV_ID": 5, "COMPASS_DEV_ID2": 6, "COMPASS_DEV_ID3": 7, "COMPASS_PRIO1_ID": 7}, False),
        ({"COMPASS_DEV_ID": 5, "COMPASS_PRIO3_ID": 6}, True),
        ({"COMPASS_DEV_ID": 5, "COMPASS_DEV_ID4": 6, "COMPASS_PRIO3_ID": 6}, True),
        ({"COMPASS_DEV_ID": 5, "COMPASS_DEV_ID3": 6, "COMPASS_PRIO3_ID": 6}, False),
    ],
)
def test_ids_beyond_the_slots_are_asked_for_where_a_rank_is_in_none(known, every):
    found = asked("ardupilot", Sensor.MAG, known)
    assert set(RANKS) <= found
    assert found & set(COMPASS_IDS) == set(COMPASS_IDS if every else COMPASS_IDS[:3])


def test_a_motor_compensation_of_single_motors_is_asked_for_where_it_is_chosen():
    without = asked("ardupilot", Sensor.MAG, {"COMPASS_MOTCT": 2})
    gains = {"COMPASS_PMOT_EN"} | {f"COMPASS_PMOT{m}_{a}" for m in range(1, 5) for a in "XYZ"}
    assert asked("ardupilot", Sensor.MAG, {"COMPASS_MOTCT": 3}) == without | gains
    assert not without & gains
    assert asked("ardupilot", Sensor.MAG) == without


@pytest.mark.parametrize(("number", "stem"), [(100, None), (101, "CUST_ROT1"), (102, "CUST_ROT2"), (103, None)])
@pytest.mark.parametrize("name", ["AHRS_ORIENTATION", "COMPASS_ORIENT", "COMPASS_ORIENT2", "COMPASS_ORIENT3"])
def test_the_angles_of_a_custom_rotation_are_asked_for(name, number, stem):
    found = needed("ardupilot", [], {name: number}, drift=False) - ARDUPILOT_ALWAYS
    angles = {"CUST_ROT_ENABLE"} | {f"{stem}_{a}" for a in ("ROLL", "PITCH", "YAW")}
    assert found == (angles if stem else set())
    assert not any("CUST" in n for n in needed("px4", [], {name: number}, drift=False))


def row(k):
    return {f"CAL_GYRO{k}_{part}" for part in ("ID", "PRIO", "ROT", "XOFF", "YOFF", "ZOFF")}


IDS = {f"CAL_GYRO{k}_ID" for k in range(4)}


def test_rows_of_px4_wait_for_every_id_and_three_streams_need_three():
    assert asked("px4", Sensor.GYRO) == IDS
    assert asked("px4", Sensor.GYRO, dict.fromkeys(sorted(IDS)[:3], 0)) == IDS
    empty = dict.fromkeys(IDS, 0)
    assert asked("px4", Sensor.GYRO, empty) == IDS | row(0) | row(1) | row(2) | {"TC_G_ENABLE"}
    last = empty | {"CAL_GYRO3_ID": 5}
    assert asked("px4", Sensor.GYRO, last) == IDS | row(3) | row(0) | row(1) | {"TC_G_ENABLE"}
    assert asked("px4", Sensor.GYRO, dict.fromkeys(IDS, 7)) >= row(0) | row(1) | row(2) | row(3)
    magnetic = dict.fromkeys([f"CAL_MAG{k}_ID" for k in range(4)], 0)
    assert not any(name.startswith("TC_") for name in asked("px4", Sensor.MAG, magnetic, drift=True))


def test_thermal_rows_of_px4_follow_the_switch_and_their_ids():
    empty = dict.fromkeys(IDS, 0)
    plain = asked("px4", Sensor.GYRO, empty)
    owners = {f"TC_G{k}_ID" for k in range(4)}
    running = asked("px4", Sensor.GYRO, empty | {"TC_G_ENABLE": 1})
    assert running - plain == owners
    second = asked("px4", Sensor.GYRO, empty | {"TC_G_ENABLE": 1, "TC_G1_ID": 5})
    assert second - running == {f"TC_G1_X{k}_{a}" for k in range(4) for a in range(3)} | {
        "TC_G1_TMIN",
        "TC_G1_TMAX",
        "TC_G1_TREF",
    }
    whole = asked("px4", Sensor.GYRO, empty, drift=True)
    assert len(whole - plain) == 4 * (12 + 4)
