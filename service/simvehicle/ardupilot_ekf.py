"""The accelerometer bias that ArduPilot's estimator has learnt.

On the ground EKF3 learns the bias of an axis only while that axis is within 37 deg of the vertical
(``NavEKF3_core::CovariancePrediction``: ``fabsF(prevTnb[index][2]) > 0.8``, else the state is held); at boot it knows
none. A new INS_ACCOFFS leaves what it learned: the attitude is then wrong by that much. It stays so at rest (2.2 deg
for 34 s, unchanged within 0.01 deg) until the axis stands upright again or the vehicle is restarted.
"""

from __future__ import annotations

import math

import numpy as np

from mavcal.service.simvehicle.ardupilot_sensors import ArduPilotSensors
from mavcal.service.simvehicle.rotation import Array, body_from_ned

STEP_S = 0.1  # vehicle time between two looks at the accelerometer
TIME_CONSTANT_S = 8.0  # a third of 0.38 m/s² was left after 8 s upright, as captured
UPRIGHT = 0.8  # |cosine| between an axis and the vertical from which its bias is learned
LIMIT = 1.0  # m/s², EK3_ACC_BIAS_LIM


class TiltEstimate:
    """Accelerometer bias (3,), body frame, m/s², that the estimator subtracts."""

    def __init__(self, sensors: ArduPilotSensors) -> None:
        self._sensors = sensors
        self.boot()

    def boot(self) -> None:
        """Reset to zero bias: after a restart the attitude is the accelerometer's."""
        self.bias = np.zeros(3)
        self._time = 0.0

    def advance(self, until: float, *, flying: bool) -> None:
        """Update the bias from the primary accelerometer up to a vehicle time; in flight on every axis."""
        dt = until - self._time
        if dt < STEP_S:
            return
        self._time = until
        state = self._sensors.world.state(np.array([until]))
        read = self._sensors.imu(self._sensors.primary, state, noise_scale=0.0).accel[0]
        error = read - state.force[0]
        if not np.isfinite(read).all() or not read.any():
            return  # a dead sensor teaches nothing
        down = body_from_ned(state.q, np.array([0.0, 0.0, 1.0]))[0]
        learned = np.ones(3, dtype=bool) if flying else np.abs(down) > UPRIGHT
        follow = 1.0 - math.exp(-dt / TIME_CONSTANT_S)
        self.bias = np.clip(self.bias + follow * learned * (error - self.bias), -LIMIT, LIMIT)

    def unbiased(self, force: Array) -> Array:
        """Corrected accelerations (N, 3) minus the bias."""
        return np.asarray(force - self.bias)
