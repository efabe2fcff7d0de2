"""Names of parameters, letter by letter as the firmwares spell them."""

from __future__ import annotations

import pytest

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.names import Role, ardupilot_compass_names, ardupilot_imu_names, px4_names, px4_thermal_names
from mavcal.calib.recording import Sensor


@pytest.fixture(autouse=True)
def nothing_is_remembered():
    """What was asked for before these tests must not answer them."""
    for ask in (ardupilot_imu_names, ardupilot_compass_names, px4_names, px4_thermal_names):
        ask.cache_clear()


IMU = {
    0: (
        "INS_ACC_ID",
        "INS_USE",
        "INS_ACC1_CALTEMP",
        "INS_ACCOFFS_X",
        "INS_ACCSCAL_Z",
        "INS_TCAL1_TMAX",
        "INS_TCAL1_ACC2_Y",
    ),
    1: (
        "INS_ACC2_ID",
        "INS_USE2",
        "INS_ACC2_CALTEMP",
        "INS_ACC2OFFS_X",
        "INS_ACC2SCAL_Z",
        "INS_TCAL2_TMAX",
        "INS_TCAL2_ACC2_Y",
    ),
    2: (
        "INS_ACC3_ID",
        "INS_USE3",
        "INS_ACC3_CALTEMP",
        "INS_ACC3OFFS_X",
        "INS_ACC3SCAL_Z",
        "INS_TCAL3_TMAX",
        "INS_TCAL3_ACC2_Y",
    ),
    3: (
        "INS4_ACC_ID",
        "INS4_USE",
        "INS4_ACC_CALTEMP",
        "INS4_ACCOFFS_X",
        "INS4_ACCSCAL_Z",
        "INS4_TCAL_TMAX",
        "INS4_TCAL_ACC2_Y",
    ),
    4: (
        "INS5_ACC_ID",
        "INS5_USE",
        "INS5_ACC_CALTEMP",
        "INS5_ACCOFFS_X",
        "INS5_ACCSCAL_Z",
        "INS5_TCAL_TMAX",
        "INS5_TCAL_ACC2_Y",
    ),
}
ROLES = (Role.ID, Role.USE, Role.TEMPERATURE, Role.OFFSET_X, Role.SCALE_Z, Role.THERMAL_MAX, Role.THERMAL_2_Y)


@pytest.mark.parametrize("slot", IMU)
def test_ardupilot_s_inertial_units(slot):
    accel, gyro = ardupilot_imu_names(Sensor.ACCEL, slot), ardupilot_imu_names(Sensor.GYRO, slot)
    assert tuple(accel[role] for role in ROLES) == IMU[slot]
    assert tuple(gyro.get(role) for role in ROLES) == tuple(
        None if "SCAL" in name else name.replace("ACC", "GYR") for name in IMU[slot]
    )
    assert (len(accel), len(gyro)) == (21, 18)
    assert accel[Role.THERMAL_ENABLE].endswith("ENABLE")
    assert accel[Role.THERMAL_MIN] == accel[Role.THERMAL_MAX].replace("TMAX", "TMIN")
    assert [accel[Role(f"thermal_{k}_x")][-5:] for k in (1, 2, 3)] == ["CC1_X", "CC2_X", "CC3_X"]
    assert len(set(accel.values()) | set(gyro.values())) == 21 + 18 - 4  # the switch, both ends and the use are shared


@pytest.mark.parametrize(
    ("slot", "priority", "found"),
    [
        (0, 1, ("COMPASS_DEV_ID", "COMPASS_USE2", "COMPASS_PRIO2_ID", "COMPASS_EXTERNAL", "COMPASS_OFS_X")),
        (1, 0, ("COMPASS_DEV_ID2", "COMPASS_USE", "COMPASS_PRIO1_ID", "COMPASS_EXTERN2", "COMPASS_OFS2_X")),
        (2, 2, ("COMPASS_DEV_ID3", "COMPASS_USE3", "COMPASS_PRIO3_ID", "COMPASS_EXTERN3", "COMPASS_OFS3_X")),
    ],
)
def test_ardupilot_s_compasses_by_slot_and_rank(slot, priority, found):
    names = ardupilot_compass_names(slot, priority)
    assert tuple(names[r] for r in (Role.ID, Role.USE, Role.PRIORITY, Role.EXTERNAL, Role.OFFSET_X)) == found
    assert len(names) == 19


@pytest.mark.parametrize(("sensor", "count"), [(Sensor.ACCEL, 9), (Sensor.GYRO, 6), (Sensor.MAG, 19)])
def test_px4_s_rows(sensor, count):
    names = px4_names(sensor, 2)
    short = {Sensor.ACCEL: "ACC", Sensor.GYRO: "GYRO", Sensor.MAG: "MAG"}[sensor]
    assert len(names) == count
    assert names[Role.OFFSET_Y] == f"CAL_{short}2_YOFF"
    assert names[Role.PRIORITY] == f"CAL_{short}2_PRIO"
    assert names.get(Role.SCALE_Z) == (None if sensor == Sensor.GYRO else f"CAL_{short}2_ZSCALE")
    mag = sensor == Sensor.MAG
    assert names.get(Role.CROSS_YZ) == ("CAL_MAG2_ZODIAG" if mag else None)
    assert names.get(Role.ROTATION_PITCH) == ("CAL_MAG2_PITCH" if mag else None)
    assert names.get(Role.MOTOR_TYPE) == ("CAL_MAG_COMP_TYP" if mag else None)


def test_px4_s_thermal_rows():
    for sensor, letter in ((Sensor.ACCEL, "A"), (Sensor.GYRO, "G")):
        names = px4_thermal_names(sensor, 3)
        assert len(names) == 5 + 12
        assert names[Role.THERMAL_ENABLE] == f"TC_{letter}_ENABLE"
        assert [names[Role(f"thermal_{k}_{a}")] for k in range(4) for a in "xyz"] == [
            f"TC_{letter}3_X{k}_{n}" for k in range(4) for n in range(3)
        ]
    assert not px4_thermal_names(Sensor.MAG, 0)


@pytest.mark.parametrize(
    ("ask", "count", "who"),
    [
        (lambda k: ardupilot_imu_names(Sensor.GYRO, k), 5, "ArduPilot"),
        (lambda k: ardupilot_compass_names(k, 0), 3, "ArduPilot"),
        (lambda k: ardupilot_compass_names(0, k), 3, "ArduPilot"),
        (lambda k: px4_names(Sensor.MAG, k), 4, "PX4"),
        (lambda k: px4_thermal_names(Sensor.ACCEL, k), 4, "PX4"),
    ],
)
def test_there_is_no_row_beyond_the_last_and_it_is_said(ask, count, who):
    assert ask(0)
    assert ask(count - 1)
    for k in (-1, count):
        with pytest.raises(
            FirmwareError, match=f"{who} has parameters for {count} sensors; there is no number {k + 1}"
        ):
            ask(k)
