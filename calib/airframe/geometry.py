"""Positions and directions of rotation of a multicopter's motors: ArduPilot's frames and PX4's rotors.

Positions are in arms (the longest is 1), since ``CA_ROTORn_P*`` need not be in metres. Sources: ``AP_MotorsMatrix.cpp``
(angles and yaw factors, clockwise from the nose), ``ActuatorEffectiveness``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.airframe.answer import Geometry, Motor

Array = NDArray[np.float64]
_CCW, _CW = 1, -1

_QUAD_X = ((45, _CCW), (-135, _CCW), (-45, _CW), (135, _CW))
_FRAMES: Final[Mapping[tuple[int, int], tuple[tuple[float, int], ...]]] = {
    (1, 0): ((90, _CCW), (-90, _CCW), (0, _CW), (180, _CW)),
    (1, 1): _QUAD_X,
    (1, 3): tuple((angle, -spin) for angle, spin in _QUAD_X),
    (1, 12): ((135, _CW), (45, _CCW), (-135, _CCW), (-45, _CW)),
    (1, 13): ((45, _CCW), (-45, _CW), (-135, _CCW), (135, _CW)),
    (1, 14): ((45, _CCW), (135, _CW), (-135, _CCW), (-45, _CW)),
    (1, 18): ((135, _CCW), (45, _CW), (-135, _CW), (-45, _CCW)),
    (2, 0): ((0, _CW), (180, _CCW), (-120, _CW), (60, _CCW), (-60, _CCW), (120, _CW)),
    (2, 1): ((90, _CW), (-90, _CCW), (-30, _CW), (150, _CCW), (30, _CCW), (-150, _CW)),
    (2, 13): ((30, _CCW), (-30, _CW), (-90, _CCW), (-150, _CW), (150, _CCW), (90, _CW)),
    (2, 14): ((30, _CCW), (90, _CW), (150, _CCW), (-150, _CW), (-90, _CCW), (-30, _CW)),
    (3, 0): (
        (0, _CW), (180, _CW), (45, _CCW), (135, _CCW), (-45, _CCW), (-135, _CCW), (-90, _CW), (90, _CW),
    ),
    (3, 1): (
        (22.5, _CW), (-157.5, _CW), (67.5, _CCW), (157.5, _CCW), (-22.5, _CCW), (-112.5, _CCW), (-67.5, _CW),
        (112.5, _CW),
    ),
}  # fmt: skip
"""By FRAME_CLASS and FRAME_TYPE: each motor's angle from the nose, degrees clockwise, and its direction of rotation."""
_CLASSES: Final = {1: "quad", 2: "hexa", 3: "octa"}
_TYPES: Final = {
    0: "plus",
    1: "x",
    3: "h",
    12: "betaflight x",
    13: "dji x",
    14: "clockwise x",
    18: "betaflight x reversed",
}
_MOST: Final = 8
NAMED: Final[Mapping[str, tuple[int, int]]] = {
    f"{_CLASSES[c]}-{_TYPES[t].replace(' ', '-')}": (c, t) for c, t in _FRAMES
}
"""Frames that a user can state."""


def geometry_of(parameters: Mapping[str, float], frame: str | None = None) -> Geometry | None:
    """The frame from the parameters, or as stated by the user; None: neither gives a frame that is modelled here."""
    if frame is not None:
        return _listed(*NAMED[frame], "user") if frame in NAMED else None
    if "CA_ROTOR_COUNT" in parameters:
        return _rotors(parameters)
    if "FRAME_CLASS" in parameters:
        key = int(parameters["FRAME_CLASS"]), int(parameters.get("FRAME_TYPE", 1))
        return _listed(*key, "parameters") if key in _FRAMES else None
    if "FRAME" in parameters:  # before 3.5; its class is what was built, and a quad drives four outputs
        kind = int(parameters["FRAME"])
        return _listed(1, kind, "parameters") if (1, kind) in _FRAMES else None
    return None


def _listed(frame_class: int, frame_type: int, source: str) -> Geometry:
    motors = tuple(
        Motor(round(math.cos(math.radians(a)), 6), round(math.sin(math.radians(a)), 6), spin)
        for a, spin in _FRAMES[frame_class, frame_type]
    )
    return Geometry(_CLASSES[frame_class], _TYPES[frame_type], motors, source)


def _rotors(parameters: Mapping[str, float]) -> Geometry | None:
    """Rotors of PX4's allocation; None if one is tilted, or if there are too few or too many."""
    count = int(parameters["CA_ROTOR_COUNT"])
    if not 3 < count <= _MOST or int(parameters.get("CA_AIRFRAME", 0)) != 0:
        return None
    rotors = []
    for n in range(count):
        x, y = (float(parameters.get(f"CA_ROTOR{n}_P{axis}", 0.0)) for axis in "XY")
        lean = tuple(float(parameters.get(f"CA_ROTOR{n}_A{axis}", 0.0)) for axis in "XY")
        if any(lean) or not (x or y):
            return None
        rotors.append((x, y, _CCW if parameters.get(f"CA_ROTOR{n}_KM", 0.05) > 0.0 else _CW))
    arm = max(math.hypot(x, y) for x, y, _ in rotors)
    motors = tuple(Motor(round(x / arm, 6), round(y / arm, 6), spin) for x, y, spin in rotors)
    name = {4: "quad", 6: "hexa", 8: "octa"}.get(count, f"{count} rotors")
    return Geometry(name, "rotors of the allocation", motors, "parameters")


def arms(motors: Sequence[Motor]) -> tuple[Array, Array, Array]:
    """Positions forward and right, in arms, and directions of rotation of the motors, (n,) each."""
    return tuple(np.array([getattr(m, name) for m in motors], dtype=np.float64) for name in ("x", "y", "spin"))  # type: ignore[return-value]


def mixer_factors(geometry: Geometry) -> Array:
    """Factors (n, 3) of roll, pitch and yaw in ArduPilot's mixer, each normalised to at most 0.5."""
    x, y, spin = arms(geometry.motors)
    factors = np.column_stack([-y, x, spin])
    return np.asarray(0.5 * factors / np.abs(factors).max(axis=0))
