"""The parameter table of a PX4 board (main, October 2025): names, types and defaults, in alphabetical order."""

from __future__ import annotations

import re
from collections.abc import Iterator

from mavcal.service.simvehicle.config import VehicleConfig
from mavcal.service.simvehicle.mounting import ANGLES, PX4_CUSTOM, stated
from mavcal.service.simvehicle.parameters import ParameterTable, ParameterType, SimParameter, float32

ACCEL_IDS = GYRO_IDS = (1310988, 1310996, 1311004)
MAG_IDS = (197388, 197644, 197900)
SLOTS = 4
UNINITIALISED = -1
DEFAULT_PRIORITY = 50
PRIORITIES = (-1, 0, 1, 25, 50, 75, 100)

_THERMAL_SWITCH = {"A": "TC_A_ENABLE", "G": "TC_G_ENABLE", "M": "TC_M_ENABLE", "B": "TC_B_ENABLE"}
_SLOT = re.compile(r"^(CAL_(?:ACC|GYRO|MAG|BARO)\d)_(\w+)$")

# Ordinary parameters: name, f (float32) or i (int32), default.
_ORDINARY = """\
ASPD_SCALE_1 f 1|ATT_EN i 0|BAT1_CAPACITY f -1|BAT1_N_CELLS i 4|BAT1_R_INTERNAL f -1|BAT1_V_CHARGED f 4.05
BAT1_V_EMPTY f 3.6|BAT_CRIT_THR f 0.07|BAT_EMERGEN_THR f 0.05|BAT_LOW_THR f 0.15|CA_AIRFRAME i 0
CA_ROTOR_COUNT i 4|CA_ROTOR0_CT f 6.5|CA_ROTOR0_KM f 0.05|CA_ROTOR0_PX f 1|CA_ROTOR0_PY f 1
CA_ROTOR1_KM f 0.05|CA_ROTOR2_CT f 6.5|COM_ARMABLE i 1|COM_ARM_AUTH_REQ i 0|COM_ARM_BAT_MIN f -1
COM_ARM_CHK_ESCS i 0|COM_ARM_HFLT_CHK i 1|COM_ARM_IMU_ACC f 0.7|COM_ARM_IMU_GYR f 0.25|COM_ARM_MAG_ANG i 60
COM_ARM_MAG_STR i 2|COM_ARM_SDCARD i 1|COM_ARM_WO_GPS i 1|COM_DISARM_LAND f 2|COM_DISARM_PRFLT f 10
COM_DL_LOSS_T i 10|COM_FLTMODE1 i -1|COM_OBL_RC_ACT i 0|COM_POS_FS_EPH f -1|COM_RC_IN_MODE i 3
COM_RC_LOSS_T f 0.5|COM_SPOOLUP_TIME f 1|EKF2_ABL_LIM f 0.4|EKF2_ABL_GYRLIM f 3|EKF2_EN i 1
EKF2_GBIAS_INIT f 0.1|EKF2_HEAD_NOISE f 0.3|EKF2_IMU_CTRL i 7|EKF2_IMU_POS_X f 0|EKF2_IMU_POS_Y f 0
EKF2_IMU_POS_Z f 0|EKF2_MAG_ACCLIM f 0.5|EKF2_MAG_B_NOISE f 0.0001|EKF2_MAG_CHECK i 1|EKF2_MAG_CHK_INC f 20
EKF2_MAG_CHK_STR f 0.2|EKF2_MAG_DECL f 0|EKF2_MAG_DELAY f 0|EKF2_MAG_E_NOISE f 0.001|EKF2_MAG_GATE f 3
EKF2_MAG_NOISE f 0.05|EKF2_MAG_TYPE i 0|EKF2_MULTI_IMU i 0|EKF2_MULTI_MAG i 0|FD_ACT_EN i 1|FD_FAIL_P i 60
FD_FAIL_R i 60|IMU_ACCEL_CUTOFF f 30|IMU_DGYRO_CUTOFF f 20|IMU_GYRO_CAL_EN i 1|IMU_GYRO_CUTOFF f 40
IMU_GYRO_DNF_EN i 0|IMU_GYRO_NF0_FRQ f 0|IMU_GYRO_RATEMAX i 800|IMU_INTEG_RATE i 250|LNDMC_ROT_MAX f 20
MAV_COMP_ID i 1|MAV_FWDEXTSP i 1|MAV_HASH_CHK_EN i 1|MAV_HB_FORW_EN i 1|MAV_PROTO_VER i 2|MAV_RADIO_TOUT i 5
MAV_SYS_ID i 1|MAV_TYPE i 2|MC_AIRMODE i 0|MC_PITCHRATE_D f 0.003|MC_PITCHRATE_I f 0.2|MC_PITCHRATE_P f 0.15
MC_PITCH_P f 6.5|MC_ROLLRATE_D f 0.003|MC_ROLLRATE_I f 0.2|MC_ROLLRATE_MAX f 220|MC_ROLLRATE_P f 0.15
MC_ROLL_P f 6.5|MC_YAWRATE_D f 0|MC_YAWRATE_I f 0.1|MC_YAWRATE_P f 0.2|MIS_YAW_ERR f 12|MPC_ACC_UP_MAX f 4
MPC_LAND_ALT2 f 5|MPC_MAN_TILT_MAX f 35|MPC_THR_HOVER f 0.5|MPC_THR_MAX f 1|MPC_THR_MIN f 0.12
MPC_XY_CRUISE f 5|MPC_XY_P f 0.95|MPC_XY_VEL_MAX f 12|MPC_Z_P f 1|NAV_ACC_RAD f 2|NAV_DLL_ACT i 0
NAV_RCL_ACT i 2|PWM_MAIN_FUNC1 i 101|PWM_MAIN_FUNC2 i 102|PWM_MAIN_FUNC3 i 103|PWM_MAIN_FUNC4 i 104
RC1_DZ f 10|RC1_MAX f 2000|RC1_MIN f 1000|RC1_REV f 1|RC1_TRIM f 1500|RC2_MIN f 1000|RC3_TRIM f 1500
RC_MAP_PITCH i 0|RC_MAP_ROLL i 0|RC_MAP_THROTTLE i 0|RC_MAP_YAW i 0|RTL_DESCEND_ALT f 30|RTL_MIN_DIST f 10
RTL_RETURN_ALT f 60|SDLOG_BACKEND i 3|SDLOG_BOOT_BAT i 0|SDLOG_DIRS_MAX i 7|SDLOG_MISSION i 0|SDLOG_MODE i 1
SDLOG_PROFILE i 131|SDLOG_UTC_OFFSET i 0|SDLOG_UUID i 1|SENS_BARO_QNH f 1013.25|SENS_BARO_RATE f 20
SENS_BAR_AUTOCAL i 1|SENS_BOARD_ROT i 0|SENS_BOARD_X_OFF f 0|SENS_BOARD_Y_OFF f 0|SENS_BOARD_Z_OFF f 0
SENS_DPRES_OFF f 0|SENS_GPS_MASK i 7|SENS_GPS_PRIME i 0|SENS_IMU_AUTOCAL i 1|SENS_IMU_CLPNOTI i 1
SENS_IMU_MODE i 1|SENS_MAG_AUTOCAL i 1|SENS_MAG_AUTOROT i 1|SENS_MAG_MODE i 1|SENS_MAG_RATE f 15
SENS_MAG_SIDES i 63|SYS_AUTOCONFIG i 0|SYS_AUTOSTART i 4001|SYS_CAL_ACCEL i 0|SYS_CAL_BARO i 0
SYS_CAL_GYRO i 0|SYS_CAL_TDEL i 24|SYS_CAL_TMAX i 10|SYS_CAL_TMIN i 5|SYS_FAC_CAL_MODE i 0
SYS_FAILURE_EN i 0|SYS_HAS_BARO i 1|SYS_HAS_GPS i 1|SYS_HAS_MAG i 1|SYS_HITL i 0|SYS_PARAM_VER i 1
THR_MDL_FAC f 0|WV_EN i 0|WV_GAIN f 1|WV_ROLL_MIN f 1|WV_YRATE_MAX f 90"""


