"""The columns of the interchange format: their names, units and frames."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Array, Sensor

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
REFERENCE_SI = {
    Sensor.ACCEL: "m/s2",
    Sensor.GYRO: "rad/s",
    Sensor.MAG: "uT",
    Sensor.ATTITUDE: "1",
    Sensor.PLACE: "m",
    Sensor.VELOCITY: "m/s",
}
"""Units of the ``ref_*`` columns, whatever the units of the sensors' own columns."""
FLIGHT: Mapping[Sensor, tuple[tuple[str, ...], str]] = {
    Sensor.VELOCITY: (("vel_n", "vel_e", "vel_d"), "m/s"),
    Sensor.ATTITUDE: (("q_w", "q_x", "q_y", "q_z"), "1"),
    Sensor.VOLTAGE: (("voltage",), "V"),
    Sensor.HEIGHT: (("height",), "m"),
    Sensor.AIR: (("pressure", "air_temperature"), "Pa degC"),
}
"""Columns of the vehicle's own flight data, and their units; the attitude is also a sensor column."""
TRIADS = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)
SINGLE = (Sensor.TEMPERATURE, Sensor.CURRENT, Sensor.THROTTLE)
CANONICAL = re.compile(
    r"(?P<triad>accel|gyro|mag)(?P<of>[1-9]?)_(?P<axis>[xyz])|(?P<one>temperature|current|throttle)(?P<nr>[1-9]?)"
    r"|(?P<many>motor|rotor_hz)_(?P<k>[1-9]\d?)|q_(?P<q>[wxyz])|t|segment"
    r"|vel_[ned]|voltage|height|pressure|air_temperature|ref_(?P<ref>accel|gyro|mag)_[xyz]|ref_(?P<refq>q)_[wxyz]|ref_(?P<refpath>pos|vel)_[ned]"
)
GROUP = re.compile(r"(ref_)?(accel|gyro|mag)|(accel|gyro|mag)[1-9]|(ref_)?q|ref_pos|ref_vel|motor|rotor_hz")
"""Names that stand for all of their columns in a mapping: ``accel=imu_acc`` is accel_x=imu_acc_0 and so on."""
_REFERENCE_STEMS = {Sensor.ATTITUDE: "q", Sensor.PLACE: "pos", Sensor.VELOCITY: "vel"}
FRD_FROM_FLU = np.array([1.0, -1.0, -1.0])


def column_names(sensor: Sensor, number: str, width: int) -> tuple[str, ...]:
    """Names of the `width` columns of a sensor; `number` is the suffix of the second and later instances."""
    if sensor in TRIADS:
        return tuple(f"{sensor}{number}_{axis}" for axis in "xyz")
    if sensor in SINGLE:
        return (f"{sensor}{number}",)
    if sensor == Sensor.ATTITUDE:
        return tuple(f"q_{part}" for part in "wxyz")
    return tuple(f"{numbered_prefix(sensor)}{k + 1}" for k in range(width))


def numbered_prefix(sensor: Sensor) -> str:
    """Prefix of the numbered columns of motors or rotors."""
    return "motor_" if sensor == Sensor.MOTOR else "rotor_hz_"


def reference_names(sensor: Sensor) -> tuple[str, ...]:
    """Names of the columns of a reference channel; empty for a sensor without reference columns."""
    if sensor not in REFERENCE_SI:
        return ()
    stem = _REFERENCE_STEMS.get(sensor, sensor.value)
    return tuple(f"ref_{stem}_{part}" for part in _parts(stem))


def reference_sensor(name: str) -> Sensor | None:
    """The sensor whose reference a canonical column holds; None if it holds none."""
    match = CANONICAL.fullmatch(name)
    if match is None or not (match["ref"] or match["refq"] or match["refpath"]):
        return None
    stems = {stem: sensor for sensor, stem in _REFERENCE_STEMS.items()}
    stem = match["ref"] or match["refq"] or match["refpath"]
    return stems.get(stem) or Sensor(stem)


def group_names(group: str, width: int) -> tuple[str, ...]:
    """The canonical columns that `group` stands for; `width` counts where the name does not (motors)."""
    if group in {"motor", "rotor_hz"}:
        return tuple(f"{group}_{k + 1}" for k in range(width))
    return tuple(f"{group}_{part}" for part in _parts(group.removeprefix("ref_")))


def _parts(stem: str) -> str:
    return {"q": "wxyz", "pos": "ned", "vel": "ned"}.get(stem, "xyz")


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
