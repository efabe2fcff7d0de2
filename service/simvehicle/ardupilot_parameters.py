"""The parameter table of a new ArduCopter 4.7-dev board: names, types and defaults of the firmware."""

from __future__ import annotations

import re
from collections.abc import Iterator

from mavcal.service.simvehicle.config import MAX_IMUS, VehicleConfig
from mavcal.service.simvehicle.errors import ConfigurationError
from mavcal.service.simvehicle.mounting import ANGLES, ARDUPILOT_CUSTOM, stated
from mavcal.service.simvehicle.parameters import AXES, ParameterType, SimParameter, Value, float32

ACCEL_IDS = (2753028, 2753036, 2753044)
GYRO_IDS = (2752772, 2752780, 2752788)
MAG_IDS = (97539, 131874, 263178)
UNKNOWN_CALTEMP = -300.0

_I8, _I16, _I32, _F = ParameterType.INT8, ParameterType.INT16, ParameterType.INT32, ParameterType.REAL32

# Members of these groups stay hidden until the group's own switch is on (AP_PARAM_FLAG_ENABLE).
_GROUPS = re.compile(r"^(INS_TCAL[1-3]|COMPASS_PMOT|CUST_ROT|INS_HNTCH|INS_HNTC2)_?")
_SWITCHES = {
    "INS_TCAL1": "INS_TCAL1_ENABLE",
    "INS_TCAL2": "INS_TCAL2_ENABLE",
    "INS_TCAL3": "INS_TCAL3_ENABLE",
    "COMPASS_PMOT": "COMPASS_PMOT_EN",
    "CUST_ROT": "CUST_ROT_ENABLE",
}