def px4_table(config: VehicleConfig) -> list[SimParameter]:
    """Every parameter of a board whose sensors have slots but no calibration, sorted by name."""
    entries = [*_ordinary(config), *_inertial(config), *_magnetic(config), *_thermal(), *_baro(), *_further(config)]
    for parameter in entries:
        parameter.listed = _listed_from_the_start(parameter.name, thermal_runs=not config.sitl)
    return sorted(entries, key=lambda p: p.name)


def _further(config: VehicleConfig) -> Iterator[SimParameter]:
    """Parameters that act on nothing."""
    for number in range(config.further_parameters):
        yield SimParameter(f"XTRA_{number:04}", ParameterType.REAL32, 0.0, 0.0)


def _listed_from_the_start(name: str, *, thermal_runs: bool) -> bool:
    """Slots show their id (magnetometers also their rotation), modules their switches; the rest comes with use."""
    if name.startswith("TC_"):
        return thermal_runs and name in _THERMAL_SWITCH.values()
    match = _SLOT.match(name)
    return match is None or match.group(2) == "ID" or (name.startswith("CAL_MAG") and match.group(2) == "ROT")


def _float(name: str, value: float) -> SimParameter:
    return SimParameter(name, ParameterType.REAL32, float32(value), float32(value))


def _int(name: str, value: int) -> SimParameter:
    return SimParameter(name, ParameterType.INT32, value, value)


