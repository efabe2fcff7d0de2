"""From a raw sensor's frame to the vehicle's body, as the parameters in force say."""

from __future__ import annotations

import numpy as np

from calib.errors import FirmwareError
from calib.firmware import ardupilot, px4
from calib.procedures.context import ProcedureContext
from calib.recording import Array, Sensor
from calib.triad import TriadModel


def in_force(context: ProcedureContext, sensor: Sensor, instance: int) -> TriadModel | None:
    """The correction that the vehicle applies: raw to corrected body frame. None: the parameters do not say.

    Without parameters, or of an unknown autopilot, raw and corrected are taken as the same.
    """
    if context.relative or context.identity.autopilot not in ("ardupilot", "px4"):
        return TriadModel()
    try:
        if context.identity.autopilot == "ardupilot":
            return ardupilot.calibration_in_force(context.parameters, sensor, instance)
        return px4.calibration_in_force(context.parameters, sensor, instance)
    except FirmwareError:
        return None


def body_from_sensor(context: ProcedureContext, sensor: Sensor, instance: int) -> Array:
    """Rotation (3, 3) from the raw frame of a sensor to the body; the identity where the parameters do not say."""
    model = in_force(context, sensor, instance)
    return np.eye(3) if model is None else model.rotation
