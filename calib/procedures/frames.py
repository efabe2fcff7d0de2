"""From a raw sensor's frame to the vehicle's body, as the parameters in force say."""

from __future__ import annotations

import numpy as np

from mavcal.calib import firmware
from mavcal.calib.errors import FirmwareError
from mavcal.calib.procedures.context import ProcedureContext
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import TriadModel


def in_force(context: ProcedureContext, sensor: Sensor, instance: int) -> TriadModel | None:
    """Correction in force, from raw sensor frame to corrected body frame; None: its parameters are missing.

    Without parameters, or of an unknown autopilot, raw and corrected are taken as the same.
    """
    if not _mounting_is_stated(context):
        return TriadModel()
    try:
        return firmware.calibration_in_force(context.identity.autopilot, context.parameters, sensor, instance)
    except FirmwareError:
        return None


def body_from_sensor(context: ProcedureContext, sensor: Sensor, instance: int) -> Array:
    """Rotation (3, 3) from the raw frame of a sensor to the body; the identity where parameters are missing."""
    if not _mounting_is_stated(context):
        return np.eye(3)
    try:
        return firmware.body_from_sensor(context.identity.autopilot, context.parameters, sensor, instance)
    except FirmwareError:
        return np.eye(3)


def _mounting_is_stated(context: ProcedureContext) -> bool:
    return not context.relative and context.identity.autopilot in firmware.TITLES
