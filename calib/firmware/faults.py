"""ArduPilot calibration parameters that are corrupt, or far out of range."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

import numpy as np

from mavcal.calib.firmware.names import ARDUPILOT_PREFIXES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mavcal.calib.firmware.plan import Value

MOTOR_MOST_MGAUSS: Final = 1000.0
"""Documented range of COMPASS_MOT, mGauss per A or per full throttle (AP ``AP_Compass.cpp``)."""

_MOTOR: Final = re.compile(r"COMPASS_P?MOT\d?_[XYZ]")


def parameter_faults(parameters: Mapping[str, Value]) -> list[str]:
    """One sentence for each calibration parameter that is corrupt."""
    found = []
    for name, value in parameters.items():
        if not name.startswith(ARDUPILOT_PREFIXES):
            continue
        if not np.isfinite(value):
            found.append(f"{name} is {value}: it is corrupt, and so is every reading that it corrects")
        elif absurd_motor_gain(name, value):
            found.append(f"{name} is {value:g}, beyond its range of +-{MOTOR_MOST_MGAUSS:g}: it is corrupt")
    return found


def absurd_motor_gain(name: str, value: Value) -> bool:
    """Whether `value` of the motor compensation `name` is beyond its documented range."""
    return bool(_MOTOR.fullmatch(name)) and abs(float(value)) > MOTOR_MOST_MGAUSS
