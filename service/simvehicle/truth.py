"""The true errors of every sensor: raw = M·true + b + p(T) + noise, drawn from a seed or given.

Ranges are those of ordinary MEMS parts before calibration. They are wide enough that every parameter that a firmware
can store changes its stream by many standard deviations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavcal.service.simvehicle.config import VehicleConfig
from mavcal.service.simvehicle.errors import ConfigurationError
from mavcal.service.simvehicle.rotation import Array

T_REF = 35.0  # °C, where every polynomial is zero

ACCEL_OFFSET = (0.1, 0.4)  # m/s² per axis, random sign
ACCEL_SCALE = (0.008, 0.025)  # departure of the diagonal from 1
CROSS_SD = 0.003  # off-diagonals of accelerometer and gyroscope
GYRO_OFFSET = (5e-3, 30e-3)  # rad/s
GYRO_SCALE_SD = 0.004
MAG_OFFSET = (3.0, 12.0)  # µT
MAG_SCALE = (0.03, 0.08)
MAG_CROSS = (0.01, 0.03)
ACCEL_POLYNOMIAL = ((4e-3, 9e-3), (3e-5, 8e-5), (0.8e-6, 2e-6))  # m/s² per °C, °C², °C³
GYRO_POLYNOMIAL = ((5e-4, 9e-4), (2e-6, 6e-6), (0.5e-7, 1.5e-7))  # rad/s per °C, …


@dataclass(frozen=True)
class SensorTruth:
    """One three-axis sensor in its own frame.

    Attributes:
        offset: b, shape (3,).
        matrix: M, shape (3, 3).
        polynomial: coefficients of (T − 35 °C), its square and its cube for each axis, shape (3, 3): [axis][order].
        noise: sd of one output sample.
        motor: change of the reading per ampere, shape (3,): magnetometers only.
    """

    offset: Array
    matrix: Array
    polynomial: Array
    noise: float
    motor: Array

    def thermal(self, temperature: Array) -> Array:
        """p(T) at temperatures (N,), shape (N, 3)."""
        d = (temperature - T_REF)[:, None]
        c = self.polynomial
        return np.asarray(d * (c[:, 0] + d * (c[:, 1] + d * c[:, 2])))

    def distort(self, true: Array, temperature: Array | None = None) -> Array:
        """M·true + b + p(T) of true values (N, 3) in the sensor's frame, without noise."""
        raw = true @ self.matrix.T + self.offset
        return raw if temperature is None else raw + self.thermal(temperature)

    def as_dict(self) -> dict[str, Any]:
        """Plain lists and numbers, units as above."""
        return {
            "offset": self.offset.tolist(),
            "matrix": self.matrix.tolist(),
            "polynomial": self.polynomial.tolist(),
            "noise": self.noise,
            "motor": self.motor.tolist(),
        }


@dataclass(frozen=True)
class VehicleTruth:
    """The truth of all sensors, by instance."""

    accels: tuple[SensorTruth, ...]
    gyros: tuple[SensorTruth, ...]
    mags: tuple[SensorTruth, ...]


def draw_truth(config: VehicleConfig) -> VehicleTruth:
    """The truth of a configuration: drawn from its seed, then overridden by its `truth` entries.

    Raises ConfigurationError if an override names an unknown sensor or quantity, or has the wrong shape.
    """
    rng = np.random.default_rng([config.seed, 0])
    accels, gyros = [], []
    for _ in range(config.imu_count):
        accels.append(_inertial(rng, ACCEL_OFFSET, ACCEL_SCALE, ACCEL_POLYNOMIAL, config.accel_noise, config.thermal))
        gyros.append(_inertial(rng, GYRO_OFFSET, None, GYRO_POLYNOMIAL, config.gyro_noise, config.thermal))
    mags = [_magnetic(rng, config.mag_noise) for _ in range(config.mag_count)]
    groups = {"accels": accels, "gyros": gyros, "mags": mags}
    for kind, override in config.truth.items():
        if kind not in groups:
            raise ConfigurationError(f"truth: unknown kind {kind!r}; known: {', '.join(groups)}")
        groups[kind][:] = _overridden(kind, groups[kind], override)
    return VehicleTruth(tuple(accels), tuple(gyros), tuple(mags))


def _signed(rng: np.random.Generator, bounds: tuple[float, float]) -> Array:
    return np.asarray(rng.uniform(*bounds, size=3) * rng.choice([-1.0, 1.0], size=3))


def _inertial(
    rng: np.random.Generator,
    offset: tuple[float, float],
    scale: tuple[float, float] | None,
    polynomial: tuple[tuple[float, float], ...],
    noise: float,
    thermal: bool,
) -> SensorTruth:
    b = _signed(rng, offset)
    diagonal = 1.0 + (_signed(rng, scale) if scale else rng.normal(0, GYRO_SCALE_SD, 3))
    matrix = rng.normal(0, CROSS_SD, (3, 3))
    np.fill_diagonal(matrix, diagonal)
    p = np.stack([_signed(rng, bounds) for bounds in polynomial], axis=1)
    p[:, 0] = np.copysign(p[:, 0], -b)  # a cold sensor is farther off, never by chance right
    p[:, 2] = np.copysign(p[:, 2], p[:, 1])  # opposite signs could cancel over the whole range and hide each other
    return SensorTruth(b, matrix, p if thermal else np.zeros((3, 3)), noise, np.zeros(3))


def _magnetic(rng: np.random.Generator, noise: float) -> SensorTruth:
    # Drawn as the symmetric matrix that corrects: what both firmwares can store exactly.
    correction = np.diag(1.0 + _signed(rng, MAG_SCALE))
    for (i, j), value in zip(((0, 1), (0, 2), (1, 2)), _signed(rng, MAG_CROSS), strict=True):
        correction[i, j] = correction[j, i] = value
    offset = _signed(rng, MAG_OFFSET)
    motor = rng.normal(0, 0.3, 3)  # µT per A
    return SensorTruth(offset, np.linalg.inv(correction), np.zeros((3, 3)), noise, motor)


_SHAPES: dict[str, tuple[int, ...]] = {
    "offset": (3,),
    "matrix": (3, 3),
    "polynomial": (3, 3),
    "noise": (),
    "motor": (3,),
}


def _overridden(kind: str, sensors: list[SensorTruth], override: Any) -> list[SensorTruth]:
    """One override for all instances (a mapping), or one per instance (a list; null leaves the drawn one)."""
    per_instance = override if isinstance(override, list) else [override] * len(sensors)
    if len(per_instance) > len(sensors):
        raise ConfigurationError(f"truth: {len(per_instance)} {kind} given, the vehicle has {len(sensors)}")
    result = list(sensors)
    for i, entry in enumerate(per_instance):
        if entry is not None:
            result[i] = _merged(kind, sensors[i], entry)
    return result


def _merged(kind: str, sensor: SensorTruth, entry: Any) -> SensorTruth:
    if not isinstance(entry, Mapping) or set(entry) - set(_SHAPES):
        raise ConfigurationError(f"truth: an entry of {kind} is an object with {', '.join(_SHAPES)}, got {entry!r}")
    values: dict[str, Any] = dict(vars(sensor))
    for name, value in entry.items():
        array = np.asarray(value, dtype=np.float64)
        if array.shape != _SHAPES[name] or not np.isfinite(array).all():
            raise ConfigurationError(f"truth: {kind} {name} must be finite numbers of shape {_SHAPES[name]}")
        values[name] = float(array) if name == "noise" else array
    return SensorTruth(**values)
