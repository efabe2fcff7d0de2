"""Typical sensors: random errors of the size of ordinary MEMS parts before calibration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.simulate.recording import SensorSuite
from mavcal.calib.simulate.sensor import SensorErrors

Array = NDArray[np.float64]

# Order of size from the data sheets of the ICM-20948 and the IST8310: offset, scale, cross-axis, noise density.
_ACCEL_BIAS, _ACCEL_SCALE, _ACCEL_CROSS, _ACCEL_NOISE = 0.25, 0.012, 0.005, 2.3e-3  # m/s2, 1, 1, m/s2/sqrt(Hz)
_GYRO_BIAS, _GYRO_SCALE, _GYRO_CROSS, _GYRO_NOISE = 0.015, 0.012, 0.005, 2.6e-4  # rad/s, 1, 1, rad/s/sqrt(Hz)
_MAG_BIAS, _MAG_IRON, _MAG_NOISE = 12.0, 0.05, 0.03  # uT, 1, uT/sqrt(Hz)
_ACCEL_DRIFT, _GYRO_DRIFT = (8e-3, 6e-5), (6e-4, 4e-6)  # unit per degC and degC^2


def typical(rng: np.random.Generator) -> SensorSuite:
    """A unit drawn by `rng`; its magnetometer's soft iron is symmetric, its drift about 25 degC."""
    accel = SensorErrors(
        bias=_ACCEL_BIAS * rng.normal(size=3),
        matrix=np.eye(3) + np.diag(_ACCEL_SCALE * rng.normal(size=3)) + _cross(_ACCEL_CROSS, rng),
        noise_density=np.full(3, _ACCEL_NOISE),
        temperature=rng.normal(size=(3, 2)) * _ACCEL_DRIFT,
    )
    gyro = SensorErrors(
        bias=_GYRO_BIAS * rng.normal(size=3),
        matrix=np.eye(3) + np.diag(_GYRO_SCALE * rng.normal(size=3)) + _cross(_GYRO_CROSS, rng),
        noise_density=np.full(3, _GYRO_NOISE),
        temperature=rng.normal(size=(3, 2)) * _GYRO_DRIFT,
    )
    iron = _MAG_IRON * rng.normal(size=(3, 3))
    mag = SensorErrors(
        bias=_MAG_BIAS * rng.normal(size=3),
        matrix=np.eye(3) + 0.5 * (iron + iron.T),
        noise_density=np.full(3, _MAG_NOISE),
    )
    return SensorSuite(accel, gyro, mag)


def _cross(size: float, rng: np.random.Generator) -> Array:
    draws = size * rng.normal(size=(3, 3))
    return np.asarray(draws - np.diag(np.diag(draws)), dtype=np.float64)
