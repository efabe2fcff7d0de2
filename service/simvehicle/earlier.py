"""Initial calibration of a vehicle: near the truth, with no parameter at its neutral value.

A vehicle with neutral parameters only would hide errors in undoing the calibration in force, and in judging changes of
it. Such a new vehicle is therefore the exception (``"calibration": "none"``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mavcal.service.simvehicle import ardupilot_parameters as ardupilot
from mavcal.service.simvehicle import px4_parameters as px4
from mavcal.service.simvehicle.config import Calibration, SimAutopilot, VehicleConfig
from mavcal.service.simvehicle.mounting import true_mounting
from mavcal.service.simvehicle.parameters import AXES
from mavcal.service.simvehicle.rotation import Array
from mavcal.service.simvehicle.truth import T_REF, SensorTruth, VehicleTruth

# Errors of the calibration: large enough for a new one to prove, and too small for the sensors to look broken.
ACCEL_OFFSET_AGED = (0.04, 0.1)  # m/s² an axis, either way
ACCEL_SCALE_AGED = (4e-3, 9e-3)
GYRO_OFFSET_AGED = (3e-3, 8e-3)  # rad/s
MAG_OFFSET_AGED = (2.0, 5.0)  # µT
MAG_MATRIX_AGED = (0.02, 0.04)
TRIM_DEG = (1.1, -0.8)  # roll, pitch of the board in the vehicle
COMPASS_SCALE = 1.02
MGAUSS_PER_UT, UT_PER_GAUSS = 10.0, 100.0


@dataclass(frozen=True)
class _Wear:
    """Share of the errors above in the calibration: 1 for an earlier one, 0 for a fresh one."""

    rng: np.random.Generator
    amount: float

    def aged(self, value: Array, bounds: tuple[float, float]) -> Array:
        """`value` with the error of an earlier calibration."""
        off = self.rng.uniform(*bounds, value.shape) * self.rng.choice([-1.0, 1.0], value.shape)
        return np.asarray(value + self.amount * off)


def earlier_calibration(config: VehicleConfig, truth: VehicleTruth) -> dict[str, float]:
    """Parameters by name: offsets, scales, cross terms and trim of every sensor."""
    wear = _Wear(np.random.default_rng([config.seed, 4]), 0.0 if config.calibration is Calibration.FRESH else 1.0)
    if config.autopilot is SimAutopilot.ARDUPILOT:
        return _ardupilot(config, truth, wear)
    return _px4(truth, wear)


def _ardupilot(config: VehicleConfig, truth: VehicleTruth, wear: _Wear) -> dict[str, float]:
    values = {"AHRS_TRIM_X": float(np.radians(TRIM_DEG[0])), "AHRS_TRIM_Y": float(np.radians(TRIM_DEG[1]))}
    for k, (accel, gyro) in enumerate(zip(truth.accels, truth.gyros, strict=True)):
        values |= _named(ardupilot.accel_offset_name(k), wear.aged(accel.offset, ACCEL_OFFSET_AGED))
        values |= _named(ardupilot.accel_scale_name(k), _scale(wear, accel))
        values |= _named(ardupilot.gyro_offset_name(k), wear.aged(gyro.offset, GYRO_OFFSET_AGED))
        values |= {ardupilot.caltemp_name(sensor, k): T_REF for sensor in ("ACC", "GYR")}
    for k, mag in enumerate(truth.mags):
        offset, matrix = _soft_iron(wear, mag)
        body = true_mounting(config, k)
        matrix = body @ matrix @ body.T
        values |= _named(ardupilot.compass_name("OFS", k), -MGAUSS_PER_UT * body @ offset)
        values |= _named(ardupilot.compass_name("DIA", k), np.diag(matrix))
        values |= _named(ardupilot.compass_name("ODI", k), matrix[[0, 0, 1], [1, 2, 2]])
        values[ardupilot.compass_name("SCALE", k)] = COMPASS_SCALE
    return values


def _px4(truth: VehicleTruth, wear: _Wear) -> dict[str, float]:
    values = {"SENS_BOARD_X_OFF": TRIM_DEG[0], "SENS_BOARD_Y_OFF": TRIM_DEG[1]}
    for k, (accel, gyro) in enumerate(zip(truth.accels, truth.gyros, strict=True)):
        values |= _slot(f"CAL_ACC{k}", "OFF", wear.aged(accel.offset, ACCEL_OFFSET_AGED))
        values |= _slot(f"CAL_ACC{k}", "SCALE", _scale(wear, accel))
        values |= _slot(f"CAL_GYRO{k}", "OFF", wear.aged(gyro.offset, GYRO_OFFSET_AGED))
    for k, mag in enumerate(truth.mags):
        offset, matrix = _soft_iron(wear, mag)
        values |= _slot(f"CAL_MAG{k}", "OFF", offset / UT_PER_GAUSS)
        values |= _slot(f"CAL_MAG{k}", "SCALE", np.diag(matrix))
        values |= _slot(f"CAL_MAG{k}", "ODIAG", matrix[[0, 0, 1], [1, 2, 2]])
    return values


def _scale(wear: _Wear, accel: SensorTruth) -> Array:
    return wear.aged(1.0 / np.diag(accel.matrix), ACCEL_SCALE_AGED)


def _soft_iron(wear: _Wear, mag: SensorTruth) -> tuple[Array, Array]:
    """Offset in µT and the symmetric matrix that corrects, in the chip's frame."""
    aged = np.triu(wear.aged(np.linalg.inv(mag.matrix), MAG_MATRIX_AGED))
    return wear.aged(mag.offset, MAG_OFFSET_AGED), aged + aged.T - np.diag(np.diag(aged))


def _named(base: str, vector: Array) -> dict[str, float]:
    return {f"{base}_{axis}": float(value) for axis, value in zip(AXES, vector, strict=True)}


def _slot(slot: str, quantity: str, vector: Array) -> dict[str, float]:
    return {n: float(v) for n, v in zip(px4.vector_names(slot, quantity), vector, strict=True)}
