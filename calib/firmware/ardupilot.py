"""How ArduPilot corrects its sensors, and with which parameters (FLIGHT_CONTROLLERS 1.1-1.3)."""

from __future__ import annotations

from calib.firmware.names import ARDUPILOT_PREFIXES as CALIBRATION_PREFIXES
from calib.firmware.slots import ardupilot_calibration_names as calibration_names
from calib.firmware.slots import ardupilot_sensor_ids as sensor_ids

__all__ = ["CALIBRATION_PREFIXES", "calibration_names", "sensor_ids"]