# Ordinary parameters: name, type, default. They make the list realistic; nothing here acts on a sensor.
_BEFORE = """\
FORMAT_VERSION 4 120|PILOT_THR_FILT 9 0|PILOT_TKOFF_ALT 9 0|PILOT_THR_BHV 4 0|GCS_PID_MASK 4 0|RTL_ALT 6 1500
RTL_CONE_SLOPE 9 3|RTL_SPEED 4 0|RTL_ALT_FINAL 4 0|RTL_CLIMB_MIN 4 0|RTL_LOIT_TIME 6 5000|RTL_ALT_TYPE 2 0
FS_GCS_ENABLE 2 0|SUPER_SIMPLE 2 0|WP_YAW_BEHAVIOR 2 2|LAND_SPEED 4 50|PILOT_SPEED_UP 4 250|PILOT_ACCEL_Z 4 250
FS_THR_ENABLE 2 1|FS_THR_VALUE 4 975|THR_DZ 4 100|FLTMODE1 2 7|FLTMODE2 2 9|FLTMODE3 2 6|FLTMODE4 2 3|FLTMODE5 2 5
FLTMODE6 2 0|FLTMODE_CH 2 5|INITIAL_MODE 2 0|LOG_BITMASK 6 180222|ESC_CALIBRATION 2 0|TUNE 2 0|FRAME_TYPE 2 0
ARMING_ACCTHRESH 9 0.75|ARMING_RUDDER 2 2|ARMING_MIS_ITEMS 6 0|ARMING_CHECK 6 1|ARMING_OPTIONS 6 0
ARMING_MAGTHRESH 4 100|ARMING_NEED_LOC 2 0|DISARM_DELAY 2 10|ANGLE_MAX 4 3000|FS_EKF_ACTION 2 1|FS_EKF_THRESH 9 0.8
FS_CRASH_CHECK 2 1|RC_SPEED 4 490|WPNAV_SPEED 9 1000|WPNAV_RADIUS 9 200|LOIT_SPEED 9 1250|LOIT_ACC_MAX 9 500"""
_AFTER = """\
BATT_MONITOR 2 4|BATT_CAPACITY 6 3300|BATT_SERIAL_NUM 6 -1|BATT_LOW_TIMER 2 10|BATT_LOW_VOLT 9 10.5
BATT_ARM_VOLT 9 0|BATT_OPTIONS 6 0|BATT_VOLT_PIN 2 13|BATT_CURR_PIN 2 12|BATT_VOLT_MULT 9 10.1|BATT_AMP_PERVLT 9 17
BRD_SAFETY_DEFLT 2 0|BRD_SERIAL_NUM 6 0|BRD_SAFETY_MASK 6 16368|BRD_SAFETYOPTION 4 3|BRD_OPTIONS 6 0
BRD_BOOT_DELAY 4 0|SCHED_DEBUG 2 0|SCHED_LOOP_RATE 4 400|SCHED_OPTIONS 2 0|MOT_YAW_HEADROOM 4 200|MOT_THST_EXPO 9 0.65
MOT_SPIN_MAX 9 0.95|MOT_BAT_VOLT_MAX 9 12.8|MOT_BAT_VOLT_MIN 9 9.6|MOT_PWM_TYPE 2 0|MOT_PWM_MIN 4 1000
MOT_PWM_MAX 4 2000|MOT_SPIN_MIN 9 0.15|MOT_SPIN_ARM 9 0.1|MOT_THST_HOVER 9 0.39|MOT_HOVER_LEARN 2 2|RCMAP_ROLL 2 1
RCMAP_PITCH 2 2|RCMAP_THROTTLE 2 3|RCMAP_YAW 2 4|EK2_ENABLE 2 0|EK3_ENABLE 2 1|EK3_IMU_MASK 2 3|FRAME_CLASS 2 1
ATC_RAT_RLL_P 9 0.135|ATC_RAT_RLL_I 9 0.135|ATC_RAT_RLL_D 9 0.0036|ATC_RAT_PIT_P 9 0.135|ATC_RAT_PIT_I 9 0.135
ATC_RAT_PIT_D 9 0.0036|ATC_RAT_YAW_P 9 0.3|ATC_RAT_YAW_I 9 0.02|PSC_POSZ_P 9 1|PSC_VELZ_P 9 5|PSC_ACCZ_P 9 0.5
PSC_ACCZ_I 9 1|PSC_POSXY_P 9 1|PSC_VELXY_P 9 2|PSC_VELXY_I 9 1|RC_OVERRIDE_TIME 9 3|RC_OPTIONS 6 32|RC_PROTOCOLS 6 1
STAT_BOOTCNT 4 1|STAT_FLTTIME 6 0|STAT_RUNTIME 6 0|STAT_RESET 6 1|LOG_BACKEND_TYPE 2 1|LOG_DISARMED 2 0
LOG_FILE_BUFSIZE 4 200|LOG_MAX_FILES 4 500|MAV_SYSID 4 1|MAV_GCS_SYSID 4 255|MAV_OPTIONS 4 0|MAV_TELEM_DELAY 2 0
MAV1_RAW_SENS 4 0|MAV1_EXT_STAT 4 0|MAV1_RC_CHAN 4 0|MAV1_POSITION 4 0|MAV1_EXTRA1 4 0|MAV1_EXTRA2 4 0|MAV1_EXTRA3 4 0
MAV1_PARAMS 4 0|MAV2_RAW_SENS 4 0|MAV2_EXT_STAT 4 0|MAV2_POSITION 4 0|MAV2_EXTRA1 4 0|MAV2_PARAMS 4 0"""


def ardupilot_table(config: VehicleConfig) -> list[SimParameter]:
    """Every parameter of a never calibrated board, in listing order."""
    return [
        *_ordinary(_BEFORE),
        *_compass(config),
        *_ins(config),
        *_ahrs(config),
        *_ordinary(_AFTER),
        *further(config),
    ]


def further(config: VehicleConfig) -> Iterator[SimParameter]:
    """Parameters without effect."""
    return (_make(f"XTRA_{number:04}", _F, 0.0) for number in range(config.further_parameters))


def hidden_by_group(name: str, value_of: dict[str, SimParameter]) -> bool:
    """Whether a parameter is left out of the list because its group is switched off."""
    match = _GROUPS.match(name)
    switch = _SWITCHES.get(match.group(1)) if match else None
    if switch is None or name == switch or switch not in value_of:
        return False
    return value_of[switch].value == 0


def _make(name: str, kind: ParameterType, value: float) -> SimParameter:
    typed: Value = float32(value) if kind is _F else int(value)
    return SimParameter(name, kind, typed, typed)


