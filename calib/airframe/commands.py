"""Thrust command c of each motor, 0..1 within the spin range, at the highest rate in the log.

ArduPilot logs its outputs at 10 Hz only, but the inputs of its mixer at loop rate. The outputs are rebuilt from these
(``AP_MotorsMatrix.cpp``, ``AP_Motors_Thrust_Linearization.cpp``; AIRFRAME 3.1) and checked against the logged ones.
PX4 logs the commands of its allocation; the curve of ``THR_MDL_FAC`` lies between them and the outputs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from mavcal.calib.airframe.answer import Geometry
from mavcal.calib.airframe.geometry import mixer_factors
from mavcal.calib.recording import Channel, Recording, Sensor

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PWM_SPAN_US: Final = 1000.0
AGREES_US: Final = 5.0
"""Largest median difference from the logged outputs, us, of an accepted rebuilt mixer. Chosen, not measured: half a per
cent of the range; two simulated flights had 0.5 us."""
_WHOLE_US: Final = 1.0
"""The same, below which no alternative is tried and a fitted density is accepted. Source: outputs are logged in whole
microseconds."""
_LEAST_CHECKED: Final = 50
"""Least number of logged outputs to check a rebuilt mixer; with fewer it is not accepted. Chosen, not measured: five
seconds."""
_AT_LIMIT: Final = 1e-3
_DENSITY: Final = (0.5, 1.25)
"""Limits of the density ratio that the mixer corrects for (``AP_Motors_Thrust_Linearization.cpp``)."""


@dataclass(frozen=True, eq=False)
class MotorCommands:
    """Commands c (N, n) of the motors at the times `t` (N,), and where one of them was at a limit (N,).

    `check_us` is the median difference from logged outputs, None where there was nothing to check.
    """

    t: Array
    c: Array
    limited: Mask
    source: str
    check_us: float | None

    @property
    def rate_hz(self) -> float:
        """Median rate, Hz."""
        return float(1.0 / np.median(np.diff(self.t))) if len(self.t) > 1 else 0.0


def commands_of(recording: Recording, geometry: Geometry) -> MotorCommands | None:
    """The fastest credible commands; None: the recording has none for that many motors."""
    parameters = recording.parameters.final()
    count = len(geometry.motors)
    logged = _logged(recording, parameters, count)
    if recording.identity.autopilot == "px4":
        return logged
    rebuilt = _rebuilt(recording, parameters, geometry, logged)
    return rebuilt or logged


def _logged(recording: Recording, parameters: Mapping[str, float], count: int) -> MotorCommands | None:
    channels = [c for c in recording.find(Sensor.MOTOR) if c.values.shape[1] >= count]
    if not channels:
        return None
    motor = max(channels, key=len)
    if (motor.values[:, count:] != 0.0).any() and np.ptp(motor.values[:, count:]) > 0.0:
        return None  # more motors than the frame has
    c = motor.values[:, :count]
    if motor.source in ("RCOU", "MOT"):
        low, high = _spin_range(parameters)
        c = (c - low) / (high - low)
    elif motor.source == "actuator_motors":
        factor = float(parameters.get("THR_MDL_FAC", 0.0))
        c = _inverted(c, factor)
    c = np.clip(c, 0.0, 1.0)
    limited = np.asarray(((c <= _AT_LIMIT) | (c >= 1.0 - _AT_LIMIT)).any(axis=1))
    source = {"RCOU": "rcou", "MOT": "rcou"}.get(motor.source, motor.source)
    return MotorCommands(motor.t, c, limited, source, None)


def _spin_range(parameters: Mapping[str, float]) -> tuple[float, float]:
    """Fractions of the pulse range between which a motor runs in flight; 0 and 1 without these parameters."""
    return float(parameters.get("MOT_SPIN_MIN", 0.0)), float(parameters.get("MOT_SPIN_MAX", 1.0))


def _inverted(thrust: Array, factor: float) -> Array:
    """The output x whose thrust is ``factor x^2 + (1 - factor) x`` (``FunctionMotors.hpp``)."""
    if factor <= 0.0:
        return thrust
    line = 1.0 - factor
    return np.asarray((np.sqrt(line**2 + 4.0 * factor * np.clip(thrust, 0.0, None)) - line) / (2.0 * factor))


def _rebuilt(
    recording: Recording, parameters: Mapping[str, float], geometry: Geometry, logged: MotorCommands | None
) -> MotorCommands | None:
    """Commands at the rate of RATE; None where inputs are missing or the logged outputs contradict them."""
    control, mixer = (_dynamic(recording, s) for s in (Sensor.CONTROL, Sensor.MIXER))
    if control is None or mixer is None or logged is None or len(control) < 2 * len(logged.t):
        return None
    if len(logged.t) < _LEAST_CHECKED:
        return None

    def made(density: float) -> MotorCommands:
        mixed = _mixed(control, mixer, parameters, geometry, density)
        return replace(mixed, check_us=_difference_us(mixed, logged, parameters))

    found = min(map(made, _densities(recording)), key=_apart)
    if _apart(found) > _WHOLE_US:
        # until ArduPilot 4.5 the density goes with the temperature of the barometer at the start
        nearest = minimize_scalar(lambda density: _apart(made(density)), bounds=_DENSITY, method="bounded")
        fitted = made(float(nearest.x))
        found = fitted if _apart(fitted) <= _WHOLE_US else found  # a fit could hide another error
    return found if _apart(found) <= AGREES_US else None


def _apart(commands: MotorCommands) -> float:
    """Difference of rebuilt commands from logged outputs, us."""
    return np.inf if commands.check_us is None else commands.check_us


def _dynamic(recording: Recording, sensor: Sensor) -> Channel | None:
    found = [c for c in recording.dynamics if c.sensor == sensor and len(c) > 1]
    return max(found, key=len) if found else None


def _densities(recording: Recording) -> tuple[float, ...]:
    """Density ratios that the mixer may have corrected for: none, or the standard atmosphere's at the altitude."""
    places = recording.find(Sensor.POSITION)
    if not places:
        return (1.0,)
    altitude = float(np.median(places[0].values[:, 2]))
    ratio = (1.0 - 2.25577e-5 * altitude) ** 4.2561 if altitude < 11000.0 else 1.0  # ISA 1976
    return (1.0, float(np.clip(ratio, *_DENSITY)))


