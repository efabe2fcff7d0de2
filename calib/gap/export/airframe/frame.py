"""The frame of ArduPilot's simulated multicopter: its file, and the physics behind its keys (AIRFRAME 4.1).

A key is not one physical quantity. The thrust at full command over mass is ``g / hoverThrOut``. The rotors' drag is
``mdrag_coef sqrt(density disc_area T)``. The rest of a reference flight's drag (``refSpd``, ``refAngle``) is that of
the body. One key therefore changes several effects, and all keys are solved together for a wanted set of effects.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.airframe.answer import Geometry
from mavcal.calib.errors import InvalidInputError

Array = NDArray[np.float64]

DEFAULTS: Mapping[str, float] = {
    "mass": 3.0,
    "diagonal_size": 0.35,
    "num_motors": 4.0,
    "disc_area": 0.385,
    "mdrag_coef": 0.2,
    "bbdrag_coef": 1.0,
    "refSpd": 15.08,
    "refAngle": 45.0,
    "refVoltage": 12.09,
    "refCurrent": 29.3,
    "refAlt": 593.0,
    "refBatRes": 0.01,
    "maxVoltage": 12.6,
    "battCapacityAh": 0.0,
    "hoverThrOut": 0.39,
    "propExpo": 0.65,
    "refRotRate": 120.0,
    "pwmMin": 1000.0,
    "pwmMax": 2000.0,
    "spin_min": 0.15,
    "spin_max": 0.95,
    "slew_max": 150.0,
}
"""Values of the simulator for keys missing in its file. Source: ArduPilot's SIM_Frame.h, 4.7."""
PARAMETERS: Mapping[str, str] = {
    "mass": "SIM_FRM_MASS",
    "mdrag_coef": "SIM_FRM_MDRAG",
    "bbdrag_coef": "SIM_FRM_BBDRAG",
}
"""Keys that are parameters of newer simulators (ArduPilot #33951); a parameter is preferred where the log has it."""
OWN_DAMPING = math.radians(400.0)
"""Own damping times ``refRotRate``, rad/s times deg/s. Source: ArduPilot's SIM_Frame.cpp."""
PULSE_ZERO = 1000.0
"""Pulse, us, that SIM_ENGINE_MUL leaves unchanged. Source: ArduPilot's SITL_State.cpp."""
_LAPSE, _TEMPERATURE, _POWER, _SEA_LEVEL = 0.0065, 288.15, 4.2559, 1.225
"""Fall of the temperature, K/m, its value at sea level, K, the power of density, and density there, kg/m3. Source:
standard atmosphere of 1976."""


@dataclass(frozen=True)
class Frame:
    """Every key of a frame with a value; `motors` are those with a position in its file or in the geometry."""

    keys: Mapping[str, float]
    inertia: tuple[float, float, float]
    motors: tuple[FrameMotor, ...] = ()

    def __getitem__(self, key: str) -> float:
        return self.keys[key]

    @property
    def arm(self) -> float:
        """The longest arm, m: the simulator uses the whole of ``diagonal_size`` as its length."""
        return max((math.hypot(m.position[0], m.position[1]) for m in self.motors), default=self["diagonal_size"])

    @property
    def thrust(self) -> float:
        """Thrust at full command over mass, m/s2, at the reference density and full voltage."""
        return STANDARD_GRAVITY / self["hoverThrOut"]

    @property
    def momentum(self) -> float:
        """Rotor drag in the reference flight over its speed, N s/m."""
        cosine = math.cos(math.radians(self["refAngle"]))
        pull = self["mass"] * STANDARD_GRAVITY / cosine
        air = density_of(self["refAlt"]) * self["disc_area"]
        return cosine**2 * self["mdrag_coef"] * math.sqrt(pull * air)

    @property
    def reference_drag(self) -> float:
        """Drag that balances the tilt of the reference flight, N."""
        return self["mass"] * STANDARD_GRAVITY * math.tan(math.radians(self["refAngle"]))

    @property
    def mdrag(self) -> float:
        """Effective ``mdrag_coef``: limited where the rotors alone would exceed the drag of the reference flight."""
        most, drag = self.reference_drag, self.momentum * self["refSpd"]
        return self["mdrag_coef"] * (most / drag if drag > most else 1.0)

    @property
    def body(self) -> float:
        """Drag of the body over the square of the speed, N s2/m2, at the reference density."""
        left = self.reference_drag - self.momentum * self["refSpd"]
        return self["bbdrag_coef"] * max(0.0, left) / self["refSpd"] ** 2

    @property
    def rotor_drag(self) -> float:
        """Linear rotor drag c_1, 1/s, at hover and the reference density; the same along all axes."""
        air = density_of(self["refAlt"]) * self["disc_area"]
        return self.mdrag * math.sqrt(air * STANDARD_GRAVITY / self["mass"])

    @property
    def rotor_damping(self) -> Array:
        """Damping (3,), 1/s, at hover, from the drag of the rotors as their arms move (AIRFRAME 8)."""
        return np.asarray(self.rotor_drag * self["mass"] * self._spread() / np.array(self.inertia))

    @property
    def own_damping(self) -> float:
        """Damping of ``refRotRate``, 1/s, equal about all axes."""
        return OWN_DAMPING / self["refRotRate"] if self["refRotRate"] > 0.0 else 0.0

    def hover_thrust(self, voltage: float) -> float:
        """Thrust at hover as part of that at full command, at `voltage`."""
        return self["hoverThrOut"] * (self["maxVoltage"] / voltage) ** 2

    def _spread(self) -> Array:
        """Mean square distance (3,) of the motors from each axis, m2; on a ring if their positions are unknown."""
        if not self.motors:
            half = 0.5 * self["diagonal_size"] ** 2
            return np.array([half, half, 2.0 * half])
        squares = np.array([m.position for m in self.motors]) ** 2
        return np.asarray((squares.sum(axis=1, keepdims=True) - squares).mean(axis=0))