def _ordinary(text: str) -> Iterator[SimParameter]:
    for entry in text.replace("\n", "|").split("|"):
        name, kind, value = entry.split()
        yield _make(name, ParameterType(int(kind)), float(value))


def _vector(base: str, value: float) -> Iterator[SimParameter]:
    return (_make(f"{base}_{axis}", _F, value) for axis in AXES)


def _digit(instance: int) -> str:
    """Digit of an instance in names; empty for instance 1."""
    return "" if instance == 0 else str(instance + 1)


def _compass(config: VehicleConfig) -> Iterator[SimParameter]:
    count = config.mag_count
    orientations = _orientations(config)
    for k in range(3):
        yield from _vector(f"COMPASS_OFS{_digit(k)}", 0.0)
        yield from _vector(f"COMPASS_MOT{_digit(k)}", 0.0)
        yield from _vector(f"COMPASS_DIA{_digit(k)}", 1.0)
        yield from _vector(f"COMPASS_ODI{_digit(k)}", 0.0)
        external = k < count and config.mag_external[k]
        yield _make(f"COMPASS_SCALE{_digit(k)}", _F, 0.0)
        yield _make(f"COMPASS_USE{_digit(k)}", _I8, 1)
        yield _make(f"COMPASS_ORIENT{_digit(k)}", _I8, orientations[k] if external else 0)
        yield _make("COMPASS_EXTERNAL" if k == 0 else f"COMPASS_EXTERN{k + 1}", _I8, external)
        yield _make(f"COMPASS_DEV_ID{_digit(k)}", _I32, MAG_IDS[k] if k < count else 0)
        yield _make(f"COMPASS_PRIO{k + 1}_ID", _I32, MAG_IDS[k] if k < count else 0)
    for name, kind, value in (
        ("DEC", _F, 0),
        ("LEARN", _I8, 0),
        ("AUTODEC", _I8, 1),
        ("MOTCT", _I8, 0),
        ("CAL_FIT", _F, 16),
        ("OFFS_MAX", _I16, 1800),
        ("DISBLMSK", _I32, 0),
        ("FLTR_RNG", _I8, 0),
        ("AUTO_ROT", _I8, 2),
        ("ENABLE", _I8, 1),
        ("OPTIONS", _I16, 0),
        *((f"DEV_ID{k}", _I32, 0) for k in range(4, 9)),
        ("PMOT_EN", _I8, 0),
        ("PMOT_EXP", _F, 0.65),
    ):
        yield _make(f"COMPASS_{name}", kind, value)
    for motor in range(1, 5):
        yield from _vector(f"COMPASS_PMOT{motor}", 0.0)


def _ins(config: VehicleConfig) -> Iterator[SimParameter]:
    for k in range(MAX_IMUS):
        present = k < config.imu_count
        yield from _vector(gyro_offset_name(k), 0.0)
        yield from _vector(accel_scale_name(k), 1.0)
        yield from _vector(accel_offset_name(k), 0.0)
        yield _make(f"INS_USE{_digit(k)}", _I8, 1)
        yield from _vector(f"INS_POS{k + 1}", 0.0)
        yield _make(f"INS_GYR{_digit(k)}_ID", _I32, GYRO_IDS[k] if present else 0)
        yield _make(f"INS_ACC{_digit(k)}_ID", _I32, ACCEL_IDS[k] if present else 0)
        yield _make(f"INS_ACC{k + 1}_CALTEMP", _F, UNKNOWN_CALTEMP)
        yield _make(f"INS_GYR{k + 1}_CALTEMP", _F, UNKNOWN_CALTEMP)
    for name, kind, value in (
        ("GYRO_FILTER", _I16, 20),
        ("ACCEL_FILTER", _I16, 20),
        ("STILL_THRESH", _F, 2.5),
        ("GYR_CAL", _I8, 1),
        ("TRIM_OPTION", _I8, 1),
        ("ACC_BODYFIX", _I8, 2),
        ("FAST_SAMPLE", _I8, 1),
        ("ENABLE_MASK", _I8, 127),
        ("GYRO_RATE", _I8, 0),
        ("LOG_BAT_CNT", _I16, 1024),
        ("LOG_BAT_MASK", _I8, 0),
        ("LOG_BAT_OPT", _I8, 0),
        ("HNTCH_ENABLE", _I8, 0),
        ("HNTC2_ENABLE", _I8, 0),
        ("TCAL_OPTIONS", _I32, 0),
        ("RAW_LOG_OPT", _I16, 0),
    ):
        yield _make(f"INS_{name}", kind, value)
    for k in range(MAX_IMUS):
        yield from _thermal(f"INS_TCAL{k + 1}", factory=config.factory)


