"""The firmwares' own correction formulas, as FLIGHT_CONTROLLERS 1.1 to 1.4 gives them.

Every function takes raw readings (N, 3) and returns body-frame corrected readings (N, 3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.service.simvehicle.rotation import Array

ARDUPILOT_T_REF = 35.0
ARDUPILOT_COEFFICIENT_SCALE = 1e-6
ARDUPILOT_SCALE_WINDOW = 1.5  # COMPASS_SCALE outside 1/1.5 … 1.5 is silently ignored


@dataclass(frozen=True)
class ArduPilotThermal:
    """INS_TCALn of one sensor: coefficients (3 orders, 3 axes) ×1e6, and the limits of temperature in °C."""

    coefficients: Array
    t_min: float
    t_max: float

    def polynomial(self, temperature: Array) -> Array:
        """P(clamp(T) − 35 °C), shape (N, 3)."""
        d = (np.clip(temperature, self.t_min, self.t_max) - ARDUPILOT_T_REF)[:, None]
        c1, c2, c3 = self.coefficients * ARDUPILOT_COEFFICIENT_SCALE
        return np.asarray(d * (c1 + d * (c2 + d * c3)))

    def correction(self, temperature: Array, cal_temperature: float) -> Array:
        """P(T) − P(Tc), which is subtracted; a CALTEMP of −300 is clamped to t_min like any other."""
        return self.polynomial(temperature) - self.polynomial(np.array([cal_temperature]))


def ardupilot_accel(
    raw: Array,
    offset: Array,
    scale: Array,
    thermal: Array | None = None,
    body_from_sensor: Array | None = None,
) -> Array:
    """R · SCAL ∘ (raw − [P(T) − P(Tc)] − OFFS)."""
    corrected = (raw if thermal is None else raw - thermal) - offset
    corrected = corrected * scale
    return corrected if body_from_sensor is None else corrected @ body_from_sensor.T


def ardupilot_gyro(
    raw: Array, offset: Array, thermal: Array | None = None, body_from_sensor: Array | None = None
) -> Array:
    """R · (raw − [P(T) − P(Tg)] − GYROFFS)."""
    corrected = (raw if thermal is None else raw - thermal) - offset
    return corrected if body_from_sensor is None else corrected @ body_from_sensor.T


def symmetric(diagonal: Array, off_diagonal: Array) -> Array:
    """The matrix of both firmwares: off-diagonals X, Y, Z are the elements 01, 02, 12."""
    x, y, z = off_diagonal
    return np.array([[diagonal[0], x, y], [x, diagonal[1], z], [y, z, diagonal[2]]])


def ardupilot_compass(
    raw_body: Array,
    offset: Array,
    diagonal: Array,
    off_diagonal: Array,
    scale: float,
    motor: Array | None = None,
) -> Array:
    """M · s · (m_b + OFS) + MOT; an all-zero diagonal switches the matrix off. Any one unit."""
    in_window = 1 / ARDUPILOT_SCALE_WINDOW <= scale <= ARDUPILOT_SCALE_WINDOW
    corrected = (raw_body + offset) * (scale if in_window else 1.0)
    if np.any(diagonal != 0):
        corrected = corrected @ symmetric(diagonal, off_diagonal).T
    return corrected if motor is None else corrected + motor


def px4_thermal(coefficients: Array, t_ref: float, t_min: float, t_max: float, temperature: Array) -> Array:
    """TC(T) = X0 + X1·d + X2·d² + X3·d³ with d = clamp(T) − TREF; coefficients (4 orders, 3 axes)."""
    d = (np.clip(temperature, t_min, t_max) - t_ref)[:, None]
    x0, x1, x2, x3 = coefficients
    return np.asarray(x0 + d * (x1 + d * (x2 + d * x3)))


def px4_accel(raw: Array, offset: Array, scale: Array, thermal: Array | None, body_from_sensor: Array) -> Array:
    """L · R · [(a − TC − OFF) ∘ SCALE]."""
    corrected = ((raw if thermal is None else raw - thermal) - offset) * scale
    return np.asarray(corrected @ body_from_sensor.T)


def px4_gyro(raw: Array, offset: Array, thermal: Array | None, body_from_sensor: Array) -> Array:
    """L · R · (g − TC − OFF)."""
    corrected = (raw if thermal is None else raw - thermal) - offset
    return np.asarray(corrected @ body_from_sensor.T)


def px4_mag(
    raw: Array, offset: Array, diagonal: Array, off_diagonal: Array, power: Array, body_from_sensor: Array
) -> Array:
    """L · R · S · (m + p·COMP − OFF); `power` (N, 3) is p·COMP. There is no thermal term."""
    corrected = (raw + power - offset) @ symmetric(diagonal, off_diagonal).T
    return np.asarray(corrected @ body_from_sensor.T)


def truncated(values: Array, multiplier: float, divisor: float = 1.0) -> Array:
    """C++ conversion of values · multiplier / divisor to int16 in float32 arithmetic: toward zero.

    Saturated, and 0 for NaN, where C++ leaves the result undefined.
    """
    counts = as_float32(values)
    with np.errstate(over="ignore", invalid="ignore"):
        counts = np.clip(counts * np.float32(multiplier) / np.float32(divisor), -32768, 32767)
    counts[np.isnan(counts)] = 0.0
    return np.asarray(counts.astype(np.int64))


def as_float32(values: Array) -> NDArray[np.float32]:
    """The nearest float32 values; what is too large becomes infinite, as in C."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(values, dtype=np.float32)