@dataclass(frozen=True)
class FrameMotor:
    """Position, m, forward right down, and yaw factor (+1: torque about +z; 0: not known) of a motor."""

    position: tuple[float, float, float]
    yaw: float


def density_of(altitude: float) -> float:
    """Air density, kg/m3, of the standard atmosphere at `altitude` (m) in the troposphere."""
    return float(_SEA_LEVEL * (1.0 - _LAPSE * altitude / _TEMPERATURE) ** _POWER)


def frame_from_text(text: str) -> dict[str, Any]:
    """The keys of a frame file; ``#`` begins a comment, as in the simulator's own files.

    Raises
    ------
    InvalidInputError
        If it is no JSON object, or a key has a value that the simulator cannot take.
    """
    bare = "\n".join(line.split("#", 1)[0] for line in text.splitlines())
    try:
        found = json.loads(bare)
    except json.JSONDecodeError as error:
        raise InvalidInputError(f"the simulator's frame is no JSON: {error}") from error
    if not isinstance(found, dict):
        raise InvalidInputError("the simulator's frame is no JSON object with keys such as mass and hoverThrOut")
    frame_of(found, {})
    return found


def frame_of(file: Mapping[str, Any] | None, simulator: Mapping[str, float], geometry: Geometry | None = None) -> Frame:
    """The simulator's frame as it was flown.

    Parameters
    ----------
    file
        Keys of its file; None: the stock frame.
    simulator
        Parameters of its log; SIM_FRM_* override the file.
    geometry
        Gives motor positions that the file lacks; None: unknown.

    Raises
    ------
    InvalidInputError
        If a key is no finite number, or a quantity that must be positive is not.
    """
    given = file or {}
    keys = {key: _number(given, key, default) for key, default in DEFAULTS.items()}
    keys |= {key: float(simulator[name]) for key, name in PARAMETERS.items() if name in simulator}
    for key in ("mass", "diagonal_size", "disc_area", "refSpd", "refAngle", "hoverThrOut", "maxVoltage"):
        if not keys[key] > 0.0:
            raise InvalidInputError(f"{key} of the simulator's frame is {keys[key]:g}: it must be above 0")
    stated = _vector(given, "moment_inertia")
    ring = keys["mass"] * (0.5 * keys["diagonal_size"]) ** 2
    inertia = stated if stated is not None and all(stated) else (0.25 * ring, 0.25 * ring, 0.5 * ring)
    return Frame(keys, inertia, _motors(given, keys, geometry))


def _motors(given: Mapping[str, Any], keys: Mapping[str, float], geometry: Geometry | None) -> tuple[FrameMotor, ...]:
    count = int(keys["num_motors"]) if geometry is None else len(geometry.motors)
    found = []
    for n in range(count):
        place, yaw = _vector(given, f"motor{n + 1}_position"), _number(given, f"motor{n + 1}_yaw", 0.0)
        known = None if geometry is None else geometry.motors[n]
        if place is None or not any(place):  # the simulator takes zeros for "as the frame has it"
            if known is None:
                return ()
            place = (known.x * keys["diagonal_size"], known.y * keys["diagonal_size"], 0.0)
        found.append(FrameMotor(place, yaw or (0.0 if known is None else float(known.spin))))
    return tuple(found)


def _number(given: Mapping[str, Any], key: str, default: float) -> float:
    value = given.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InvalidInputError(f"{key} of the simulator's frame is {value!r}: it must be a number")
    return float(value)


def _vector(given: Mapping[str, Any], key: str) -> tuple[float, float, float] | None:
    value = given.get(key)
    if value is None:
        return None
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise InvalidInputError(f"{key} of the simulator's frame is {value!r}: it must be three numbers")
    x, y, z = (_number({key: v}, key, 0.0) for v in value)
    return x, y, z
