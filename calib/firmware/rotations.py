"""Mounting rotations by number, as the two firmwares define them.

A number stands for Euler angles roll, pitch, yaw in degrees. ``R = Rz(yaw) Ry(pitch) Rx(roll)`` takes vectors of the
turned sensor to the body. Both firmwares share the numbers 0 to 40 (MAVLink ``MAV_SENSOR_ORIENTATION``); beyond, they
differ (ArduPilot ``AP_Math/rotations.h``, PX4 ``lib/conversion/rotation.h``).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.names import ARDUPILOT_CUSTOM, PX4_CUSTOM

Array = NDArray[np.float64]
Euler = tuple[float, float, float]

_SHARED: Final[tuple[Euler, ...]] = (
    *((0.0, 0.0, 45.0 * k) for k in range(8)),  # 0-7
    *((180.0, 0.0, 45.0 * k) for k in range(4)),  # 8-11
    (0.0, 180.0, 0.0),  # 12, where the row above would have roll 180 yaw 180
    *((180.0, 0.0, 45.0 * k) for k in range(5, 8)),  # 13-15
    *((90.0, 0.0, 45.0 * k) for k in range(4)),  # 16-19
    *((270.0, 0.0, 45.0 * k) for k in range(4)),  # 20-23
    (0.0, 90.0, 0.0),  # 24
    (0.0, 270.0, 0.0),
    (0.0, 180.0, 90.0),
    (0.0, 180.0, 270.0),
    (90.0, 90.0, 0.0),  # 28
    (180.0, 90.0, 0.0),
    (270.0, 90.0, 0.0),
    (90.0, 180.0, 0.0),
    (270.0, 180.0, 0.0),  # 32
    (90.0, 270.0, 0.0),
    (180.0, 270.0, 0.0),
    (270.0, 270.0, 0.0),
    (90.0, 180.0, 90.0),  # 36
    (90.0, 0.0, 270.0),
)

_ARDUPILOT_MORE: Final[tuple[Euler, ...]] = (
    (90.0, 68.8, 293.3),  # 38, the angles of the matrix in AP_Math/vector3.cpp
    (0.0, 315.0, 0.0),
    (90.0, 315.0, 0.0),
    (0.0, 7.0, 0.0),  # 41
    (45.0, 0.0, 0.0),
    (315.0, 0.0, 0.0),
)

_PX4_MORE: Final[tuple[Euler, ...]] = (
    (90.0, 68.0, 293.0),  # 38, whole degrees in PX4's table
    (0.0, 315.0, 0.0),
    (90.0, 315.0, 0.0),
    (270.0, 0.0, 180.0),  # 41
    (270.0, 0.0, 270.0),
    (0.0, 90.0, 180.0),
    (0.0, 9.0, 180.0),
    (0.0, 45.0, 0.0),  # 45
    (270.0, 0.0, 225.0),
    (270.0, 0.0, 315.0),
)

ROTATIONS: Final[Mapping[str, tuple[Euler, ...]]] = MappingProxyType(
    {"ardupilot": _SHARED + _ARDUPILOT_MORE, "px4": _SHARED + _PX4_MORE}
)
"""Roll, pitch, yaw in degrees by autopilot and number."""


def euler_matrix(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Array:
    """``Rz(yaw) Ry(pitch) Rx(roll)``, shape (3, 3), angles in degrees; right angles are exact."""
    return _euler_matrix(roll_deg, pitch_deg, yaw_deg).copy()


@lru_cache(maxsize=256)
def _euler_matrix(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Array:
    c = [_exact(np.cos(np.radians(a))) for a in (roll_deg, pitch_deg, yaw_deg)]
    s = [_exact(np.sin(np.radians(a))) for a in (roll_deg, pitch_deg, yaw_deg)]
    rx = np.array([[1.0, 0.0, 0.0], [0.0, c[0], -s[0]], [0.0, s[0], c[0]]])
    ry = np.array([[c[1], 0.0, s[1]], [0.0, 1.0, 0.0], [-s[1], 0.0, c[1]]])
    rz = np.array([[c[2], -s[2], 0.0], [s[2], c[2], 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(rz @ ry @ rx, dtype=np.float64)


def rotation_words(autopilot: str, number: int) -> str:
    """A rotation in words.

    >>> rotation_words("ardupilot", 6), rotation_words("px4", 10), rotation_words("px4", 0)
    ('yaw 270', 'roll 180, yaw 90', 'none')
    >>> rotation_words("ardupilot", 102), rotation_words("px4", 100)
    ('custom rotation 2', 'custom angles')
    """
    if number in ARDUPILOT_CUSTOM and autopilot == "ardupilot":
        return f"custom rotation {number - 100}"
    if number == PX4_CUSTOM and autopilot == "px4":
        return "custom angles"
    table = ROTATIONS[autopilot]
    if not 0 <= number < len(table):
        return "not in the table"
    parts = [f"{word} {angle:g}" for word, angle in zip(("roll", "pitch", "yaw"), table[number], strict=True) if angle]
    return ", ".join(parts) or "none"


def rotation_matrix(autopilot: str, number: int) -> Array:
    """``R_body_from_sensor`` of rotation `number`, shape (3, 3).

    Raises
    ------
    FirmwareError
        If the autopilot has no rotation of that number.
    """
    table = ROTATIONS[autopilot]
    if not 0 <= number < len(table):
        raise FirmwareError(
            f"mounting rotation {number} is none of {autopilot}'s 0 to {len(table) - 1}; "
            "set the rotation of the board or sensor first"
        )
    return euler_matrix(*table[number])


def nearest_rotation(autopilot: str, body_from_sensor: Array) -> tuple[int, float]:
    """Number of the table's rotation next to `body_from_sensor`, and the angle between them in rad.

    When two numbers mean the same rotation, the smaller one is returned.
    """
    angles = [
        rotation_angle(rotation_matrix(autopilot, n).T @ body_from_sensor) for n in range(len(ROTATIONS[autopilot]))
    ]
    best = int(np.argmin(np.round(angles, 9)))
    return best, float(angles[best])


def rotation_angle(rotation: Array) -> float:
    """Angle of a rotation matrix, rad; exact for small angles too."""
    # atan2 of sine and cosine: exact near 0, where arccos loses half of the digits
    skew = rotation - rotation.T
    sine = 0.5 * float(np.linalg.norm([skew[2, 1], skew[0, 2], skew[1, 0]]))
    return float(np.arctan2(sine, 0.5 * (float(np.trace(rotation)) - 1.0)))


def _exact(value: float) -> float:
    nearest = round(value)
    return float(nearest) if abs(value - nearest) < 1e-12 else float(value)
