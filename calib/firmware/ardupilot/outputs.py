"""Motor outputs of an ArduPilot, and the drive for each pulse width.

A range (copter, throttle of a plane) runs from rest at its least pulse. A reversible output rests at its neutral pulse.
Such outputs are thrusters of a sub (``AP_Motors6DOF``: 1500 us) and throttles of rovers and boats (``SERVOn_TRIM``). So
are throttles of planes with reverse thrust (``THR_MIN`` < 0), and 3D speed controllers (``SERVO_BLH_3DMASK``). Sources:
``AP_MotorsUGV.cpp``, ``AP_Motors6DOF.cpp``, ``SRV_Channel.cpp`` and ``ArduPlane/servos.cpp``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.ardupilot.log_fields import MOTOR_FUNCTIONS, PWM_DEFAULT, THROTTLE_FUNCTIONS

Array = NDArray[np.float64]

LEAST_US: Final = 500.0
MOST_US: Final = 2500.0
"""Range of a speed controller's pulses. An output outside it was never initialised: it reads 0, or stale memory."""
NEUTRAL_US: Final = 1500.0
REVERSIBLE_RANGE: Final = (1100.0, 1900.0)
"""Default ends of the outputs (``SERVOn_MIN``, ``SERVOn_MAX``)."""
_COPTERS_FIRST: Final = 8
"""Outputs that may drive motors of a copter without ``SERVOn_FUNCTION``."""
_OLD_THROTTLE, _OLD_STEERING = 3, 1
"""Outputs of throttle and steering before ``SERVOn_FUNCTION``; both are motors of a skid-steered rover."""
_BY_PARAMETERS: Final[tuple[tuple[int, tuple[str, ...]], ...]] = (
    (dialect.MAV_TYPE_SUBMARINE, ("JS_GAIN_DEFAULT", "SURFACE_DEPTH", "MOT_1_DIRECTION")),
    (dialect.MAV_TYPE_GROUND_ROVER, ("CRUISE_THROTTLE", "CRUISE_SPEED", "SKID_STEER_OUT", "TURN_MAX_G")),
    (dialect.MAV_TYPE_FIXED_WING, ("ARSPD_FBW_MIN", "AIRSPEED_MIN", "TRIM_ARSPD_CM", "LIM_ROLL_CD", "ROLL_LIMIT_DEG")),
)
"""Parameters that only one kind of firmware has."""


@dataclass(frozen=True)
class MotorOutput:
    """One output that drives a motor: its number from 1, and its pulses, us."""

    number: int
    low: float
    high: float
    neutral: float | None = None
    """Neutral pulse between two directions; None: it turns in one direction, from `low`."""
    reversed: bool = False

    def drive(self, pulse: Array) -> Array:
        """Drive for each pulse (us): 0..1, or -1..1 for a reversible output; 0 without a pulse."""
        given = (pulse >= LEAST_US) & (pulse <= MOST_US)
        if self.neutral is None:
            share = (pulse - self.low) / (self.high - self.low)
            value = np.clip(1.0 - share if self.reversed else share, 0.0, 1.0)
        else:
            span = np.where(pulse >= self.neutral, self.high - self.neutral, self.neutral - self.low)
            value = np.clip((pulse - self.neutral) / np.maximum(span, 1.0), -1.0, 1.0)
            value = -value if self.reversed else value
        return np.where(given, value, 0.0)


def kind_of_vehicle(stated: int | None, parameters: Mapping[str, float]) -> int | None:
    """MAV_TYPE as `stated`, else inferred from parameters that only one kind of firmware has; None: not known."""
    if stated is not None:
        return stated
    return next((kind for kind, names in _BY_PARAMETERS if any(name in parameters for name in names)), None)


