"""Doubts that an ArduPilot's parameters alone raise: corrupt values, and inertial units that learn their drift.

A unit with ``INS_TCALn_ENABLE`` 2 records a warm-up from its next start, and writes ``INS_TCALn_*`` when warm. Until
then its drift is not corrected (``AP_InertialSensor_tempcal.cpp``).
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

import numpy as np

from mavcal.calib.firmware.names import ARDUPILOT_IMU_SLOTS, ARDUPILOT_PREFIXES, Role, ardupilot_imu_names
from mavcal.calib.recording import Sensor

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mavcal.calib.firmware.plan import Value

LEARNING: Final = 2
"""Value of ``INS_TCALn_ENABLE``."""
MOTOR_MOST_MGAUSS: Final = 1000.0
"""Documented range of COMPASS_MOT, mGauss per A or per full throttle (AP ``AP_Compass.cpp``)."""

_MOTOR: Final = re.compile(r"COMPASS_P?MOT\d?_[XYZ]")


def learning_units(parameters: Mapping[str, Value]) -> dict[int, str]:
    """Inertial units that learn their temperature calibration, with the name of the parameter, by instance."""
    names = {slot: ardupilot_imu_names(Sensor.GYRO, slot)[Role.THERMAL_ENABLE] for slot in range(ARDUPILOT_IMU_SLOTS)}
    return {slot: name for slot, name in names.items() if parameters.get(name) == LEARNING}


def learning_warnings(parameters: Mapping[str, Value]) -> list[str]:
    """One sentence for each unit that learns."""
    return [
        f"{name} is 2: inertial unit {slot + 1} learns its temperature calibration from the next start on. Until it is "
        "done its drift is not corrected, and it overwrites its parameters then: let it finish, or set it to 0"
        for slot, name in learning_units(parameters).items()
    ]


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
