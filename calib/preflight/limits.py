"""Limits of the checks, each with its source (the firmwares' own: FLIGHT_CONTROLLERS 4.3, 4.4).

They are tighter than the firmwares' limits of arming: a vehicle that just arms does not yet fly well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Limit:
    """The most that a value of this check may be, and why."""

    of: str
    value: float
    unit: str
    source: str


GYRO_REST: Final = Limit(
    "gyro_rest", 0.5, "deg/s", "initial zero-rate tolerance of present parts (ICM-42688-P datasheet)"
)
GYRO_NOISE: Final = Limit("gyro_noise", 0.5, "deg/s", "ten times 0.005 deg/s/√Hz (MPU-6000 datasheet) over 100 Hz")
ACCEL_FORCE: Final = Limit(
    "accel_force",
    0.15,
    "m/s2",
    "a tilt of 0.9 deg; the firmwares refuse at 0.75 (ArduPilot, ARMING_ACCTHRESH) and 0.7 (PX4, COM_ARM_IMU_ACC)",
)
COMPASS_FIELD: Final = Limit(
    "compass_field", 10.0, "uT", "ArduPilot's ARMING_MAGTHRESH, 100 mG against the magnetic model"
)
COMPASS_ANGLE: Final = Limit(
    "compass_direction", 10.0, "deg", "a sixth of COM_ARM_MAG_ANG (60 deg): position hold circles beyond some 10 deg"
)
ATTITUDE: Final = Limit("attitude", 1.0, "deg", "the accelerometers' own limit, 0.15 m/s2, is a tilt of 0.9 deg")
TEMPERATURE_SPAN: Final = Limit(
    "temperature",
    20.0,
    "degC",
    "drift of 0.01 m/s2/degC takes up the accelerometer's limit; for one calibration temperature",
)
CALIBRATION_AGE: Final = Limit(
    "calibration_age", 365.0, "d", "long-term drift of consumer parts is stated per year; our choice"
)
MOTOR_SHARE: Final = Limit(
    "motor_compensation", 0.6, "", "ArduPilot's compassmot: interference above 60 % of the field is too much"
)
VIBRATION: Final = Limit(
    "vibration", 2.5, "m/s2", "ArduPilot's INS_STILL_THRESH of copters: more is not standing still"
)
CLIPPING: Final = Limit(
    "vibration, clips", 100.0, "", "ArduPilot's documentation of vibration: more than 100 clips are a problem"
)

ALL: Final = tuple(limit for limit in vars().values() if isinstance(limit, Limit))
"""A check that has no limit here judges no number."""

# What limits a number besides the noise of the capture: one standard deviation each.
EARTH_RATE_DEG_S: Final = 15.041 / 3600.0
ACCEL_SD: Final = 0.02  # m/s2: how units are glued to a board (0.1 deg), and local gravity
SURROUNDINGS_SD: Final = 0.5  # uT: iron of an ordinary place outdoors
TILT_SD: Final = math.radians(0.3)  # of the vertical that the accelerometers show
TEMPERATURE_SD: Final = 0.5  # degC: how a driver reads the chip
DECLINATION_SD_DEG: Final = 1.0  # of the model, and of a compass rose
STRONGEST_FIELD, WEAKEST_FIELD = 67.0, 22.0
"""Strength of the Earth's field at the ground, uT, where the place is not known."""
MOVING_RATE_DEG_S: Final = 0.5
MOVING_FORCE: Final = 0.15
"""Change of the half-second mean, m/s2, common to all units, above which the vehicle is not at rest."""
FULL_CURRENT_A: Final = 30.0
"""Current at which a compensation per ampere is compared with the field: a small copter's climb."""
