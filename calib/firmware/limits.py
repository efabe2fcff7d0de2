"""Limits beyond which a calibration value is refused.

Neither firmware checks a range when a parameter is set (FLIGHT_CONTROLLERS 3.1), so the limits are ours to enforce.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class ParameterLimit:
    """Range of a family of parameters, with its source and the remedy beyond it."""

    pattern: re.Pattern[str]
    low: float
    high: float
    unit: str
    source: str
    remedy: str

    def refusal(self, name: str, value: float) -> str:
        """One sentence for the operator."""
        return (
            f"{name} would be {value:.6g} {self.unit}".rstrip()
            + f", outside {self.low:g} ... {self.high:g} ({self.source}): {self.remedy}"
        )


def _limit(pattern: str, low: float, high: float, unit: str, source: str, remedy: str) -> ParameterLimit:
    return ParameterLimit(re.compile(pattern), low, high, unit, source, remedy)


_POSES = "repeat the six poses on a firm, still surface; if it persists, the sensor is damaged"
_MAGNET = "move the vehicle away from iron and magnets and repeat; if it persists, the compass is magnetised or damaged"
_STILL = "hold the vehicle still and repeat; if it persists, the gyroscope is damaged"
_WARM = "repeat the warm-up without touching the vehicle"

LIMITS: Final = (
    _limit(r"INS\d?_ACC\d?OFFS_[XYZ]", -3.5, 3.5, "m/s2", "documented range of ArduPilot", _POSES),
    _limit(r"INS\d?_ACC\d?SCAL_[XYZ]", 0.8, 1.2, "", "range of ArduPilot's own calibration", _POSES),
    # No range is documented: 20 deg/s is the zero-rate output of the worst part in use (MPU-6000 datasheet).
    _limit(r"INS\d?_GYR\d?OFFS_[XYZ]", -0.35, 0.35, "rad/s", "20 deg/s", _STILL),
    _limit(r"INS\d?_TCAL\d?_T(MIN|MAX)", -70.0, 80.0, "degC", "documented range of ArduPilot", _WARM),
    _limit(r"INS\d?_ACC\d?_CALTEMP|INS\d?_GYR\d?_CALTEMP", -300.0, 150.0, "degC", "-300 means unknown", _WARM),
    _limit(r"COMPASS_DIA\d?_[XYZ]", 0.2, 5.0, "", "range of ArduPilot's own calibration", _MAGNET),
    _limit(r"COMPASS_ODI\d?_[XYZ]", -1.0, 1.0, "", "range of ArduPilot's own calibration", _MAGNET),
    _limit(r"AHRS_TRIM_[XY]", -0.1745329, 0.1745329, "rad", "10 deg, ArduPilot's limit", "mount the board level"),
    # PX4 states no limit; the zero-g output of the worst part in use is 0.15 g per axis, and 3.5 is ArduPilot's.
    _limit(r"CAL_ACC\d_[XYZ]OFF", -3.5, 3.5, "m/s2", "3.5 m/s2, as on ArduPilot", _POSES),
    _limit(r"CAL_(ACC|MAG)\d_[XYZ]SCALE", 0.1, 3.0, "", "documented range of PX4", _POSES),
    _limit(r"CAL_GYRO\d_[XYZ]OFF", -0.35, 0.35, "rad/s", "20 deg/s", _STILL),
    _limit(r"CAL_MAG\d_[XYZ]OFF", -1.8, 1.8, "gauss", "1.8 gauss, as on ArduPilot", _MAGNET),
    _limit(r"CAL_MAG\d_[XYZ]ODIAG", -1.0, 1.0, "", "1, as on ArduPilot", _MAGNET),
    _limit(r"SENS_BOARD_[XYZ]_OFF", -45.0, 45.0, "deg", "documented range of PX4", "mount the board level"),
    _limit(r"TC_[AG]\d_TREF|TC_[AG]\d_T(MIN|MAX)", -70.0, 150.0, "degC", "range of the sensors", _WARM),
    _limit(r"TC_A\d_X0_[012]", -3.5, 3.5, "m/s2", "3.5 m/s2, as CAL_ACC", _POSES),
    _limit(r"TC_G\d_X0_[012]", -0.35, 0.35, "rad/s", "20 deg/s", _STILL),
)

COMPASS_SCALE_WINDOW: Final = (1.0 / 1.5, 1.5)
"""ArduPilot uses COMPASS_SCALE, and accepts a field strength, inside this factor only (AP_Compass.cpp)."""
COMPASS_OFFS_MAX: Final = 1800.0
"""Default of COMPASS_OFFS_MAX, mGauss; length of the offset vector at which arming is refused."""
COMPASS_OFFSET_MAX_UT: Final = 0.1 * COMPASS_OFFS_MAX
"""The same in uT: a compass with a larger offset has a magnet beside it, whatever firmware it serves."""
TRIM_MAX_RAD: Final = 0.17453292519943295
"""Largest level trim that ArduPilot measures itself (10 deg); beyond it the board is not mounted level."""
THERMAL_SPAN_MIN: Final = 10.0
"""Smallest range of temperature over which a polynomial is stored, degC (ArduPilot's own learning asks the same)."""
THERMAL_DEGREE: Final = 3
"""Degree of the polynomial that both firmwares store."""


def limit_of(name: str) -> ParameterLimit | None:
    """The limit that `name` is held to; None: a flag, an id, or a coefficient without a range of its own."""
    return next((limit for limit in LIMITS if limit.pattern.fullmatch(name)), None)
