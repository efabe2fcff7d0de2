"""Sensor errors as MATLAB's ``accelparams``, ``gyroparams`` and ``magparams``, and back.

``imuSensor`` computes ``(1 + TemperatureScaleFactor/100 (T - 25)) * (AxesMisalignment/100 x + ConstantBias + drift +
TemperatureBias (T - 25))``, clips it to the range and rounds it. Three things differ from this package:

* its accelerometer reads gravity less acceleration in NED and in ENU, the negative specific force: accelerometer biases
change sign;
* the body axes of an ENU sensor are forward-left-up;
* ``NoiseType`` ``double-sided`` (the default) gives a sample ``NoiseDensity sqrt(rate/2)`` and a step
  ``RandomWalk / sqrt(rate/2)``, ``single-sided`` the whole rate, as the Allan coefficients do.

``AccelerationBias`` acts on MATLAB's linear acceleration; here on the specific force, gravity included.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Array, Rounding, Sensor
from mavcal.calib.simulate.noise import half_derivative
from mavcal.calib.simulate.recording import Frame, errors_turned
from mavcal.calib.simulate.sensor import SensorErrors

OBJECTS = {"accelparams": Sensor.ACCEL, "gyroparams": Sensor.GYRO, "magparams": Sensor.MAG}
"""Name of the MATLAB object of each sensor."""

_T_REF = 25.0  # degC, fixed in imuSensor
_SIDED = {"double-sided": 2.0, "single-sided": 1.0}
_DEFAULT_POLES = (1.0, -0.5)
_PROPERTIES = {
    *("MeasurementRange", "Resolution", "ConstantBias", "AxesMisalignment", "NoiseDensity", "BiasInstability"),
    *("RandomWalk", "TemperatureBias", "TemperatureScaleFactor", "NoiseType", "BiasInstabilityCoefficients"),
}


@dataclass(frozen=True, eq=False)
class MatlabParameters:
    """Properties by name, and in words which errors they cannot represent."""

    values: Mapping[str, Any]
    not_held: tuple[str, ...]


def from_matlab(properties: Mapping[str, Any], sensor: Sensor, *, frame: Frame = "ned") -> SensorErrors:
    """Errors in the contract's axes from the properties of a MATLAB parameter object.

    Parameters
    ----------
    properties
        By MATLAB's names; those left out have MATLAB's defaults. Scalars stand for three equal axes.
    sensor
        The sensor that they belong to.
    frame
        ``ReferenceFrame`` of the ``imuSensor`` that they belong to.

    Raises
    ------
    InvalidInputError
        If a property is unknown, of a wrong shape or not finite.
    """
    known = _PROPERTIES | ({"AccelerationBias"} if sensor == Sensor.GYRO else set())
    unknown = sorted(set(properties) - known)
    if unknown:
        raise InvalidInputError(
            f"{sensor} parameters have no {', '.join(unknown)}; they are {', '.join(sorted(known))}"
        )
    sides = _sides(properties.get("NoiseType", "double-sided"))
    sign = -1.0 if sensor == Sensor.ACCEL else 1.0
    gain = 0.01 * _misalignment(properties.get("AxesMisalignment", 0.0))
    poles = np.asarray(_coefficients(properties), dtype=np.float64)
    errors = SensorErrors(
        bias=sign * _three("ConstantBias", properties),
        matrix=gain,
        noise_density=_three("NoiseDensity", properties) / np.sqrt(sides),
        bias_instability=_three("BiasInstability", properties),
        instability_poles=poles,
        random_walk=_three("RandomWalk", properties) * np.sqrt(sides),
        t_ref=_T_REF,
        temperature=sign * _three("TemperatureBias", properties)[:, None],
        temperature_scale=0.01 * _three("TemperatureScaleFactor", properties),
        g_sensitivity=np.diag(_three("AccelerationBias", properties)),
        full_scale=_number("MeasurementRange", properties, np.inf),
        resolution=_number("Resolution", properties, 0.0),
    )
    return errors if frame == "ned" else errors_turned(errors)


def to_matlab(errors: SensorErrors, sensor: Sensor, *, frame: Frame = "ned", poles: int = 64) -> MatlabParameters:
    """The properties of a MATLAB parameter object, and which errors it cannot represent.

    Parameters
    ----------
    errors, sensor
        The sensor and its errors, in the contract's axes.
    frame
        ``ReferenceFrame`` of the ``imuSensor`` that the properties are for.
    poles
        Terms of the flicker filter where the errors name none; its spectrum is flat below about ``rate / poles``.
    """
    e = errors if frame == "ned" else errors_turned(errors)
    sign = -1.0 if sensor == Sensor.ACCEL else 1.0
    growth = 1.0 + e.temperature_scale * (_T_REF - e.t_ref)  # imuSensor's reference is 25 degC
    if (growth <= 0.0).any():
        raise InvalidInputError("the temperature scale reaches zero at 25 degC: such a sensor has no MATLAB form")
    bias, slope, curved = _about_25(e)
    scale = 100.0 * e.temperature_scale / growth
    cross = e.g_sensitivity - np.diag(np.diag(e.g_sensitivity))
    not_held = [
        *(["curvature of the drift with temperature"] if curved else []),
        *(["the lag of the die behind the thermometer"] if e.thermal_lag else []),
        *(["truncation: MATLAB rounds to the nearest step"] if e.rounding == Rounding.TOWARD_ZERO else []),
        *(["g-sensitivity off the diagonal"] if cross.any() else []),
        *(
            ["g-sensitivity of a sensor other than a gyroscope"]
            if sensor != Sensor.GYRO and e.g_sensitivity.any()
            else []
        ),
        *(["a scale that falls with temperature"] if (scale < 0.0).any() else []),
    ]
    values: dict[str, Any] = {
        "MeasurementRange": e.full_scale,
        "Resolution": e.resolution if e.rounding != Rounding.NONE else 0.0,
        "ConstantBias": (sign * growth * bias).tolist(),
        "AxesMisalignment": (100.0 * growth[:, None] * e.matrix).tolist(),
        "NoiseDensity": (growth * e.noise_density).tolist(),
        "BiasInstability": (growth * e.bias_instability).tolist(),
        "RandomWalk": (growth * e.random_walk).tolist(),
        "NoiseType": "single-sided",
        "BiasInstabilityCoefficients": {
            "Numerator": [1.0],
            "Denominator": (half_derivative(poles) if e.instability_poles is None else e.instability_poles).tolist(),
        },
        "TemperatureBias": (sign * growth * slope).tolist(),
        "TemperatureScaleFactor": np.maximum(scale, 0.0).tolist(),
    }
    if sensor == Sensor.GYRO:
        values["AccelerationBias"] = (growth * np.diag(e.g_sensitivity)).tolist()
    return MatlabParameters(values, tuple(not_held))


def _about_25(e: SensorErrors) -> tuple[Array, Array, bool]:
    """Bias and slope at 25 degC, and whether the drift is curved there."""
    if e.temperature.shape[1] == 0:
        return e.bias, np.zeros(3), False
    curve = [
        np.polynomial.Polynomial([0.0, *row])(np.polynomial.Polynomial([_T_REF - e.t_ref, 1.0]))
        for row in e.temperature
    ]
    coefficients = np.array([np.pad(c.coef, (0, e.temperature.shape[1] + 1 - len(c.coef))) for c in curve])
    return e.bias + coefficients[:, 0], coefficients[:, 1], bool(coefficients[:, 2:].any())


def _sides(noise_type: Any) -> float:
    if noise_type not in _SIDED:
        raise InvalidInputError(f"NoiseType is one of {', '.join(_SIDED)}, not {noise_type!r}")
    return _SIDED[noise_type]


def _coefficients(properties: Mapping[str, Any]) -> list[float]:
    given = properties.get("BiasInstabilityCoefficients", {"Numerator": 1.0, "Denominator": _DEFAULT_POLES})
    if not isinstance(given, Mapping) or set(given) != {"Numerator", "Denominator"}:
        raise InvalidInputError("BiasInstabilityCoefficients has Numerator and Denominator")
    numerator = np.atleast_1d(np.asarray(given["Numerator"], dtype=np.float64)).ravel()
    if len(numerator) != 1 or numerator[0] == 0.0:
        raise InvalidInputError("BiasInstabilityCoefficients: a numerator of one number is understood")
    return list(np.atleast_1d(np.asarray(given["Denominator"], dtype=np.float64)).ravel() / numerator[0])


def _misalignment(value: Any) -> Array:
    """Misalignment (3, 3) in percent; a scalar, or one number a column, fills the entries off a diagonal of 100."""
    array = _array("AxesMisalignment", value)
    if array.size in {1, 3}:
        return np.where(np.eye(3, dtype=bool), 100.0, np.broadcast_to(array.ravel(), (3, 3)))
    if array.shape != (3, 3):
        raise InvalidInputError(f"AxesMisalignment is one, three or 3 x 3 numbers, not of shape {array.shape}")
    return array


def _three(name: str, properties: Mapping[str, Any]) -> Array:
    array = _array(name, properties.get(name, 0.0)).ravel()
    if array.size not in {1, 3}:
        raise InvalidInputError(f"{name} is one or three numbers, not {array.size}")
    return np.array(np.broadcast_to(array, 3))


def _number(name: str, properties: Mapping[str, Any], default: float) -> float:
    value = properties.get(name, default)
    if value is None:  # infinite, as JSON has it
        return default
    array = _array(name, value, finite=False)
    if array.size != 1 or np.isnan(array).any():
        raise InvalidInputError(f"{name} is one number, not {value!r}")
    return float(array.ravel()[0])


def _array(name: str, value: Any, *, finite: bool = True) -> Array:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidInputError(f"{name} is made of numbers, not {value!r}") from None
    if finite and not np.isfinite(array).all():
        raise InvalidInputError(f"{name} is finite, not {value!r}")
    return array


def suite_from_matlab(document: Mapping[str, Any], *, frame: Frame = "ned") -> dict[str, SensorErrors]:
    """Errors by sensor name from ``{"accelparams": {...}, "gyroparams": {...}, "magparams": {...}}``."""
    return {OBJECTS[n].value: from_matlab(p, OBJECTS[n], frame=frame) for n, p in document.items()}
