"""The airframe's numbers under the key names of ArduPilot SITL's frame files, and where its motors sit.

Key names, defaults and formulas: ``SIM_Frame.h``, ``SIM_Frame.cpp``. Keys that SITL does not have are ``motorTau`` and
``groundRadius``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from mavcal.service.simvehicle.errors import ConfigurationError

GRAVITY = 9.80665
CLOCKWISE, COUNTER_CLOCKWISE = -1.0, 1.0
"""Factors of the reaction about +z: a propeller that turns counter-clockwise turns the vehicle clockwise."""
PLUS, X = 0, 1
"""FRAME_TYPE."""
MOTORS = 4
_ANGLES = {PLUS: (90.0, -90.0, 0.0, 180.0), X: (45.0, -135.0, -45.0, 135.0)}
"""Degrees from ahead, clockwise, in the order of the outputs (``AP_MotorsMatrix.cpp``)."""
_SPINS = (COUNTER_CLOCKWISE, COUNTER_CLOCKWISE, CLOCKWISE, CLOCKWISE)
YAW_PER_THRUST = 0.05
"""Yaw torque by thrust and diagonal (``SIM_Motor.cpp``)."""

Vector = tuple[float, float, float]


def _key(name: str, default: float) -> Any:
    return field(default=default, metadata={"key": name})


@dataclass(frozen=True)
class Frame:
    """Contents of a frame file; each field has SITL's key in its metadata. Units: SI, deg where SITL has degrees."""

    mass: float = _key("mass", 3.0)
    diagonal_size: float = _key("diagonal_size", 0.35)
    reference_speed: float = _key("refSpd", 15.08)
    reference_angle: float = _key("refAngle", 45.0)
    reference_voltage: float = _key("refVoltage", 12.09)
    reference_current: float = _key("refCurrent", 29.3)
    reference_altitude: float = _key("refAlt", 593.0)
    reference_temperature: float = _key("refTempC", 25.0)
    battery_resistance: float = _key("refBatRes", 0.01)
    full_voltage: float = _key("maxVoltage", 12.6)
    battery_capacity: float = _key("battCapacityAh", 0.0)
    hover_throttle: float = _key("hoverThrOut", 0.39)
    expo: float = _key("propExpo", 0.65)
    reference_turn_rate: float = _key("refRotRate", 120.0)
    pwm_min: float = _key("pwmMin", 1000.0)
    pwm_max: float = _key("pwmMax", 2000.0)
    spin_min: float = _key("spin_min", 0.15)
    spin_max: float = _key("spin_max", 0.95)
    slew_max: float = _key("slew_max", 150.0)
    disc_area: float = _key("disc_area", 0.385)
    momentum_drag: float = _key("mdrag_coef", 0.2)
    motors: float = _key("num_motors", 4.0)
    motor_tau: float = _key("motorTau", 0.0)
    ground_radius: float = _key("groundRadius", 0.0)
    moment_of_inertia: Vector = (0.0, 0.0, 0.0)
    positions: Mapping[int, Vector] = field(default_factory=dict)
    yaw_factors: Mapping[int, float] = field(default_factory=dict)
    """By motor from 1; a position or a factor of zero means the default (``SIM_Frame.cpp``)."""

    @property
    def inertia(self) -> Vector:
        """Moments of inertia, kg m2; of a disc of the diagonal where the file says zero."""
        x, y, z = self.moment_of_inertia
        disc = self.mass * (0.5 * self.diagonal_size) ** 2
        return x or 0.25 * disc, y or 0.25 * disc, z or 0.5 * disc


_SCALARS = {f.metadata["key"]: f.name for f in fields(Frame) if "key" in f.metadata}
_POSITIVE = ("mass", "diagonal_size", "hoverThrOut", "refSpd", "maxVoltage", "slew_max", "disc_area")


def load_frame(path: str | Path) -> Frame:
    """The frame in a JSON file. Raises ConfigurationError with what is wrong."""
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
        bare = "\n".join(line.partition("#")[0] for line in lines)  # SITL's own frame files have comments
        document = json.loads(bare.strip() or "{}")
    except OSError as error:
        raise ConfigurationError(f"frame file {path} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ConfigurationError(f"frame file {path} is no JSON: {error}") from error
    if not isinstance(document, dict):
        raise ConfigurationError(f"frame file {path} must hold one object of keys and numbers")
    return frame_of(document)


def frame_of(document: Mapping[str, Any]) -> Frame:
    """The frame of an object with SITL's keys. Raises ConfigurationError for an unknown key or an impossible value."""
    scalars: dict[str, Any] = {}
    inertia: Vector = (0.0, 0.0, 0.0)
    positions: dict[int, Vector] = {}
    factors: dict[int, float] = {}
    for key, value in document.items():
        motor, what = _of_motor(key)
        if key in _SCALARS:
            scalars[_SCALARS[key]] = _number(key, value)
        elif key == "moment_inertia":
            inertia = _vector(key, value)
        elif what == "position":
            positions[motor] = _vector(key, value)
        elif what == "yaw":
            factors[motor] = _number(key, value)
        else:
            raise ConfigurationError(
                f"frame: no key {key!r}; known are {', '.join(_SCALARS)}, moment_inertia, motorN_position, motorN_yaw"
            )
    frame = replace(Frame(**scalars), moment_of_inertia=inertia, positions=positions, yaw_factors=factors)
    for key in _POSITIVE:
        if not getattr(frame, _SCALARS[key]) > 0.0:
            raise ConfigurationError(f"frame: {key} is {getattr(frame, _SCALARS[key]):g}; it must be above zero")
    if int(frame.motors) != MOTORS:
        raise ConfigurationError(f"frame: num_motors is {frame.motors:g}; only frames of {MOTORS} motors fly here")
    return frame


def _of_motor(key: str) -> tuple[int, str]:
    """Number and quantity of ``motorN_position``; 0 for other keys."""
    stem, _, what = key.partition("_")
    digits = stem.removeprefix("motor")
    known = stem.startswith("motor") and digits.isdigit() and 1 <= int(digits) <= MOTORS
    return (int(digits), what) if known else (0, "")


def _number(key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigurationError(f"frame: {key} must be a number, got {value!r}")
    return float(value)


def _vector(key: str, value: object) -> Vector:
    if not isinstance(value, list) or len(value) != 3:
        raise ConfigurationError(f"frame: {key} must be three numbers, got {value!r}")
    x, y, z = (_number(key, one) for one in value)
    return x, y, z


@dataclass(frozen=True)
class Rotor:
    """One motor: angle that the mixer assumes, true position from the centre of mass (m), yaw factor."""

    angle: float
    spin: float
    position: Vector
    yaw_factor: float


def rotors_of(frame: Frame, frame_type: int) -> tuple[Rotor, ...]:
    """The motors in the order of their outputs. Raises ConfigurationError for a FRAME_TYPE that is not plus or X."""
    if frame_type not in _ANGLES:
        raise ConfigurationError(f"FRAME_TYPE {frame_type} does not fly here: 0 (plus) or 1 (X)")
    found = []
    for number, (degrees, spin) in enumerate(zip(_ANGLES[frame_type], _SPINS, strict=True), start=1):
        angle, arm = math.radians(degrees), frame.diagonal_size  # the whole diagonal, as SITL takes it
        given = frame.positions.get(number, (0.0, 0.0, 0.0))
        place = given if any(given) else (arm * math.cos(angle), arm * math.sin(angle), 0.0)
        found.append(Rotor(angle, spin, place, frame.yaw_factors.get(number) or spin))
    return tuple(found)
