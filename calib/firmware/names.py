"""Names of every calibration parameter, a table for each autopilot.

Names follow a *slot* (a row of parameters on the vehicle), streams follow an *instance*;
:mod:`calib.firmware.slots` takes one to the other. Sources: FLIGHT_CONTROLLERS 1.1-1.4 (ArduPilot
``AP_InertialSensor.cpp``, ``AP_InertialSensor_Params.cpp``, ``AP_Compass.cpp``; PX4 ``sensors/module.yaml``).
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from functools import cache
from types import MappingProxyType
from typing import Final

from mavcal.calib.errors import FirmwareError
from mavcal.calib.recording import Sensor


class Role(StrEnum):
    """Meaning of a calibration parameter, independent of its name on an autopilot."""

    ID = "id"  # device id of the sensor that the slot belongs to
    USE = "use"  # AP: 0/1; by priority for a compass, not by slot
    PRIORITY = "priority"  # PX4 CAL_*_PRIO (0 disables the sensor); AP COMPASS_PRIOn_ID (a device id)
    OFFSET_X = "offset_x"  # m/s2, rad/s; AP compass: mGauss, added; PX4 compass: Gauss, subtracted
    OFFSET_Y = "offset_y"
    OFFSET_Z = "offset_z"
    SCALE_X = "scale_x"  # multiplied; the diagonal of a compass matrix
    SCALE_Y = "scale_y"
    SCALE_Z = "scale_z"
    CROSS_XY = "cross_xy"  # off-diagonal elements of a symmetric compass matrix
    CROSS_XZ = "cross_xz"
    CROSS_YZ = "cross_yz"
    FIELD_SCALE = "field_scale"  # AP COMPASS_SCALE: a common factor, used inside its window only
    ROTATION = "rotation"  # number of the mounting rotation of this sensor
    ROTATION_ROLL = "rotation_roll"  # degrees, where ROTATION says "custom"
    ROTATION_PITCH = "rotation_pitch"
    ROTATION_YAW = "rotation_yaw"
    EXTERNAL = "external"  # AP compass: 0 internal, 1 external, 2 forced external
    MOTOR_TYPE = "motor_type"  # AP COMPASS_MOTCT, PX4 CAL_MAG_COMP_TYP
    MOTOR_X = "motor_x"  # AP mGauss per A or per 0..1; PX4 Gauss per kA or per unit thrust
    MOTOR_Y = "motor_y"
    MOTOR_Z = "motor_z"
    TEMPERATURE = "temperature"  # AP CALTEMP: degC at which the offset was taken
    THERMAL_ENABLE = "thermal_enable"
    THERMAL_ID = "thermal_id"  # PX4: device id that the thermal row belongs to
    THERMAL_MIN = "thermal_min"
    THERMAL_MAX = "thermal_max"
    THERMAL_REF = "thermal_ref"  # PX4; ArduPilot's reference is 35 degC, fixed
    THERMAL_0_X = "thermal_0_x"  # PX4 only: the constant term
    THERMAL_0_Y = "thermal_0_y"
    THERMAL_0_Z = "thermal_0_z"
    THERMAL_1_X = "thermal_1_x"  # AP: times 1e6
    THERMAL_1_Y = "thermal_1_y"
    THERMAL_1_Z = "thermal_1_z"
    THERMAL_2_X = "thermal_2_x"
    THERMAL_2_Y = "thermal_2_y"
    THERMAL_2_Z = "thermal_2_z"
    THERMAL_3_X = "thermal_3_x"
    THERMAL_3_Y = "thermal_3_y"
    THERMAL_3_Z = "thermal_3_z"


Triple = tuple[Role, Role, Role]


def _triple(stem: str) -> Triple:
    return Role(f"{stem}_x"), Role(f"{stem}_y"), Role(f"{stem}_z")


OFFSET: Final[Triple] = _triple("offset")
SCALE: Final[Triple] = _triple("scale")
CROSS: Final[Triple] = (Role.CROSS_XY, Role.CROSS_XZ, Role.CROSS_YZ)
MOTOR: Final[Triple] = _triple("motor")
ROTATION_EULER: Final[Triple] = (Role.ROTATION_ROLL, Role.ROTATION_PITCH, Role.ROTATION_YAW)
THERMAL: Final[tuple[Triple, ...]] = tuple(_triple(f"thermal_{k}") for k in range(4))
"""Coefficient names by order 0..3; order 0 exists on PX4 only."""

ARDUPILOT_IMU_SLOTS: Final = 5
ARDUPILOT_COMPASS_SLOTS: Final = 3
ARDUPILOT_COMPASS_IDS: Final = 8
PX4_SLOTS: Final = 4

ARDUPILOT_PREFIXES: Final = (
    "INS_ACC",
    "INS_GYR",
    "INS_TCAL",
    "INS4_",
    "INS5_",
    "INS_USE",
    "COMPASS_OFS",
    "COMPASS_DIA",
    "COMPASS_ODI",
    "COMPASS_SCALE",
    "COMPASS_MOT",
    "COMPASS_PMOT",
    "COMPASS_ORIENT",
    "COMPASS_EXTERN",
    "COMPASS_DEV_ID",
    "COMPASS_PRIO",
    "COMPASS_USE",
    "AHRS_ORIENTATION",
    "CUST_ROT",
)
PX4_PREFIXES: Final = ("CAL_ACC", "CAL_GYRO", "CAL_MAG", "TC_A", "TC_G", "TC_M", "SENS_BOARD_")
CALIBRATION_PREFIXES: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {"ardupilot": ARDUPILOT_PREFIXES, "px4": PX4_PREFIXES}
)
"""Names that decide, by autopilot, what a streamed number means."""

BOARD_ROTATION: Final[Mapping[str, str]] = MappingProxyType({"ardupilot": "AHRS_ORIENTATION", "px4": "SENS_BOARD_ROT"})
ARDUPILOT_CUSTOM_SWITCH: Final = "CUST_ROT_ENABLE"
ARDUPILOT_CUSTOM: Final[Mapping[int, tuple[str, str, str]]] = MappingProxyType(
    {100 + k: (f"CUST_ROT{k}_ROLL", f"CUST_ROT{k}_PITCH", f"CUST_ROT{k}_YAW") for k in (1, 2)}
)
"""The two rotations by angles in degrees, by the number that COMPASS_ORIENT and AHRS_ORIENTATION call them by
(AP_CustomRotations; since 4.3)."""
PX4_CUSTOM: Final = 100
"""CAL_MAGn_ROT where the angles of the row hold (``lib/conversion/rotation.h``, ROTATION_CUSTOM)."""
PX4_LEVEL: Final = ("SENS_BOARD_X_OFF", "SENS_BOARD_Y_OFF", "SENS_BOARD_Z_OFF")
LEVEL: Final = ("AHRS_TRIM_", *PX4_LEVEL)
"""Beginnings of the parameters that a ground station saves when a vehicle is levelled."""
"""PX4's fine board rotation, degrees roll, pitch, yaw; applied to every sensor."""


