"""The columns of the interchange format: their names, units and frames."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from calib import STANDARD_GRAVITY
from calib.errors import InvalidInputError
from calib.recording import Channel, Sensor

Array = NDArray[np.float64]

UNITS: Mapping[Sensor, Mapping[str, float]] = {
    Sensor.ACCEL: {"si": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY, "counts": 1.0},
    Sensor.GYRO: {"si": 1.0, "deg/s": np.pi / 180.0, "mrad/s": 1e-3, "counts": 1.0},
    Sensor.MAG: {"uT": 1.0, "si": 1.0, "mgauss": 0.1, "gauss": 100.0, "counts": 1.0},
}
"""Factors to the unit of the contract; counts stay counts."""

SI = {
    Sensor.ACCEL: "m/s2",
    Sensor.GYRO: "rad/s",
    Sensor.MAG: "uT",
    Sensor.TEMPERATURE: "degC",
    Sensor.CURRENT: "A",
    Sensor.THROTTLE: "1",
    Sensor.MOTOR: "1",
    Sensor.ROTOR_SPEED: "Hz",
    Sensor.ATTITUDE: "1",
}
TRIADS = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)
SINGLE = (Sensor.TEMPERATURE, Sensor.CURRENT, Sensor.THROTTLE)
CANONICAL = re.compile(
    r"(?P<triad>accel|gyro|mag)(?P<of>[1-9]?)_(?P<axis>[xyz])|(?P<one>temperature|current|throttle)(?P<nr>[1-9]?)"
    r"|(?P<many>motor|rotor_hz)_(?P<k>[1-9]\d?)|q_(?P<q>[wxyz])|t|segment"
    r"|ref_(accel|gyro|mag)_[xyz]|ref_q_[wxyz]|ref_pos_[ned]|ref_vel_[ned]"
)
FRD_FROM_FLU = np.array([1.0, -1.0, -1.0])


def column_names(channel: Channel) -> tuple[str, ...]:
    """What the columns of `channel` are called."""
    number = "" if channel.instance == 0 else str(channel.instance + 1)
    if channel.sensor in TRIADS:
        return tuple(f"{channel.sensor}{number}_{axis}" for axis in "xyz")
    if channel.sensor in SINGLE:
        return (f"{channel.sensor}{number}",)
    if channel.sensor == Sensor.ATTITUDE:
        return tuple(f"q_{part}" for part in "wxyz")
    prefix = "motor" if channel.sensor == Sensor.MOTOR else "rotor_hz"
    return tuple(f"{prefix}_{k + 1}" for k in range(channel.values.shape[1]))


def ned_from_frd(q: Array, *, body: str, world: str) -> Array:
    """Unit quaternions (N, 4) body to north-east-down, from those of the file's frames.

    With ENU = (y, x, -z) of NED, a turn by pi about (1, 1, 0); FLU is FRD turned by pi about x.
    """
    size = np.linalg.norm(q, axis=1)
    if (np.abs(size - 1.0) > 0.05).any():
        row = int(np.argmax(np.abs(size - 1.0)))
        raise InvalidInputError(
            f"q_w,q_x,q_y,q_z of sample {row + 1} have length {size[row]:.3g}: quaternions have length 1"
        )
    q = q / size[:, None]
    if world == "enu":
        q = _product(np.array([[0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0]]), q)
    if body == "flu":
        q = _product(q, np.array([[0.0, 1.0, 0.0, 0.0]]))
    return q


def _product(p: Array, q: Array) -> Array:
    """Hamilton's product of quaternions w x y z."""
    pw, pv, qw, qv = p[:, :1], p[:, 1:], q[:, :1], q[:, 1:]
    w = pw * qw - (pv * qv).sum(axis=1, keepdims=True)
    return np.hstack([w, pw * qv + qw * pv + np.cross(pv, qv)])
