"""What is wrong with the sensors of one vehicle, drawn from a seed, and the parameters that would put it right."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from mavcal.calib.firmware.names import (
    CROSS,
    OFFSET,
    SCALE,
    THERMAL,
    Role,
    ardupilot_compass_names,
    ardupilot_imu_names,
    px4_names,
    px4_thermal_names,
)
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

ACCEL_OFFSET, ACCEL_SCALE = 0.45, 0.03
"""m/s2 and parts: largest error of an axis."""
GYRO_OFFSET = 0.03
"""rad/s; PX4 applies no change below 0.01 while it runs."""
MAG_OFFSET, MAG_DIAGONAL, MAG_CROSS = 15.0, 0.08, 0.045
"""uT and parts."""
MAG_NOISE_UT = 0.1
DRIFT_ACCEL = (5e-3, 4e-5, 8e-7)
DRIFT_GYRO = (4e-4, 3e-6, 4e-8)
"""SI units per degC to the power of 1, 2, 3."""
MGAUSS, GAUSS = 0.1, 100.0
"""uT."""
_ROLLED = {"level": (0.0, 0.0, 0.0), "left": (-90.0, 0.0, 0.0), "right": (90.0, 0.0, 0.0), "back": (180.0, 0.0, 0.0)}
FACES = {**_ROLLED, "nose_down": (0.0, -90.0, 0.0), "nose_up": (0.0, 90.0, 0.0)}
"""Roll, pitch and yaw (deg) in which a vehicle lies on each of its faces."""


@dataclass(frozen=True)
class InertialTruth:
    """Accelerometer and gyroscope of one unit: measured = scale * true + offset + drift(T - middle)."""

    accel_offset: Array
    accel_scale: Array
    gyro_offset: Array
    accel_drift: Array
    """(3, 3): order 1 to 3 by axis."""
    gyro_drift: Array


@dataclass(frozen=True)
class CompassTruth:
    """One compass: corrected = matrix @ (measured + added), in uT."""

    added: Array
    matrix: Array


@dataclass(frozen=True)
class VehicleTruth:
    """All sensors of one vehicle."""

    seed: int
    units: tuple[InertialTruth, ...]
    compasses: tuple[CompassTruth, ...]

    def parameters(self, autopilot: str) -> dict[str, float]:
        """True value of every parameter of offsets, scales and cross terms, by name."""
        found: dict[str, float] = {}
        for i, unit in enumerate(self.units):
            accel, gyro = names_of(autopilot, Sensor.ACCEL, i), names_of(autopilot, Sensor.GYRO, i)
            found |= _entries(accel, OFFSET, unit.accel_offset)
            found |= _entries(accel, SCALE, 1.0 / unit.accel_scale)
            found |= _entries(gyro, OFFSET, unit.gyro_offset)
        for i, compass in enumerate(self.compasses):
            names = names_of(autopilot, Sensor.MAG, i)
            offset = compass.added / MGAUSS if autopilot == "ardupilot" else -compass.added / GAUSS
            found |= _entries(names, OFFSET, offset)
            found |= _entries(names, SCALE, np.diag(compass.matrix))
            found |= _entries(names, CROSS, compass.matrix[(0, 0, 1), (1, 2, 2)])
        return found


def drawn(seed: int, units: int, compasses: int) -> VehicleTruth:
    """A vehicle with so many inertial units and compasses."""
    rng = np.random.default_rng([38, seed])
    return VehicleTruth(seed, tuple(_unit(rng) for _ in range(units)), tuple(_compass(rng) for _ in range(compasses)))


def names_of(autopilot: str, sensor: Sensor, slot: int) -> Mapping[Role, str]:
    """Names of the parameters of a slot."""
    if autopilot == "px4":
        return px4_names(sensor, slot)
    return ardupilot_compass_names(slot, slot) if sensor == Sensor.MAG else ardupilot_imu_names(sensor, slot)


def thermal_names(autopilot: str, sensor: Sensor, slot: int) -> tuple[tuple[str, ...], ...]:
    """Names of the coefficients of order 1 to 3, by axis."""
    names = px4_thermal_names(sensor, slot) if autopilot == "px4" else ardupilot_imu_names(sensor, slot)
    return tuple(tuple(names[role] for role in order) for order in THERMAL[1:])


def own_temperatures(autopilot: str, truth: VehicleTruth) -> tuple[str, ...]:
    """Names of the temperatures at which offsets were taken; PX4 has none."""
    sensors = (Sensor.ACCEL, Sensor.GYRO)
    rows = [names_of(autopilot, sensor, i) for i in range(len(truth.units)) for sensor in sensors]
    return tuple(row[Role.TEMPERATURE] for row in rows if Role.TEMPERATURE in row)


def thermal_truth(autopilot: str, truth: VehicleTruth, planned: Mapping[str, float]) -> dict[str, float]:
    """True coefficients about the temperatures of a plan, and the offsets that go with them.

    Where a cubic term is left out, since PX4 does not save one so small, the others carry its share: no truth is known.
    """
    factor, middle = (1e6, 35.0) if autopilot == "ardupilot" else (1.0, 25.0)
    found: dict[str, float] = {}
    for i, unit in enumerate(truth.units):
        for sensor, drift in ((Sensor.ACCEL, unit.accel_drift), (Sensor.GYRO, unit.gyro_drift)):
            names, own = thermal_names(autopilot, sensor, i), names_of(autopilot, sensor, i)
            offset = unit.accel_offset if sensor == Sensor.ACCEL else unit.gyro_offset
            reference = planned.get(names[0][0][:5] + "_TREF", middle)
            at = planned.get(own.get(Role.TEMPERATURE, ""), reference)
            for axis in range(3):
                drifted = Polynomial([0.0, *drift[:, axis]])
                curve = drifted(Polynomial([reference - middle, 1.0]))
                if names[2][axis] in planned:
                    found |= {names[k][axis]: factor * float(curve.coef[k + 1]) for k in range(3)}
                if sensor == Sensor.GYRO or autopilot == "ardupilot":
                    found[own[OFFSET[axis]]] = float(offset[axis]) + float(drifted(at - middle))
    return found


def _entries(names: Mapping[Role, str], roles: tuple[Role, Role, Role], values: Array) -> dict[str, float]:
    return {names[role]: float(value) for role, value in zip(roles, values, strict=True)}


def _unit(rng: np.random.Generator) -> InertialTruth:
    return InertialTruth(
        _signed(rng, ACCEL_OFFSET),
        1.0 + rng.uniform(-ACCEL_SCALE, ACCEL_SCALE, 3),
        _signed(rng, GYRO_OFFSET),
        np.array([rng.uniform(-k, k, 3) for k in DRIFT_ACCEL]),
        np.array([rng.uniform(-k, k, 3) for k in DRIFT_GYRO]),
    )


def _signed(rng: np.random.Generator, largest: float) -> Array:
    """Between half of the largest and the largest, either way."""
    return np.asarray(rng.choice([-1.0, 1.0], 3) * rng.uniform(0.5 * largest, largest, 3))


def _compass(rng: np.random.Generator) -> CompassTruth:
    matrix = np.diag(1.0 + rng.uniform(-MAG_DIAGONAL, MAG_DIAGONAL, 3))
    for row, column in ((0, 1), (0, 2), (1, 2)):
        matrix[row, column] = matrix[column, row] = rng.uniform(-MAG_CROSS, MAG_CROSS)
    return CompassTruth(_signed(rng, MAG_OFFSET), matrix)