def _axes(template: str, roles: Triple, letters: str = "XYZ") -> dict[Role, str]:
    return {role: template.format(letter) for role, letter in zip(roles, letters, strict=True)}


def _check(slot: int, slots: int, what: str) -> None:
    if not 0 <= slot < slots:
        raise FirmwareError(f"{what} has parameters for {slots} sensors; there is no number {slot + 1}")


@cache
def ardupilot_imu_names(sensor: Sensor, slot: int) -> Mapping[Role, str]:
    """Names of accelerometer or gyroscope `slot` (0-based).

    The first slot has no digit in ``INS_ACCOFFS`` but has one in ``INS_ACC1_CALTEMP`` and ``INS_TCAL1_``; the fourth
    and fifth carry the digit in front (``INS4_ACCOFFS_X``).
    """
    _check(slot, ARDUPILOT_IMU_SLOTS, "ArduPilot")
    number, short = slot + 1, "ACC" if sensor == Sensor.ACCEL else "GYR"
    digit = "" if slot == 0 else str(number)
    if slot < 3:
        stem, caltemp, tcal, use = (
            f"INS_{short}{digit}",
            f"INS_{short}{number}",
            f"INS_TCAL{number}_",
            f"INS_USE{digit}",
        )
    else:
        stem, caltemp, tcal, use = (
            f"INS{number}_{short}",
            f"INS{number}_{short}",
            f"INS{number}_TCAL_",
            f"INS{number}_USE",
        )
    names = {Role.ID: f"{stem}_ID", Role.USE: use, Role.TEMPERATURE: f"{caltemp}_CALTEMP"}
    names |= _axes(f"{stem}OFFS_{{}}", OFFSET)
    if sensor == Sensor.ACCEL:
        names |= _axes(f"{stem}SCAL_{{}}", SCALE)
    names |= {
        Role.THERMAL_ENABLE: f"{tcal}ENABLE",
        Role.THERMAL_MIN: f"{tcal}TMIN",
        Role.THERMAL_MAX: f"{tcal}TMAX",
    }
    for order in (1, 2, 3):
        names |= _axes(f"{tcal}{short}{order}_{{}}", THERMAL[order])
    return MappingProxyType(names)


