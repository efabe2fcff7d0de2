"""Whose plan it is, and which parameters it rests on."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from calib.errors import FirmwareError
from calib.firmware import ardupilot, px4
from calib.firmware.names import CALIBRATION_PREFIXES
from calib.firmware.plan import Fingerprint, Value
from calib.recording import Identity, Sensor

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
"""Parameters beside the calibration itself that a plan reads before it decides."""


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


def calibration_snapshot(parameters: Mapping[str, Value]) -> dict[str, Value]:
    """The parameters that a plan rests on: everything that decides what a streamed number means, and the settings."""
    prefixes = tuple(p for group in CALIBRATION_PREFIXES.values() for p in group)
    return {name: value for name, value in parameters.items() if name.startswith(prefixes) or name in SETTINGS}