def _thermal(group: str, *, factory: bool) -> Iterator[SimParameter]:
    # the documented default of TMAX is 70, but a group that was never switched on holds 0 (captured, 4.7-dev)
    yield _make(f"{group}_ENABLE", _I8, 0)
    yield _make(f"{group}_TMIN", _F, 0)
    yield _make(f"{group}_TMAX", _F, 0 if factory else 70)
    for sensor in ("ACC", "GYR"):
        for order in (1, 2, 3):
            yield from _vector(f"{group}_{sensor}{order}", 0.0)


def _ahrs(config: VehicleConfig) -> Iterator[SimParameter]:
    yield from _ordinary("AHRS_GPS_GAIN 9 1|AHRS_GPS_USE 2 1|AHRS_YAW_P 9 0.2|AHRS_RP_P 9 0.2|AHRS_WIND_MAX 2 0")
    yield from _vector("AHRS_TRIM", 0.0)
    yield _make("AHRS_ORIENTATION", _I8, config.board_orientation)
    yield from _ordinary("AHRS_COMP_BETA 9 0.1|AHRS_GPS_MINSATS 2 6|AHRS_EKF_TYPE 2 3|AHRS_OPTIONS 4 0")
    custom = _by_angles(config)
    yield _make("CUST_ROT_ENABLE", _I8, 1 if custom else 0)
    for number, stem in ARDUPILOT_CUSTOM.items():
        for name, angle in zip(ANGLES, custom.get(number, (0.0, 0.0, 0.0)), strict=True):
            yield _make(f"{stem}_{name}", _F, angle)


def _by_angles(config: VehicleConfig) -> dict[int, tuple[float, float, float]]:
    """Angles by the number of the custom rotation that holds them."""
    wanted = [angles for _, angles in stated(config) if angles is not None]
    if len(wanted) > len(ARDUPILOT_CUSTOM):
        raise ConfigurationError(f"mag_angles_deg: ArduPilot has {len(ARDUPILOT_CUSTOM)} custom rotations")
    return dict(zip(ARDUPILOT_CUSTOM, wanted, strict=False))


def _orientations(config: VehicleConfig) -> list[int]:
    free = iter(_by_angles(config))
    return [number if angles is None else next(free) for number, angles in stated(config)]


def accel_offset_name(instance: int) -> str:
    """Base name of an accelerometer offset vector."""
    return f"INS_ACC{_digit(instance)}OFFS"


def accel_scale_name(instance: int) -> str:
    """Base name of an accelerometer scale vector."""
    return f"INS_ACC{_digit(instance)}SCAL"


def gyro_offset_name(instance: int) -> str:
    """Base name of a gyroscope offset vector."""
    return f"INS_GYR{_digit(instance)}OFFS"


def id_name(sensor: str, instance: int) -> str:
    """Name of a device id; sensor is ACC or GYR."""
    return f"INS_{sensor}{_digit(instance)}_ID"


def caltemp_name(sensor: str, instance: int) -> str:
    """Name of a calibration temperature: here instance 1 does carry its digit."""
    return f"INS_{sensor}{instance + 1}_CALTEMP"


def use_name(instance: int) -> str:
    """Name of an IMU's use switch."""
    return f"INS_USE{_digit(instance)}"


def compass_name(quantity: str, slot: int) -> str:
    """Base name of a compass quantity (OFS, DIA, ODI, MOT, SCALE, USE, ORIENT, DEV_ID) of a state slot."""
    return f"COMPASS_{quantity}{_digit(slot)}"


def compass_external_name(slot: int) -> str:
    """Name of the switch that says a compass is external."""
    return "COMPASS_EXTERNAL" if slot == 0 else f"COMPASS_EXTERN{slot + 1}"
