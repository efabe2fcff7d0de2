"""What each autopilot stores of a calibration, and what it cannot: one statement for every job that ends in it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from mavcal.calib.procedures.spec import Holds

_ROTATION = "the rotation of one accelerometer in the vehicle or against another (see the job level)"

ACCEL: Final[Mapping[str, Holds]] = MappingProxyType(
    {
        "ardupilot": Holds(
            writes=(
                "INS_ACCOFFS_*, INS_ACC2OFFS_*, INS_ACC3OFFS_*",
                "INS_ACCSCAL_* ...",
                "INS_ACCn_CALTEMP",
                "AHRS_TRIM_*",
            ),
            cannot_represent=("cross terms", _ROTATION),
        ),
        "px4": Holds(
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

GYRO: Final[Mapping[str, Holds]] = MappingProxyType(
    {
        "ardupilot": Holds(
            writes=("INS_GYROFFS_*, INS_GYR2OFFS_*, INS_GYR3OFFS_*", "INS_GYRn_CALTEMP"),
            cannot_represent=("gyro scale", "gyro misalignment", "offsets that survive a boot while INS_GYR_CAL = 1"),
        ),
        "px4": Holds(
            writes=("CAL_GYROn_XOFF, _YOFF, _ZOFF",),
            cannot_represent=("gyro scale", "gyro misalignment", "a change below 0.01 rad/s before the next boot"),
        ),
    }
)
"""Offsets of gyroscopes."""

MAG: Final[Mapping[str, Holds]] = MappingProxyType(
    {
        "ardupilot": Holds(
            writes=(
                "COMPASS_OFS_*, COMPASS_OFS2_*, COMPASS_OFS3_*",
                "COMPASS_DIA_*, COMPASS_ODI_* ...",
                "COMPASS_SCALE, COMPASS_SCALE2, COMPASS_SCALE3",
                "COMPASS_ORIENT, COMPASS_ORIENT2, COMPASS_ORIENT3 where the mounting is wrong",
            ),
            cannot_represent=(
                "a small misalignment of the compass",
                "a common scale outside 1/1.5 ... 1.5",
                "a drift with temperature",
            ),
        ),
        "px4": Holds(
            writes=(
                "CAL_MAGn_XOFF ... _ZOFF",
                "CAL_MAGn_XSCALE ... _ZSCALE, _XODIAG ... _ZODIAG",
                "CAL_MAGn_ROT where the mounting is wrong",
            ),
            cannot_represent=(
                "a small misalignment of the compass",
                "a change of the offset below 0.5 uT (norm of the three)",
                "a change of the scales or of the cross terms below 0.01 (norm of the three)",
                "a drift with temperature",
            ),
        ),
    }
)
"""Hard and soft iron of magnetometers, and their mounting."""
