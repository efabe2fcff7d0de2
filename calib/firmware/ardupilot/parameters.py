"""ArduPilot's sensor corrections: the only place with its formulas (FLIGHT_CONTROLLERS 1.1-1.3).

=============  =====================================================================================================
accelerometer  ``b = R_board (SCAL o (u - OFFS))``, ``u = s - P(clamp T) + P(clamp CALTEMP)`` if TCAL is enabled
gyroscope      ``b = R_board (g - P(clamp T) + P(clamp CALTEMP) - GYROFFS)``
compass        ``c = M (s (R m + OFS)) + MOT``: the offset is added, and it lies in the body frame
=============  =====================================================================================================

``P(t) = 1e-6 (C1 t + C2 t^2 + C3 t^3)``, ``t = T - 35 degC``, T clamped to TMIN..TMAX.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import names
from mavcal.calib.firmware.ardupilot.doubts import absurd_motor_gain
from mavcal.calib.firmware.names import ARDUPILOT_PREFIXES as CALIBRATION_PREFIXES
from mavcal.calib.firmware.names import Role
from mavcal.calib.firmware.rotations import euler_matrix, rotation_matrix
from mavcal.calib.firmware.slots import ardupilot_calibration_names as calibration_names
from mavcal.calib.firmware.slots import ardupilot_sensor_ids as sensor_ids
from mavcal.calib.firmware.values import need, vector
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import ThermalPolynomial, TriadModel

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mavcal.calib.firmware.plan import Value

__all__ = [
    "CALIBRATION_PREFIXES",
    "THERMAL_SCALE",
    "T_REF",
    "UT_PER_MGAUSS",
    "board_rotation",
    "calibration_in_force",
    "calibration_names",
    "field_scale",
    "motor_term",
    "mounting",
    "sensor_ids",
]
T_REF: Final = 35.0
"""Reference of the thermal polynomial, degC; not a parameter."""
THERMAL_SCALE: Final = 1e-6
"""A thermal coefficient is its parameter times this."""
UT_PER_MGAUSS: Final = 0.1
FIELD_SCALE_MAX: Final = 1.5
"""COMPASS_SCALE acts between 1/1.5 and 1.5 and is silently ignored elsewhere."""


def calibration_in_force(parameters: Mapping[str, Value], sensor: Sensor, instance: int) -> TriadModel:
    """The correction that an ArduPilot with `parameters` applies: raw sensor frame to corrected body frame.

    Units are SI and uT. A compass's motor term is not part of it (:func:`motor_term`).

    Raises
    ------
    FirmwareError
        If a parameter that decides the correction is not among `parameters`, or a scale is zero.
    """
    roles = calibration_names(parameters, sensor, instance)
    if sensor == Sensor.MAG:
        return _compass_in_force(parameters, roles)
    offset = vector(parameters, roles, names.OFFSET)
    scale = vector(parameters, roles, names.SCALE) if sensor == Sensor.ACCEL else np.ones(3)
    if not scale.all():
        raise FirmwareError(
            f"{roles[Role.SCALE_X][:-1]}* is {tuple(scale.tolist())}: a scale of zero marks an absent sensor; "
            "set it to 1 before this slot can be calibrated"
        )
    polynomial = _polynomial(parameters, roles)
    if polynomial is not None:
        # the firmware adds back the drift at CALTEMP; an unset CALTEMP (-300) is clamped to TMIN like any other
        offset = offset - polynomial(need(parameters, roles[Role.TEMPERATURE]))
    return TriadModel(offset, board_rotation(parameters) @ np.diag(scale), polynomial)


def board_rotation(parameters: Mapping[str, Value]) -> Array:
    """``R_body_from_board`` of AHRS_ORIENTATION (in force since boot), shape (3, 3)."""
    return _rotation(parameters, need(parameters, names.BOARD_ROTATION["ardupilot"]))


def mounting(parameters: Mapping[str, Value], sensor: Sensor, instance: int) -> Array:
    """``R_body_from_sensor`` of one sensor, shape (3, 3): the board's, or an external compass's own."""
    if sensor == Sensor.MAG:
        return _compass_mounting(parameters, calibration_names(parameters, sensor, instance))
    return board_rotation(parameters)


def field_scale(value: float) -> float:
    """Factor that the firmware applies for COMPASS_SCALE = `value`: the value within its window, else 1."""
    return float(value) if 1.0 / FIELD_SCALE_MAX <= value <= FIELD_SCALE_MAX else 1.0


def motor_term(
    parameters: Mapping[str, Value], instance: int, throttle: Array | None, current: Array | None
) -> Array | None:
    """Motor compensation that ArduPilot adds to compass `instance`, uT, shape (N, 3); None: it adds nothing.

    `throttle` (N,) in 0..1 is needed for COMPASS_MOTCT = 1, `current` (N,) in A for COMPASS_MOTCT = 2.

    Raises
    ------
    FirmwareError
        If the compensation depends on something that was not recorded.
    """
    kind = int(parameters.get("COMPASS_MOTCT", 0))
    if kind == 0:
        return None
    if kind == 3:
        _refuse_per_motor(parameters, instance)
        return None
    roles = calibration_names(parameters, Sensor.MAG, instance)
    gain = UT_PER_MGAUSS * vector(parameters, roles, names.MOTOR)
    if not gain.any():
        return None
    for role in names.MOTOR:
        if absurd_motor_gain(roles[role], parameters[roles[role]]):
            raise FirmwareError(
                f"{roles[role]} is {parameters[roles[role]]:g}, which is corrupt: set COMPASS_MOTCT to 0, or calibrate "
                "the compensation again"
            )
    drive, message = (throttle, "VFR_HUD") if kind == 1 else (current, "BATTERY_STATUS")
    if drive is None:
        raise FirmwareError(
            f"COMPASS_MOTCT = {kind} compensates compass {instance + 1} for the motors, and what drives them was not "
            f"recorded; stream {message} too, or set COMPASS_MOTCT to 0"
        )
    return np.asarray(drive, dtype=np.float64)[:, None] * gain


def _refuse_per_motor(parameters: Mapping[str, Value], instance: int) -> None:
    # Compass_PerMotor.cpp: first compass only; depends on motor outputs and voltage, which no message carries together
    gains = [parameters.get(f"COMPASS_PMOT{m}_{axis}", 0) for m in range(1, 5) for axis in "XYZ"]
    if instance == 0 and parameters.get("COMPASS_PMOT_EN", 0) and any(gains):
        raise FirmwareError(
            "COMPASS_MOTCT = 3 compensates the first compass motor by motor, which cannot be undone from telemetry; "
            "set COMPASS_MOTCT to 0 while you calibrate"
        )


def _compass_in_force(parameters: Mapping[str, Value], roles: Mapping[Role, str]) -> TriadModel:
    offset = UT_PER_MGAUSS * vector(parameters, roles, names.OFFSET)
    diagonal = vector(parameters, roles, names.SCALE)
    matrix = np.eye(3)
    if diagonal.any():  # an all-zero diagonal switches the whole matrix off
        xy, xz, yz = vector(parameters, roles, names.CROSS)
        matrix = np.diag(diagonal) + np.array([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]])
    matrix = matrix * field_scale(parameters.get(roles[Role.FIELD_SCALE], 0.0))
    turn = _compass_mounting(parameters, roles)
    # M s (R m + OFS) = M s R (m + R' OFS)
    return TriadModel(-turn.T @ offset, matrix @ turn)


def _compass_mounting(parameters: Mapping[str, Value], roles: Mapping[Role, str]) -> Array:
    if need(parameters, roles[Role.EXTERNAL]):
        return _rotation(parameters, need(parameters, roles[Role.ROTATION]))
    return board_rotation(parameters)


def _polynomial(parameters: Mapping[str, Value], roles: Mapping[Role, str]) -> ThermalPolynomial | None:
    # a board without the feature does not know the parameter; while learning (2) nothing is corrected
    if int(parameters.get(roles[Role.THERMAL_ENABLE], 0)) != 1:
        return None
    return ThermalPolynomial(
        t_ref=T_REF,
        t_min=need(parameters, roles[Role.THERMAL_MIN]),
        t_max=need(parameters, roles[Role.THERMAL_MAX]),
        coefficients=THERMAL_SCALE * np.stack([vector(parameters, roles, names.THERMAL[k]) for k in (1, 2, 3)], axis=1),
    )


def _rotation(parameters: Mapping[str, Value], number: float) -> Array:
    angles = names.ARDUPILOT_CUSTOM.get(int(number))
    if angles is None:
        return rotation_matrix("ardupilot", int(number))
    return euler_matrix(*(need(parameters, name) for name in angles))
