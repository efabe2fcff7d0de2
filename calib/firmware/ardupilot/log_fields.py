"""Contents of the fields of ArduPilot's DataFlash messages (FLIGHT_CONTROLLERS 2.1).

=========  =============================================================================================================
IMU        corrected, low-pass and notch filtered, float; ``T`` is the unit's own temperature
ACC GYR    corrected, before the filter, every sample of the sensor, float
ISBH ISBD  batches: bare sensor axes as the driver gives them if ``INS_LOG_BAT_OPT`` bit 0 is set, else corrected; int16
MAG        corrected field in whole mGauss, truncated toward zero; ``S`` is when the compass was read
=========  =============================================================================================================

Instances are a column (``I``, ``Instance``, ``Inst``), in older firmwares a digit of the message's name (IMU2, MAG3).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavcal.calib.recording import Rounding, Sensor, Stage

MGAUSS_UT: Final = 0.1
INSTANCE_COLUMNS: Final = ("I", "Instance", "Inst")
SAMPLE_TIME_COLUMNS: Final = ("SampleUS", "S")
"""When the sensor was read, us since boot; modulo 2^32 where the column has 32 bits."""


@dataclass(frozen=True)
class LogReading:
    """One sensor in a log message.

    `messages` holds a name for each instance from 0 on where the name tells it; the first may carry an instance
    column. `columns` are alternatives by firmware version, `healthy` a column that is 0 where the firmware distrusts
    the sensor.
    """

    sensor: Sensor
    messages: tuple[str, ...]
    columns: tuple[tuple[str, ...], ...]
    stage: Stage
    unit: str
    factor: float = 1.0
    rounding: Rounding = Rounding.NONE
    healthy: str = ""
    most: float = np.inf
    """Largest valid reading in the field's unit; more is damage."""

    @property
    def quantum(self) -> float:
        """Width of a bin in the channel's unit."""
        return 0.0 if self.rounding == Rounding.NONE else self.factor


ACCEL_COLUMNS: Final = ("AccX", "AccY", "AccZ")
GYRO_COLUMNS: Final = ("GyrX", "GyrY", "GyrZ")

ACCEL_MOST: Final = 1000.0
"""m/s2; the ranges end at 64 g and below."""
GYRO_MOST: Final = 100.0
"""rad/s; the ranges end at 4000 deg/s and below."""
TEMPERATURE_MOST: Final = 200.0

INERTIAL: Final = (
    LogReading(
        Sensor.ACCEL, ("IMU", "IMU2", "IMU3"), (ACCEL_COLUMNS,), Stage.FILTERED, "m/s2", healthy="AH", most=ACCEL_MOST
    ),
    LogReading(
        Sensor.GYRO, ("IMU", "IMU2", "IMU3"), (GYRO_COLUMNS,), Stage.FILTERED, "rad/s", healthy="GH", most=GYRO_MOST
    ),
    LogReading(
        Sensor.TEMPERATURE, ("IMU", "IMU2", "IMU3"), (("T",), ("Temp",)), Stage.RAW, "degC", most=TEMPERATURE_MOST
    ),
    LogReading(Sensor.ACCEL, ("ACC", "ACC2", "ACC3"), (ACCEL_COLUMNS,), Stage.CORRECTED, "m/s2", most=ACCEL_MOST),
    LogReading(Sensor.ACCEL, ("ACC1",), (ACCEL_COLUMNS,), Stage.CORRECTED, "m/s2", most=ACCEL_MOST),
    LogReading(Sensor.GYRO, ("GYR", "GYR2", "GYR3"), (GYRO_COLUMNS,), Stage.CORRECTED, "rad/s", most=GYRO_MOST),
    LogReading(Sensor.GYRO, ("GYR1",), (GYRO_COLUMNS,), Stage.CORRECTED, "rad/s", most=GYRO_MOST),
)

COMPASS: Final = LogReading(
    Sensor.MAG,
    ("MAG", "MAG2", "MAG3"),
    (("MagX", "MagY", "MagZ"),),
    Stage.CORRECTED,
    "uT",
    factor=MGAUSS_UT,
    rounding=Rounding.TOWARD_ZERO,
    healthy="Health",
    most=32768.0,
)

MOTOR_FUNCTIONS: Final = {**{33 + k: k for k in range(8)}, **{82 + k: 8 + k for k in range(4)}}
"""``SERVOn_FUNCTION`` of the outputs that drive motors: motor number from 0."""
THROTTLE_FUNCTIONS: Final = (70, 73, 74)
"""Throttle, left and right throttle of planes and boats."""
PWM_DEFAULT: Final = (1000.0, 2000.0)

SOFT_IRON_SINCE: Final = (3, 3)
"""Firmwares before this version have no soft iron matrix (COMPASS_DIA, COMPASS_ODI): it is the identity."""
ARMED_EVENT: Final = 10
DISARMED_EVENT: Final = 11

WANTED: Final = frozenset(
    {
        *(name for reading in (*INERTIAL, COMPASS) for name in reading.messages),
        *("ISBH", "ISBD", "PARM", "ATT", "XKQ", "NKQ", "AHR2", "GPS", "GPS2", "POS", "BAT", "BAT2", "CURR", "CUR2"),
        *("CTUN", "RCOU", "MOT", "ESC", "RPM", "SIM", "SIM2", "VIBE", "DSF", "VER", "MSG", "MODE", "EV", "ARM", "ERR"),
        *("FMTU", "UNIT", "MULT", "RATE", "MOTB", "XKF1", "NKF1", "EKF1", "XKQ1", "NKQ1", "RFND", "BARO", "FRAME"),
    }
)
"""Messages that a recording is made of."""

TEXT_COLUMNS: Final = {
    "PARM": ("Name",),
    "MSG": ("Message",),
    "MODE": ("Mode",),
    "VER": ("FWS",),
    "FMTU": ("UnitIds", "MultIds"),
    "UNIT": ("Label",),
}
"""By message: the columns that hold characters; every other one holds numbers."""


def implied_parameters(parameters: Mapping[str, float], firmware: tuple[int, int, int] | None) -> dict[str, float]:
    """Values in firmwares older than the parameter."""
    old = firmware is not None and firmware[:2] < SOFT_IRON_SINCE
    if not old or "COMPASS_OFS_X" not in parameters or any(name.startswith("COMPASS_DIA") for name in parameters):
        return {}
    found: dict[str, float] = {}
    for digit in ("", "2", "3"):
        if f"COMPASS_OFS{digit}_X" in parameters:
            found |= {f"COMPASS_DIA{digit}_{axis}": 1.0 for axis in "XYZ"}
            found |= {f"COMPASS_ODI{digit}_{axis}": 0.0 for axis in "XYZ"}
            found |= {f"COMPASS_EXTERN{digit}": 0.0, f"COMPASS_ORIENT{digit}": 0.0} if digit else {}
    return {name: value for name, value in found.items() if name not in parameters}
