"""Whether an ArduPilot is learning a temperature calibration of its own (``INS_TCALn_ENABLE`` 2).

From its next start on it records a warm-up and writes ``INS_TCALn_*`` when the unit is warm. Until then nothing
corrects the drift (``AP_InertialSensor_tempcal.cpp``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from mavcal.calib.firmware.names import ARDUPILOT_IMU_SLOTS, Role, ardupilot_imu_names
from mavcal.calib.recording import Sensor

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mavcal.calib.firmware.plan import Value

LEARNING: Final = 2
"""Value of ``INS_TCALn_ENABLE``."""


def learning_units(parameters: Mapping[str, Value]) -> dict[int, str]:
    """The inertial units that learn their temperature calibration, by instance, with the parameter that says so."""
    names = {slot: ardupilot_imu_names(Sensor.GYRO, slot)[Role.THERMAL_ENABLE] for slot in range(ARDUPILOT_IMU_SLOTS)}
    return {slot: name for slot, name in names.items() if parameters.get(name) == LEARNING}


def learning_warnings(parameters: Mapping[str, Value]) -> list[str]:
    """One sentence for each unit that learns."""
    return [
        f"{name} is 2: inertial unit {slot + 1} learns its temperature calibration from the next start on. Until it is "
        "done its drift is not corrected, and it overwrites its parameters then: let it finish, or set it to 0"
        for slot, name in learning_units(parameters).items()
    ]