def _ordinary(config: VehicleConfig) -> Iterator[SimParameter]:
    for entry in _ORDINARY.replace("\n", "|").split("|"):
        name, kind, value = entry.split()
        if name == "SENS_BOARD_ROT":
            value = str(config.board_orientation)
        yield _float(name, float(value)) if kind == "f" else _int(name, int(value))


def _inertial(config: VehicleConfig) -> Iterator[SimParameter]:
    for k in range(SLOTS):
        for sensor, ids in (("ACC", ACCEL_IDS), ("GYRO", GYRO_IDS)):
            slot = f"CAL_{sensor}{k}"
            present = k < config.imu_count and not config.factory
            yield _int(f"{slot}_ID", ids[k] if present else 0)
            yield _int(f"{slot}_PRIO", DEFAULT_PRIORITY if present else UNINITIALISED)
            yield _int(f"{slot}_ROT", -1)
            for axis in "XYZ":
                yield _float(f"{slot}_{axis}OFF", 0.0)
                if sensor == "ACC":
                    yield _float(f"{slot}_{axis}SCALE", 1.0)


def _magnetic(config: VehicleConfig) -> Iterator[SimParameter]:
    mountings = list(stated(config))
    for k in range(SLOTS):
        slot = f"CAL_MAG{k}"
        present = k < config.mag_count and not config.factory
        yield _int(f"{slot}_ID", MAG_IDS[k] if present else 0)
        yield _int(f"{slot}_PRIO", DEFAULT_PRIORITY if present else UNINITIALISED)
        number, angles = mountings[k] if present and config.mag_external[k] else (-1, None)
        yield _int(f"{slot}_ROT", number if angles is None else PX4_CUSTOM)
        for name, value in zip(ANGLES, angles or (0.0, 0.0, 0.0), strict=True):
            yield _float(f"{slot}_{name}", value)
        for axis in "XYZ":
            for name, value in (("OFF", 0.0), ("SCALE", 1.0), ("ODIAG", 0.0), ("COMP", 0.0)):
                yield _float(f"{slot}_{axis}{name}", value)
    yield _int("CAL_MAG_COMP_TYP", 0)
    yield _int("CAL_MAG_SIDES", 63)


def _thermal() -> Iterator[SimParameter]:
    for sensor, switch in _THERMAL_SWITCH.items():
        yield _int(switch, 0)
        if sensor == "B":
            continue
        for k in range(SLOTS):
            group = f"TC_{sensor}{k}"
            yield _int(f"{group}_ID", 0)
            for name, value in (("TMIN", 0.0), ("TMAX", 100.0), ("TREF", 25.0)):
                yield _float(f"{group}_{name}", value)
            for order in range(4):
                for axis in range(3):
                    yield _float(f"{group}_X{order}_{axis}", 0.0)


def _baro() -> Iterator[SimParameter]:
    for k in range(SLOTS):
        yield _int(f"CAL_BARO{k}_ID", 0)
        yield _float(f"CAL_BARO{k}_OFF", 0.0)
        yield _int(f"CAL_BARO{k}_PRIO", UNINITIALISED)


def mark_used(table: ParameterTable, *, thermal_runs: bool) -> None:
    """List the parameters in use from now on.

    They are the rest of a slot whose id was set, and a TC_ group whose switch was on while its module runs.
    """
    used = {
        match.group(1)
        for parameter in table
        if (match := _SLOT.match(parameter.name)) and match.group(2) == "ID" and parameter.value > 0
    }
    if thermal_runs:
        used |= {f"TC_{sensor}" for sensor, switch in _THERMAL_SWITCH.items() if table.get(switch) != 0}
    for parameter in table:
        group = parameter.name[:4] if parameter.name.startswith("TC_") else parameter.name.rpartition("_")[0]
        if not parameter.listed and group in used:
            table.show(parameter.name)


def is_volatile(name: str) -> bool:
    """Whether the hash leaves a parameter out: the calibration floats."""
    match = _SLOT.match(name)
    return match is not None and match.group(2).endswith(("OFF", "SCALE", "ODIAG", "COMP"))


def vector_names(slot: str, quantity: str) -> tuple[str, str, str]:
    """The three names of OFF, SCALE, ODIAG or COMP of a slot such as CAL_ACC0."""
    return (f"{slot}_X{quantity}", f"{slot}_Y{quantity}", f"{slot}_Z{quantity}")
