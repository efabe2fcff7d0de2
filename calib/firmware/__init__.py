"""Firmware knowledge: streams, parameters, undoing of corrections, write plans and proofs.

The knowledge of each firmware is in its own modules; functions defined here take the autopilot by name (``ardupilot``
or ``px4``, as in :class:`calib.recording.Identity`).
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType, ModuleType

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.names import Role
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import TriadModel

_MODULES = {"ardupilot": ardupilot, "px4": px4}
TITLES = MappingProxyType({"ardupilot": "ArduPilot", "px4": "PX4"})
"""Display names of the autopilots whose calibrations are known."""


def _of(autopilot: str | None) -> ModuleType:
    if autopilot not in _MODULES:
        raise FirmwareError(f"mavcal knows the calibrations of ArduPilot and PX4, not of autopilot {autopilot!r}")
    return _MODULES[autopilot]


def calibration_in_force(
    autopilot: str | None, parameters: Mapping[str, Value], sensor: Sensor, instance: int
) -> TriadModel:
    """The correction that the firmware applies: raw sensor frame to corrected body frame, SI and uT.

    On PX4 as after a boot with `parameters`; for values written since see
    :class:`calib.firmware.px4.parameters.Px4Calibration`.
    """
    model: TriadModel = _of(autopilot).calibration_in_force(parameters, sensor, instance)
    return model


def calibration_names(
    autopilot: str | None, parameters: Mapping[str, Value], sensor: Sensor, instance: int
) -> Mapping[Role, str]:
    """Names by role of the parameters that correct `sensor` `instance`."""
    names: Mapping[Role, str] = _of(autopilot).calibration_names(parameters, sensor, instance)
    return names


def sensor_ids(autopilot: str | None, parameters: Mapping[str, Value]) -> dict[tuple[Sensor, int], int]:
    """Device id of every sensor that the parameters know, by sensor and streamed instance."""
    ids: dict[tuple[Sensor, int], int] = _of(autopilot).sensor_ids(parameters)
    return ids


def body_from_sensor(
    autopilot: str | None, parameters: Mapping[str, Value], sensor: Sensor, instance: int
) -> NDArray[np.float64]:
    """``R_body_from_sensor``, shape (3, 3): undone samples are in the sensor's frame, poses are the body's."""
    turn: NDArray[np.float64] = _of(autopilot).mounting(parameters, sensor, instance)
    return turn


def turning_spoils(parameters: Mapping[str, Value]) -> str:
    """Warning if the vehicle may correct a steady turn as a gyro offset; empty: it does not.

    A change of offsets during a capture spoils it.
    """
    if parameters.get("IMU_GYRO_CAL_EN") != 1:
        return ""
    return (
        "PX4 estimates its gyro offsets by itself and takes a steady turn for one (IMU_GYRO_CAL_EN = 1); a capture in "
        "which it does so is refused: set it to 0 and restart the vehicle first"
    )