def _mixed(
    control: Channel, mixer: Channel, parameters: Mapping[str, float], geometry: Geometry, density: float
) -> MotorCommands:
    t = control.t
    lift, volt, limit = (np.interp(t, mixer.t, mixer.values[:, k]) for k in range(3))
    lift = np.where(lift > 0.1, lift, 1.0)
    volt = np.where(volt > 0.1, volt, 1.0)
    expo = float(np.clip(parameters.get("MOT_THST_EXPO", 0.65), -1.0, 1.0))
    turn = control.values[:, :3] @ mixer_factors(geometry).T
    thrust = (control.values[:, 3:] + turn) / (lift * density)[:, None]
    if abs(expo) < 1e-6:
        c = lift[:, None] * thrust / volt[:, None]
    else:
        inside = (1.0 - expo) ** 2 + 4.0 * expo * lift[:, None] * np.clip(thrust, 0.0, None)
        c = (expo - 1.0 + np.sqrt(np.clip(inside, 0.0, None))) / (2.0 * expo) / volt[:, None]
    limited = ((thrust <= 0.0) | (c >= 1.0)).any(axis=1) | (limit < 1.0 - _AT_LIMIT) | (np.ptp(turn, axis=1) > 1.0)
    return MotorCommands(t, np.clip(c, 0.0, 1.0), limited, "rate_mixer", None)


def _difference_us(made: MotorCommands, logged: MotorCommands, parameters: Mapping[str, float]) -> float:
    """Median difference at the logged samples while the motors run; the nearest row within two loops counts."""
    flying = (logged.c > _AT_LIMIT).all(axis=1)
    low, high = _spin_range(parameters)
    rows = np.clip(np.searchsorted(made.t, logged.t[flying]), 1, len(made.t) - 1)
    either = np.stack([np.abs(made.c[rows - k] - logged.c[flying]).max(axis=1) for k in (0, 1)])
    if not either.size:
        return float("inf")
    span = float(parameters.get("MOT_PWM_MAX", 2000.0)) - float(parameters.get("MOT_PWM_MIN", 1000.0))
    return float(np.median(either.min(axis=0)) * (high - low) * (span if span > 0.0 else PWM_SPAN_US))
