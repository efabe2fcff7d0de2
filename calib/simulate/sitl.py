"""Sensor errors as ArduPilot's simulator parameters ``SIM_*``, and back (FLIGHT_CONTROLLERS 7.1).

::

    accel  f / SIM_ACCn_SCAL + SIM_ACCn_BIAS + Q(T - T_mid)        SIM_ACC_TRIM turns the sensor
    gyro   (w + Q(T - T_mid)) (1 + SIM_GYRn_SCALE / 100) + SIM_GYRn_BIAS
    mag    SIM_MAGn_SCALING (D^-1 B - SIM_MAGn_OFS), D of SIM_MAGn_DIA and SIM_MAGn_ODI, mgauss

Signs are such that the firmware's calibration parameters cancel equal numbers. ``Q`` has ``SIM_IMUTn_ACC1..3`` and
``GYR1..3`` in millionths about ``T_mid``, the middle of ``SIM_IMUTn_TMIN`` and ``TMAX``. A scale or a diagonal of zero
means none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Array, Rounding
from mavcal.calib.simulate.motion import Warming
from mavcal.calib.simulate.recording import SensorSuite
from mavcal.calib.simulate.sensor import SensorErrors

UT_PER_MGAUSS = 0.1
ACCEL_NOISE = 0.01  # m/s2, amplitude of the uniform noise that SITL always adds
GYRO_NOISE = math.radians(0.04)  # rad/s, likewise

_MILLIONTH = 1e-6
_ORDERS = (1, 2, 3)
_AXES = "XYZ"
_HALF_SPAN = 35.0  # degC, from T_mid to TMIN and TMAX where they are ours to choose
_TINY = 1e-12
_UNUSED = (  # families that shape a sensor but have no counterpart here
    *("SIM_MAG_MOT", "SIM_MAG_DELAY", "SIM_MAG_ALY", "SIM_DRIFT_SPEED", "SIM_VIB_FREQ", "SIM_VIB_MOT_MAX"),
    *("SIM_ACC_FILE_RW", "SIM_GYR_FILE_RW", "SIM_IMU_POS", "SIM_IMU_ORIENT"),
)


@dataclass(frozen=True, eq=False)
class SitlSensors:
    """Contents of one instance of ``SIM_*``: its sensors, the warm-up, and parameters without a counterpart."""

    suite: SensorSuite
    warming: Warming | None
    ignored: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class SitlParameters:
    """``SIM_*`` by name, and in words which errors they cannot represent."""

    values: Mapping[str, float]
    not_held: tuple[str, ...]


def from_sitl(parameters: Mapping[str, float], *, instance: int = 0, rate: float | None = None) -> SitlSensors:
    """The sensors that SITL simulates for `instance` (from 0: ``SIM_ACC1``, ``SIM_GYR1``, ``SIM_MAG1``).

    Parameters
    ----------
    parameters
        Parameters by name; names without a number, from older versions, stand for the first instance.
    instance
        From 0.
    rate
        Sample rate of SITL's uniform noise, 1/s; None: no noise.

    Raises
    ------
    InvalidInputError
        If no ``SIM_*`` of a sensor is among them, or a matrix has no inverse.
    """
    if not any(name.startswith(("SIM_ACC", "SIM_GYR", "SIM_MAG", "SIM_IMUT")) for name in parameters):
        raise InvalidInputError("there is no SIM_ACC*, SIM_GYR*, SIM_MAG* or SIM_IMUT* among the parameters")
    p = _Reader(parameters, instance + 1)
    middle = 0.5 * (p.one("SIM_IMUT#_TMIN", 0.0) + p.one("SIM_IMUT#_TMAX", 70.0))
    gyro_scale = 1.0 + 0.01 * p.vector("SIM_GYR#_SCALE")
    density = 0.0 if rate is None else 1.0 / math.sqrt(3.0 * rate)  # uniform noise: amplitude / sqrt 3
    accel = SensorErrors(
        bias=p.vector("SIM_ACC#_BIAS"),
        matrix=np.diag(1.0 / _or_one(p.vector("SIM_ACC#_SCAL"))) @ _trim(p.vector("SIM_ACC_TRIM")).T,
        t_ref=middle,
        temperature=p.polynomial("ACC"),
        noise_density=np.full(3, ACCEL_NOISE * density),
    )
    gyro = SensorErrors(
        bias=p.vector("SIM_GYR#_BIAS"),
        matrix=np.diag(gyro_scale),
        t_ref=middle,
        temperature=gyro_scale[:, None] * p.polynomial("GYR"),
        noise_density=np.abs(gyro_scale) * GYRO_NOISE * density,
    )
    return SitlSensors(SensorSuite(accel, gyro, _magnetometer(p, density)), _warming(p), _ignored(parameters))


def _magnetometer(p: _Reader, density: float) -> SensorErrors:
    diagonal = p.vector("SIM_MAG#_DIA")
    ellipsoid = _symmetric(diagonal, p.vector("SIM_MAG#_ODI")) if diagonal.any() else np.eye(3)
    if not np.linalg.cond(ellipsoid) < 1e6:
        raise InvalidInputError(f"SIM_MAG DIA and ODI have no inverse: {ellipsoid.tolist()}")
    scaling = p.one("SIM_MAG#_SCALING", 1.0) or 1.0
    matrix = np.asarray(scaling * np.linalg.inv(ellipsoid), dtype=np.float64)
    noise = abs(p.one("SIM_MAG_RND", 0.0)) * UT_PER_MGAUSS * density
    return SensorErrors(
        bias=-scaling * UT_PER_MGAUSS * p.vector("SIM_MAG#_OFS"),
        matrix=matrix,
        noise_density=noise * np.linalg.norm(matrix, axis=1),  # added before the matrix; per axis the same size
    )


def _warming(p: _Reader) -> Warming | None:
    fixed = p.one("SIM_IMUT_FIXED", 0.0)
    if fixed:
        return Warming(fixed, fixed)
    if not p.has("SIM_IMUT_START") and not p.has("SIM_IMUT_END"):
        return None
    return Warming(p.one("SIM_IMUT_START", 25.0), p.one("SIM_IMUT_END", 45.0), p.one("SIM_IMUT_TCONST", 300.0))


def _ignored(parameters: Mapping[str, float]) -> tuple[str, ...]:
    return tuple(sorted(name for name, value in parameters.items() if name.startswith(_UNUSED) and value != 0.0))


def to_sitl(suite: SensorSuite, *, instance: int = 0, warming: Warming | None = None) -> SitlParameters:
    """``SIM_*`` of `instance` (from 0) that make SITL's sensors like `suite`, and which errors they cannot represent.

    Raises
    ------
    InvalidInputError
        If a scale is negative or zero: SITL has no such sensor.
    """
    n, not_held = instance + 1, []
    values: dict[str, float] = {}
    scale = np.diag(suite.accel.matrix)
    gyro_scale = np.diag(suite.gyro.matrix)
    if (scale <= 0.0).any() or (gyro_scale <= 0.0).any():
        raise InvalidInputError(f"scales are positive: {scale.tolist()} and {gyro_scale.tolist()}")
    _put(values, f"SIM_ACC{n}_BIAS", suite.accel.bias)
    _put(values, f"SIM_ACC{n}_SCAL", 1.0 / scale)
    _put(values, f"SIM_GYR{n}_BIAS", suite.gyro.bias)
    _put(values, f"SIM_GYR{n}_SCALE", 100.0 * (gyro_scale - 1.0))
    for name, errors in (("accelerometer", suite.accel), ("gyroscope", suite.gyro)):
        cross = errors.matrix - np.diag(np.diag(errors.matrix))
        if np.abs(cross).max() > _TINY:
            not_held.append(f"cross terms of the {name}, up to {np.abs(cross).max():.3g}")
    not_held += _put_temperature(values, suite, n)
    not_held += _put_magnetometer(values, suite.mag, n)
    not_held += _others(suite)
    if warming is not None:
        values |= {"SIM_IMUT_START": warming.start, "SIM_IMUT_END": warming.end}
        values |= {"SIM_IMUT_TCONST": warming.time_constant, "SIM_IMUT_FIXED": 0.0}
    return SitlParameters(values, tuple(not_held))


def _put_temperature(values: dict[str, float], suite: SensorSuite, n: int) -> list[str]:
    drifting = [e for e in (suite.accel, suite.gyro) if e.drift is not None]
    if not drifting:
        return []
    middle = drifting[0].t_ref
    if any(e.t_ref != middle for e in drifting):
        raise InvalidInputError("accelerometer and gyroscope share one T_mid in SITL: give their drifts about the same")
    values[f"SIM_IMUT{n}_ENABLE"] = 1.0
    values[f"SIM_IMUT{n}_TMIN"], values[f"SIM_IMUT{n}_TMAX"] = middle - _HALF_SPAN, middle + _HALF_SPAN
    lost = []
    for name, sensor, errors, scale in (
        ("ACC", "accelerometer", suite.accel, np.ones(3)),
        ("GYR", "gyroscope", suite.gyro, np.diag(suite.gyro.matrix)),
    ):
        for order in _ORDERS:
            held = errors.temperature.shape[1] >= order
            column = errors.temperature[:, order - 1] if held else np.zeros(3)
            _put(values, f"SIM_IMUT{n}_{name}{order}", column / scale / _MILLIONTH)
        if errors.temperature[:, len(_ORDERS) :].any():
            lost.append(f"terms beyond the third of the {sensor}'s drift")
    return lost


def _put_magnetometer(values: dict[str, float], mag: SensorErrors, n: int) -> list[str]:
    inverse = np.linalg.inv(mag.matrix)
    ellipsoid = 0.5 * (inverse + inverse.T)
    _put(values, f"SIM_MAG{n}_OFS", -mag.bias / UT_PER_MGAUSS)
    _put(values, f"SIM_MAG{n}_DIA", np.diag(ellipsoid))
    _put(values, f"SIM_MAG{n}_ODI", ellipsoid[[0, 0, 1], [1, 2, 2]])
    values[f"SIM_MAG{n}_SCALING"] = 1.0
    lost = float(np.abs(inverse - ellipsoid).max())
    return [f"the antisymmetric part of the soft iron, up to {lost:.3g}"] if lost > _TINY else []


def _others(suite: SensorSuite) -> list[str]:
    lost = []
    for sensor, e in suite.by_sensor.items():
        if e.noise_density.any():
            lost.append(f"noise of the {sensor}: SITL's own is uniform and fixed")
        if e.bias_instability.any() or e.random_walk.any():
            lost.append(f"bias instability and random walk of the {sensor}")
        if e.temperature_scale.any():
            lost.append(f"scale of the {sensor} with temperature")
        if e.g_sensitivity.any():
            lost.append(f"g-sensitivity of the {sensor}")
        if e.thermal_lag:
            lost.append(f"thermal lag of the {sensor}")
        if np.isfinite(e.full_scale) or (e.resolution and e.rounding != Rounding.NONE):
            lost.append(f"range and resolution of the {sensor}")
    if suite.mag.drift is not None:
        lost.append("drift of the magnetometer with temperature")
    return lost


class _Reader:
    """Values by name, ``#`` standing for the instance's number; older names have none for the first instance."""

    def __init__(self, parameters: Mapping[str, float], number: int) -> None:
        self._parameters, self._number = parameters, number

    def _found(self, name: str) -> float | None:
        names = [name.replace("#", str(self._number))]
        if "#" in name and self._number == 1:
            names.append(name.replace("#", ""))
        return next((float(self._parameters[n]) for n in names if n in self._parameters), None)

    def has(self, name: str) -> bool:
        return self._found(name) is not None

    def one(self, name: str, default: float) -> float:
        value = self._found(name)
        return default if value is None else value

    def vector(self, name: str) -> Array:
        return np.array([self.one(f"{name}_{axis}", 0.0) for axis in _AXES])

    def polynomial(self, sensor: str) -> Array:
        return _MILLIONTH * np.column_stack([self.vector(f"SIM_IMUT#_{sensor}{order}") for order in _ORDERS])


def _put(values: dict[str, float], name: str, vector: Array) -> None:
    for axis, value in zip(_AXES, vector, strict=True):
        values[f"{name}_{axis}"] = float(value)


def _or_one(vector: Array) -> Array:
    return np.where(vector == 0.0, 1.0, vector)


def _symmetric(diagonal: Array, off: Array) -> Array:
    xy, xz, yz = off
    return np.array([[diagonal[0], xy, xz], [xy, diagonal[1], yz], [xz, yz, diagonal[2]]])


def _trim(angles: Array) -> Array:
    """Rotation of roll, pitch, yaw in rad, as ``Matrix3f::from_euler`` makes it."""
    return np.asarray(Rotation.from_euler("ZYX", angles[::-1]).as_matrix(), dtype=np.float64)
