"""Parts of a calibration that each autopilot stores, and those that it cannot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final


@dataclass(frozen=True)
class Storable:
    """What one autopilot keeps of a procedure's result."""

    writes: tuple[str, ...]
    """Parameters."""
    cannot_represent: tuple[str, ...]


_ROTATION = "the rotation of one accelerometer in the vehicle or against another (see the job level)"

ACCEL: Final[Mapping[str, Storable]] = MappingProxyType(
    {
        "ardupilot": Storable(
            writes=(
                "INS_ACCOFFS_*, INS_ACC2OFFS_*, INS_ACC3OFFS_*",
                "INS_ACCSCAL_* ...",
                "INS_ACCn_CALTEMP",
                "AHRS_TRIM_*",
            ),
            cannot_represent=("cross terms", _ROTATION),
        ),
        "px4": Storable(
            writes=("CAL_ACCn_XOFF ... _ZOFF", "CAL_ACCn_XSCALE ... _ZSCALE", "SENS_BOARD_X_OFF, _Y_OFF"),
            cannot_represent=(
                "cross terms",
                _ROTATION,
                "a change of the scale below 0.01 (norm of the three)",
                "a change of the offset below 0.01 m/s2, unless thermal compensation runs",
            ),
        ),
    }
)
"""Offsets and scales of accelerometers."""

GYRO: Final[Mapping[str, Storable]] = MappingProxyType(
    {
        "ardupilot": Storable(
            writes=("INS_GYROFFS_*, INS_GYR2OFFS_*, INS_GYR3OFFS_*", "INS_GYRn_CALTEMP"),
            cannot_represent=("gyro scale", "gyro misalignment", "offsets that survive a boot while INS_GYR_CAL = 1"),
        ),
        "px4": Storable(
            writes=("CAL_GYROn_XOFF, _YOFF, _ZOFF",),
            cannot_represent=("gyro scale", "gyro misalignment", "a change below 0.01 rad/s before the next boot"),
        ),
    }
)
"""Offsets of gyroscopes."""

MAG: Final[Mapping[str, Storable]] = MappingProxyType(
    {
        "ardupilot": Storable(
            writes=(
                "COMPASS_OFS_*, COMPASS_OFS2_*, COMPASS_OFS3_*",
                "COMPASS_DIA_*, COMPASS_ODI_* ...",
                "COMPASS_SCALE, COMPASS_SCALE2, COMPASS_SCALE3",
                "COMPASS_ORIENT, COMPASS_ORIENT2, COMPASS_ORIENT3 where the mounting is wrong, CUST_ROTn_* by angles",
            ),
            cannot_represent=(
                "a misalignment of the compass below 5 deg",
                "a common scale outside 1/1.5 ... 1.5",
                "a drift with temperature",
            ),
        ),
        "px4": Storable(
            writes=(
                "CAL_MAGn_XOFF ... _ZOFF",
                "CAL_MAGn_XSCALE ... _ZSCALE, _XODIAG ... _ZODIAG",
                "CAL_MAGn_ROT where the mounting is wrong, _ROLL, _PITCH, _YAW by angles",
            ),
            cannot_represent=(
                "a misalignment of the compass below 5 deg",
                "a change of the offset below 0.5 uT (norm of the three)",
                "a change of the scales or of the cross terms below 0.01 (norm of the three)",
                "a drift with temperature",
            ),
        ),
    }
)
"""Hard and soft iron of magnetometers, and their mounting."""

LEVEL: Final[Mapping[str, Storable]] = MappingProxyType(
    {
        "ardupilot": Storable(
            writes=("AHRS_TRIM_X, AHRS_TRIM_Y",),
            cannot_represent=("a trim beyond 10 deg", "different trims of several units", "the yaw of the board"),
        ),
        "px4": Storable(
            writes=("SENS_BOARD_X_OFF, SENS_BOARD_Y_OFF",),
            cannot_represent=("different trims of several units", "the yaw of the board"),
        ),
    }
)
"""Roll and pitch of the board in the vehicle."""

DRIFT: Final[Mapping[str, Storable]] = MappingProxyType(
    {
        "ardupilot": Storable(
            writes=(
                "INS_TCALn_ENABLE, _TMIN, _TMAX",
                "INS_TCALn_ACC1..3_*, _GYR1..3_*",
                "INS_ACC*OFFS_*, INS_GYR*OFFS_*",
            ),
            cannot_represent=("a scale that varies with temperature", "more than three orders", "hysteresis"),
        ),
        "px4": Storable(
            writes=("TC_An_*, TC_Gn_* (X0..X3, TMIN, TMAX, TREF, ID)", "TC_A_ENABLE, TC_G_ENABLE"),
            cannot_represent=("a scale that varies with temperature", "more than three orders", "hysteresis"),
        ),
    }
)
"""Drift of accelerometers and gyroscopes with temperature."""

ACCEL_OFFSETS: Final[Mapping[str, Storable]] = MappingProxyType(
    {
        "ardupilot": Storable(
            writes=("INS_ACCOFFS_*, INS_ACC2OFFS_*, INS_ACC3OFFS_*", "INS_ACCn_CALTEMP", "AHRS_TRIM_*"),
            cannot_represent=("nothing of it: scale and cross terms are not measured",),
        ),
        "px4": Storable(
            writes=("CAL_ACCn_XOFF ... _ZOFF", "SENS_BOARD_X_OFF, _Y_OFF"),
            cannot_represent=("a change of the offset below 0.01 m/s2, unless thermal compensation runs",),
        ),
    }
)
"""Offsets of accelerometers alone, from one axis vertical."""

INERTIAL: Final[Mapping[str, Storable]] = MappingProxyType(
    {
        "ardupilot": Storable(
            writes=(
                "INS_ACCOFFS_*, INS_ACC2OFFS_*, INS_ACC3OFFS_*",
                "INS_ACCSCAL_* ...",
                "INS_GYROFFS_*, INS_GYR2OFFS_*, INS_GYR3OFFS_*",
                "INS_ACCn_CALTEMP, INS_GYRn_CALTEMP",
                "AHRS_TRIM_*",
            ),
            cannot_represent=("cross terms", "gyro scale", "gyro misalignment"),
        ),
        "px4": Storable(
            writes=(
                "CAL_ACCn_XOFF ... _ZOFF",
                "CAL_ACCn_XSCALE ... _ZSCALE",
                "CAL_GYROn_XOFF, _YOFF, _ZOFF",
                "SENS_BOARD_X_OFF, _Y_OFF",
            ),
            cannot_represent=(
                "cross terms",
                "gyro scale",
                "gyro misalignment",
                "a change of the accelerometer's scale or offset below 0.01, or of the gyro's offset below 0.01 rad/s",
            ),
        ),
    }
)
"""Accelerometers and gyroscopes together."""
