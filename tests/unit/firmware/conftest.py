"""Vehicles' parameters and fits, for the tests of plans and of their verification."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mavcal.calib.firmware.names import (
    ardupilot_compass_names,
    ardupilot_imu_names,
    px4_names,
    px4_thermal_names,
)
from mavcal.calib.firmware.plan import Fingerprint
from mavcal.calib.fit import FitResult, FitStatus, parameter_names
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial, TriadModel

Make = Callable[..., FitResult]


INTEGER_ROLES = {"id", "use", "priority", "external", "rotation", "motor_type", "thermal_id", "thermal_enable"}


def _defaults(names: Any) -> dict[str, float | int]:
    values: dict[str, float | int] = {}
    for role, name in names.items():
        if role in INTEGER_ROLES:
            values[name] = 0
        else:
            values[name] = 1.0 if role.startswith("scale_") else 0.0
    return values


@pytest.fixture
def ardupilot_parameters() -> dict[str, float | int]:
    """Two inertial units and two compasses, never calibrated; thermal sets are off and hidden."""
    values: dict[str, float | int] = {"AHRS_ORIENTATION": 0, "INS_GYR_CAL": 1, "COMPASS_LEARN": 0}
    values |= {"AHRS_TRIM_X": 0.0, "AHRS_TRIM_Y": 0.0, "COMPASS_OFFS_MAX": 1800.0}
    for slot in range(2):
        for sensor in (Sensor.ACCEL, Sensor.GYRO):
            names = ardupilot_imu_names(sensor, slot)
            values |= {n: v for n, v in _defaults(names).items() if "TCAL" not in n or n.endswith("ENABLE")}
            values[names["id"]] = 2753028 + 8192 * slot + (1 if sensor == Sensor.GYRO else 0)
            values[names["use"]] = 1
            values[names["temperature"]] = -300.0
    for slot in range(2):
        names = ardupilot_compass_names(slot, slot)
        values |= _defaults(names)
        values |= {names["id"]: 97539 + 65536 * slot, names["priority"]: 97539 + 65536 * slot, names["use"]: 1}
        values[names["external"]] = 1
    return values


@pytest.fixture
def px4_parameters() -> dict[str, float | int]:
    """One accelerometer, gyroscope and magnetometer with their ids; nothing calibrated, thermal correction off."""
    values: dict[str, float | int] = {"SENS_BOARD_ROT": 0, "SENS_BOARD_X_OFF": 0.0, "SENS_BOARD_Y_OFF": 0.0}
    values |= {"SENS_BOARD_Z_OFF": 0.0, "SENS_IMU_AUTOCAL": 1, "SENS_MAG_AUTOCAL": 1, "IMU_GYRO_CAL_EN": 1}
    for sensor in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG):
        for slot in range(4):
            row = _defaults(px4_names(sensor, slot))
            values |= row
            values[px4_names(sensor, slot)["rotation"]] = -1
            values[px4_names(sensor, slot)["priority"]] = -1
        values[px4_names(sensor, 0)["id"]] = 197388 if sensor == Sensor.MAG else 1310988
    for sensor in (Sensor.ACCEL, Sensor.GYRO):
        values[px4_thermal_names(sensor, 0)["thermal_enable"]] = 0
    return values


@pytest.fixture
def ardupilot_fingerprint() -> Fingerprint:
    return Fingerprint("ardupilot", "0123", "4.7.0", ())


@pytest.fixture
def px4_fingerprint() -> Fingerprint:
    return Fingerprint("px4", "0123", "1.17.0", ())


@pytest.fixture
def make_fit() -> Make:
    """A fit with given offset, matrix, sd and polynomial; a symmetric matrix has a symmetric covariance."""

    def make(
        sensor: Sensor,
        instance: int = 0,
        *,
        offset: Any = (0.0, 0.0, 0.0),
        matrix: Any = None,
        offset_sd: float = 1e-3,
        matrix_sd: float = 0.0,
        polynomial: ThermalPolynomial | None = None,
        polynomial_sd: float = 0.0,
        temperature: float | None = 32.0,
        undetermined: tuple[str, ...] = (),
        **more: Any,
    ) -> FitResult:
        degree = 0 if polynomial is None else polynomial.coefficients.shape[1]
        covariance = np.zeros((12 + 3 * degree, 12 + 3 * degree))
        covariance[:3, :3] = offset_sd**2 * np.eye(3)
        for i in range(3):
            for j in range(3):
                for k in ((i, j), (j, i)):
                    covariance[3 + 3 * i + j, 3 + 3 * k[0] + k[1]] = matrix_sd**2
        if degree:
            powers = polynomial_sd * np.array([10.0**-k for k in range(degree)] * 3)
            covariance[12:, 12:] = np.diag(powers**2)
        names = parameter_names(degree)
        for name in undetermined:
            covariance[names.index(name)] = covariance[:, names.index(name)] = 0.0
        return FitResult(
            method=more.pop("method", "test"),
            sensor=sensor,
            instance=instance,
            status=more.pop("status", FitStatus.PARTIAL if undetermined else FitStatus.OK),
            message=more.pop("message", ""),
            model=TriadModel(offset, np.eye(3) if matrix is None else matrix, polynomial),
            covariance=covariance,
            unit={Sensor.ACCEL: "m/s2", Sensor.GYRO: "rad/s"}.get(sensor, "uT"),
            n_samples=1000,
            n_used=1000,
            residual_rms=more.pop("residual_rms", 0.0),
            condition_number=1.0,
            undetermined=undetermined,
            temperature=temperature,
            **more,
        )

    return make
