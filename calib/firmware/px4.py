"""How PX4 corrects its sensors, and with which parameters (FLIGHT_CONTROLLERS 1.4)."""

from __future__ import annotations

from calib.firmware.names import PX4_PREFIXES as CALIBRATION_PREFIXES
from calib.firmware.slots import px4_calibration_names as calibration_names
from calib.firmware.slots import px4_sensor_ids as sensor_ids

__all__ = ["CALIBRATION_PREFIXES", "calibration_names", "sensor_ids"]