@cache
def ardupilot_compass_names(slot: int, priority: int) -> Mapping[Role, str]:
    """Names of the compass whose state is in `slot` and whose rank (its MAVLink instance) is `priority`.

    The digit stands before the axis (``COMPASS_OFS2_X``) and the first slot has none. ``COMPASS_USE`` counts by rank.
    """
    _check(slot, ARDUPILOT_COMPASS_SLOTS, "ArduPilot")
    _check(priority, ARDUPILOT_COMPASS_SLOTS, "ArduPilot")
    digit = "" if slot == 0 else str(slot + 1)
    names = {
        Role.ID: f"COMPASS_DEV_ID{digit}",
        Role.USE: "COMPASS_USE" + ("" if priority == 0 else str(priority + 1)),
        Role.PRIORITY: f"COMPASS_PRIO{priority + 1}_ID",
        Role.FIELD_SCALE: f"COMPASS_SCALE{digit}",
        Role.ROTATION: f"COMPASS_ORIENT{digit}",
        Role.EXTERNAL: "COMPASS_EXTERNAL" if slot == 0 else f"COMPASS_EXTERN{digit}",
        Role.MOTOR_TYPE: "COMPASS_MOTCT",
    }
    names |= _axes(f"COMPASS_OFS{digit}_{{}}", OFFSET)
    names |= _axes(f"COMPASS_DIA{digit}_{{}}", SCALE)
    names |= _axes(f"COMPASS_ODI{digit}_{{}}", CROSS)
    names |= _axes(f"COMPASS_MOT{digit}_{{}}", MOTOR)
    return MappingProxyType(names)


_PX4_STEM = {Sensor.ACCEL: "CAL_ACC", Sensor.GYRO: "CAL_GYRO", Sensor.MAG: "CAL_MAG"}
_PX4_THERMAL_LETTER = {Sensor.ACCEL: "A", Sensor.GYRO: "G"}


@cache
def px4_names(sensor: Sensor, slot: int) -> Mapping[Role, str]:
    """Names of ``CAL_*`` row `slot`. There is no gyroscope scale."""
    _check(slot, PX4_SLOTS, "PX4")
    row = f"{_PX4_STEM[sensor]}{slot}_"
    names = {Role.ID: f"{row}ID", Role.PRIORITY: f"{row}PRIO", Role.ROTATION: f"{row}ROT"}
    names |= _axes(f"{row}{{}}OFF", OFFSET)
    if sensor != Sensor.GYRO:
        names |= _axes(f"{row}{{}}SCALE", SCALE)
    if sensor == Sensor.MAG:
        names |= _axes(f"{row}{{}}ODIAG", CROSS)
        names |= _axes(f"{row}{{}}COMP", MOTOR)
        names[Role.MOTOR_TYPE] = "CAL_MAG_COMP_TYP"
        names |= {role: f"{row}{role.value.removeprefix('rotation_').upper()}" for role in ROTATION_EULER}
    return MappingProxyType(names)


@cache
def px4_thermal_names(sensor: Sensor, slot: int) -> Mapping[Role, str]:
    """Names of ``TC_*`` row `slot`; empty for a magnetometer, whose thermal row PX4 loads and never uses."""
    _check(slot, PX4_SLOTS, "PX4")
    if sensor not in _PX4_THERMAL_LETTER:
        return MappingProxyType({})
    letter = _PX4_THERMAL_LETTER[sensor]
    row = f"TC_{letter}{slot}_"
    names = {
        Role.THERMAL_ENABLE: f"TC_{letter}_ENABLE",
        Role.THERMAL_ID: f"{row}ID",
        Role.THERMAL_MIN: f"{row}TMIN",
        Role.THERMAL_MAX: f"{row}TMAX",
        Role.THERMAL_REF: f"{row}TREF",
    }
    for order in range(4):
        names |= _axes(f"{row}X{order}_{{}}", THERMAL[order], "012")
    return MappingProxyType(names)
