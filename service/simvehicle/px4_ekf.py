"""What PX4's estimator takes away from HIGHRES_IMU: running biases that hide what a calibration looks for."""

from __future__ import annotations

import math

import numpy as np

from mavcal.service.simvehicle.rotation import Array

TIME_CONSTANT_S = 8.0  # how fast a bias estimate follows the true error
WANDER_S = 30.0
ACCEL_WANDER = 0.05  # m/s²: rms of the estimate's own wandering at rest (0.02 … 0.16 seen)
GYRO_WANDER = 2.0e-4  # rad/s
MAG_WANDER = 0.002  # Gauss
ACCEL_LIMIT = 0.4  # m/s², EKF2_ABL_LIM


class BiasEstimate:
    """One vector bias: follows the error of the corrected sensor, and wanders."""

    def __init__(self, wander: float, limit: float, rng: np.random.Generator) -> None:
        self._wander_sd, self._limit, self._rng = wander, limit, rng
        self._estimate = np.zeros(3)
        self._wander = np.zeros(3)
        self._time = 0.0

    def advance(self, until: float, error: Array) -> Array:
        """The estimate at a time, given the present error of the corrected sensor (3,)."""
        dt = until - self._time
        if dt > 0:
            self._time = until
            follow = 1.0 - math.exp(-dt / TIME_CONSTANT_S)
            self._estimate = self._estimate + follow * (error - self._estimate)
            keep = math.exp(-dt / WANDER_S)
            self._wander = keep * self._wander
            self._wander = self._wander + self._rng.normal(0, self._wander_sd * math.sqrt(1 - keep * keep), 3)
        return np.clip(self._estimate + self._wander, -self._limit, self._limit)


class Estimator:
    """The three biases that HIGHRES_IMU is reduced by."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([seed, 3])
        self.accel = BiasEstimate(ACCEL_WANDER, ACCEL_LIMIT, rng)
        self.gyro = BiasEstimate(GYRO_WANDER, 1.0, rng)
        self.mag = BiasEstimate(MAG_WANDER, 1.0, rng)
