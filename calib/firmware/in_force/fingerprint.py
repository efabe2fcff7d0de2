"""Identity of a vehicle and the parameters that a plan depends on."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from types import MappingProxyType
from typing import Final

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.names import (
    ARDUPILOT_IMU_SLOTS,
    CALIBRATION_PREFIXES,
    OFFSET,
    PX4_SLOTS,
    Role,
    ardupilot_imu_names,
    px4_names,
)
from mavcal.calib.firmware.plan import Fingerprint, Value
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.recording import Identity, Sensor

SENSOR_IDS: Final = MappingProxyType({"ardupilot": ardupilot.sensor_ids, "px4": px4.sensor_ids})

SETTINGS: Final = (
    "AHRS_TRIM_X",
    "AHRS_TRIM_Y",
    "INS_GYR_CAL",
    "COMPASS_LEARN",
    "COMPASS_OFFS_MAX",
    "SENS_IMU_AUTOCAL",
    "SENS_MAG_AUTOCAL",
    "IMU_GYRO_CAL_EN",
)
"""Parameters other than the calibration that a plan depends on."""


def fingerprint(identity: Identity, parameters: Mapping[str, Value]) -> Fingerprint:
    """Identity of the vehicle with the device ids of its sensors.

    Raises
    ------
    FirmwareError
        If the autopilot is neither ArduPilot nor PX4.
    """
    autopilot = identity.autopilot or "unknown"
    if autopilot not in SENSOR_IDS:
        raise FirmwareError(
            f"the autopilot is {autopilot}; calibrations can be written to ArduPilot and PX4. "
            "Export the result of the fit instead"
        )
    ids: Mapping[tuple[Sensor, int], int] = SENSOR_IDS[autopilot](parameters)
    return Fingerprint(
        autopilot,
        identity.uid or "",
        "" if identity.firmware is None else ".".join(map(str, identity.firmware)),
        tuple(sorted((f"{sensor}{instance}", value) for (sensor, instance), value in ids.items())),
    )


def _offsets(slots: Iterable[Mapping[Role, str]]) -> frozenset[str]:
    return frozenset(row[role] for row in slots for role in (*OFFSET, Role.TEMPERATURE) if role in row)


REWRITTEN_AT_REST: Final = _offsets(px4_names(Sensor.GYRO, slot) for slot in range(PX4_SLOTS))
"""Gyro offsets that a vehicle may rewrite at any time while it is still."""
REWRITTEN: Final = REWRITTEN_AT_REST | _offsets(
    ardupilot_imu_names(Sensor.GYRO, slot) for slot in range(ARDUPILOT_IMU_SLOTS)
)
"""Gyro offsets and their temperatures, which a vehicle rewrites by itself (FLIGHT_CONTROLLERS 1.3, 1.4).

ArduPilot does so at every start (INS_GYR_CAL = 1), PX4 at rest (IMU_GYRO_CAL_EN = 1).
"""
CLAIMED_AT_REST: Final = frozenset(
    px4_names(Sensor.GYRO, slot)[role] for slot in range(PX4_SLOTS) for role in (Role.ID, Role.PRIORITY, Role.ROTATION)
)
"""What PX4's gyro_calibration writes beside the offsets: it claims a row for a gyro that has none, and fills it.

``Gyroscope::ParametersSave`` (PX4 src/lib/sensor_calibration/Gyroscope.cpp) stores id, priority, offsets and rotation
together. So an uninitialised priority (-1) becomes the default (50) with the first save.
"""
PX4_PRIORITY: Final = re.compile(r"CAL_(ACC|GYRO|MAG|BARO)\d_PRIO")
BY_ITSELF: Final = REWRITTEN | CLAIMED_AT_REST
"""Parameters that a vehicle changes by itself; after such a change the capture may begin again."""


def matters(name: str, sensors: Collection[Sensor]) -> bool:
    """Whether a result for `sensors` depends on this calibration parameter keeping its value.

    A gyro that is not calibrated itself only tells rest from motion, so its offsets may change meanwhile.
    """
    return Sensor.GYRO in sensors or name not in REWRITTEN


def means_the_same(name: str, before: Value, after: Value) -> bool:
    """Whether two values of a parameter have the same effect: PX4's priority -1 means the default.

    That is 50, and 75 for a sensor outside the board (``Gyroscope::ParametersLoad``); 0 would switch it off.
    """
    return bool(PX4_PRIORITY.fullmatch(name)) and {int(before), int(after)} in ({-1, 50}, {-1, 75})


def calibration_snapshot(parameters: Mapping[str, Value]) -> dict[str, Value]:
    """The parameters that decide how streamed numbers are corrected, and the settings."""
    prefixes = tuple(p for group in CALIBRATION_PREFIXES.values() for p in group)
    return {name: value for name, value in parameters.items() if name.startswith(prefixes) or name in SETTINGS}


def rests_on(parameters: Mapping[str, Value], sensors: Collection[Sensor]) -> dict[str, Value]:
    """The parameters that a plan for `sensors` rests on: if one of them changes, the plan is void."""
    return {name: v for name, v in calibration_snapshot(parameters).items() if matters(name, sensors)}