def motor_outputs(
    outputs: Sequence[int], parameters: Mapping[str, float], vehicle_type: int | None
) -> list[MotorOutput]:
    """The outputs that drive motors, by motor number where a function states it."""
    kind = kind_of_vehicle(vehicle_type, parameters)
    functions = {n: int(parameters.get(f"SERVO{n}_FUNCTION", 0)) for n in outputs}
    motors = {MOTOR_FUNCTIONS[f]: n for n, f in functions.items() if f in MOTOR_FUNCTIONS}
    throttles = [n for n, f in functions.items() if f in THROTTLE_FUNCTIONS]
    if motors:
        rotors = [_output(motors[k], parameters, kind, _low_high(parameters)) for k in sorted(motors)]
        return [*rotors, *(_output(n, parameters, kind, None) for n in throttles)]
    if throttles or any(f"SERVO{n}_FUNCTION" in parameters for n in (1, *outputs)):
        return [_output(n, parameters, kind, None) for n in throttles]
    return [_output(n, parameters, kind, _low_high(parameters)) for n in _old(kind, parameters) if n in outputs]


def _old(kind: int | None, parameters: Mapping[str, float]) -> tuple[int, ...]:
    """Outputs of motors in firmwares without ``SERVOn_FUNCTION``."""
    if kind == dialect.MAV_TYPE_GROUND_ROVER:
        return (_OLD_STEERING, _OLD_THROTTLE) if parameters.get("SKID_STEER_OUT") else (_OLD_THROTTLE,)
    if kind == dialect.MAV_TYPE_FIXED_WING:
        return (_OLD_THROTTLE,)
    return tuple(range(1, _COPTERS_FIRST + 1))


def _output(
    number: int, parameters: Mapping[str, float], kind: int | None, low_high: tuple[float, float] | None
) -> MotorOutput:
    turned = bool(parameters.get(f"SERVO{number}_REVERSED", parameters.get(f"RC{number}_REV", 1) == -1))
    ends = low_high or _ends(number, parameters) or PWM_DEFAULT
    if not _reversible(number, parameters, kind):
        return MotorOutput(number, *ends, reversed=turned and low_high is None)
    low, high = _ends(number, parameters) or REVERSIBLE_RANGE
    trim = parameters.get(f"SERVO{number}_TRIM", parameters.get(f"RC{number}_TRIM", NEUTRAL_US))
    neutral = NEUTRAL_US if kind == dialect.MAV_TYPE_SUBMARINE or not low < trim < high else float(trim)
    return MotorOutput(number, low, high, neutral, turned)


def _reversible(number: int, parameters: Mapping[str, float], kind: int | None) -> bool:
    if kind in (dialect.MAV_TYPE_SUBMARINE, dialect.MAV_TYPE_GROUND_ROVER, dialect.MAV_TYPE_SURFACE_BOAT):
        return True
    if int(parameters.get("SERVO_BLH_3DMASK", 0)) >> (number - 1) & 1:
        return True
    function = int(parameters.get(f"SERVO{number}_FUNCTION", 0))
    return kind != dialect.MAV_TYPE_QUADROTOR and function in THROTTLE_FUNCTIONS and parameters.get("THR_MIN", 0) < 0


def _ends(number: int, parameters: Mapping[str, float]) -> tuple[float, float] | None:
    """Least and greatest pulse of that output, us; None: not stated."""
    for stem in (f"SERVO{number}", f"RC{number}"):
        low, high = parameters.get(f"{stem}_MIN", 0.0), parameters.get(f"{stem}_MAX", 0.0)
        if LEAST_US <= low < high <= MOST_US:
            return float(low), float(high)
    return None


def _low_high(parameters: Mapping[str, float]) -> tuple[float, float]:
    """Pulses of the rotors of a copter or a VTOL at rest and at full power."""
    for low, high in (("MOT_PWM_MIN", "MOT_PWM_MAX"), ("Q_M_PWM_MIN", "Q_M_PWM_MAX"), ("RC3_MIN", "RC3_MAX")):
        if LEAST_US <= parameters.get(low, 0) < parameters.get(high, 0) <= MOST_US:
            return float(parameters[low]), float(parameters[high])
    return PWM_DEFAULT
