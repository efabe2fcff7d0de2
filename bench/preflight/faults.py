"""The faults, each with the checks that are right to fail."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.preflight.vehicle import BenchVehicle, about
from mavcal.calib.firmware.plan import Value
from mavcal.calib.preflight.check import CheckId
from mavcal.calib.preflight.snapshot import Shaking

Array = NDArray[np.float64]

CUBE_AM2 = 0.95
"""Moment of a neodymium cube of 10 mm (remanence 1.2 T)."""
TURNED_DEG = 15.0
"""A bent mount counts from here on: dip or heading of the field, as the compass has it, is off by as much."""


@dataclass(frozen=True)
class Fault:
    """A fault in words, what does it, and which check is right to fail (any of them, but one)."""

    name: str
    words: str
    do: Callable[[BenchVehicle], None]
    right: frozenset[CheckId]


def _direction(rng: np.random.Generator) -> Array:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def _pick(vehicle: BenchVehicle, count: int) -> int:
    return int(vehicle.rng.integers(count))


def magnet(vehicle: BenchVehicle) -> None:
    """The cube at 3 to 6 cm of one compass; the other compasses are 15 to 40 cm away from that."""
    rng, near = vehicle.rng, _pick(vehicle, len(vehicle.mag_errors))
    moment = CUBE_AM2 * _direction(rng)
    place = rng.uniform(0.03, 0.06) * _direction(rng)
    for i in range(len(vehicle.mag_errors)):
        compass = np.zeros(3) if i == near else rng.uniform(0.15, 0.40) * _direction(rng)
        vehicle.mag_errors[i] = vehicle.mag_errors[i] + _dipole(moment, compass - place)
    vehicle.texts = ("PreArm: Check mag field (xy diff:210>100)",) if vehicle.autopilot == "ardupilot" else ()


def weak_magnet(vehicle: BenchVehicle) -> None:
    """20 to 60 uT in any direction at one compass."""
    i = _pick(vehicle, len(vehicle.mag_errors))
    vehicle.mag_errors[i] = vehicle.mag_errors[i] + vehicle.rng.uniform(20.0, 60.0) * _direction(vehicle.rng)


def _dipole(moment: Array, r: Array) -> Array:
    distance = float(np.linalg.norm(r))
    unit = r / distance
    return np.asarray(0.1 * (3.0 * (moment @ unit) * unit - moment) / distance**3)  # uT


def bent_mount(vehicle: BenchVehicle) -> None:
    """A mast that folded by 15 to 50 deg to any side, or was twisted by as much."""
    rng, i = vehicle.rng, _pick(vehicle, len(vehicle.mag_errors))
    body = vehicle.body_from_ned
    while True:
        twisted = bool(rng.integers(2))
        level = rng.normal(size=3) * (1.0, 1.0, 0.0)
        axis = body @ (np.array([0.0, 0.0, 1.0]) if twisted else level)
        turn = about(axis, np.radians(rng.uniform(15.0, 50.0)) * rng.choice([-1.0, 1.0]))
        before = vehicle.field.north_east_down
        after = body.T @ turn @ body @ before
        if max(abs(_dip(after) - _dip(before)), abs(_between(after, before))) > np.radians(TURNED_DEG):
            vehicle.mag_turns[i] = turn @ vehicle.mag_turns[i]
            return


def _dip(v: Array) -> float:
    return float(np.arctan2(v[2], np.hypot(v[0], v[1])))


def _between(a: Array, b: Array) -> float:
    return float(np.arctan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1]))


def accel_off(vehicle: BenchVehicle) -> None:
    """One accelerometer 0.3 m/s2 off, in any direction."""
    i = _pick(vehicle, vehicle.imus)
    vehicle.accel_errors[i] = vehicle.accel_errors[i] + 0.3 * _direction(vehicle.rng)


def gyro_wandered(vehicle: BenchVehicle) -> None:
    """One gyroscope 1 to 3 deg/s off since its calibration."""
    i = _pick(vehicle, vehicle.imus)
    off = np.radians(vehicle.rng.uniform(1.0, 3.0)) * _direction(vehicle.rng)
    vehicle.gyro_errors[i] = vehicle.gyro_errors[i] + off


def swapped_board(vehicle: BenchVehicle) -> None:
    """Another autopilot with the parameters of the old one: other chips, with errors of their own."""
    vehicle.uid = "deadbeef"
    _uncalibrated(vehicle)
    if vehicle.rng.integers(2):  # of another type: other ids; else an equal board, which only its unique id betrays
        for name, value in vehicle.parameters.items():
            if name.endswith("_ID") and value:
                vehicle.parameters[name] = int(value) + 65536
    vehicle.texts = ("PreArm: 3D Accel calibration needed",) if vehicle.autopilot == "ardupilot" else ()


def _uncalibrated(vehicle: BenchVehicle) -> None:
    """Errors of parts as they come from the factory (the simulated vehicle's truth)."""
    rng = vehicle.rng
    for i in range(vehicle.imus):
        vehicle.accel_errors[i] = rng.uniform(0.1, 0.4, 3) * rng.choice([-1.0, 1.0], 3)
        vehicle.gyro_errors[i] = rng.uniform(5e-3, 30e-3, 3) * rng.choice([-1.0, 1.0], 3)
    for i in range(len(vehicle.mag_errors)):
        vehicle.mag_errors[i] = rng.uniform(3.0, 12.0, 3) * rng.choice([-1.0, 1.0], 3)


def out_of_temperature(vehicle: BenchVehicle) -> None:
    """All units 8 to 25 degC warmer or colder than anything that was calibrated; they drift by up to 0.01 a degC."""
    rng = vehicle.rng
    middle = float(vehicle.parameters.get("INS_ACC1_CALTEMP", vehicle.verified.temperatures[0]))
    half = 25.0 if any(name.endswith(("TCAL1_ENABLE", "TC_A_ENABLE")) for name in vehicle.parameters) else 20.0
    if vehicle.autopilot == "px4" and half == 25.0:
        middle = 0.5 * float(vehicle.parameters["TC_A0_TMIN"] + vehicle.parameters["TC_A0_TMAX"])
    outside = float(rng.uniform(8.0, 25.0))
    sign = float(rng.choice([-1.0, 1.0]))
    for i in range(vehicle.imus):
        vehicle.temperatures[i] = middle + sign * (half + outside) + float(rng.uniform(-1.0, 1.0))
        vehicle.accel_errors[i] = vehicle.accel_errors[i] + outside * rng.uniform(-0.01, 0.01, 3)
        vehicle.gyro_errors[i] = vehicle.gyro_errors[i] + np.radians(outside * rng.uniform(-0.05, 0.05, 3))


def firmware_reset(vehicle: BenchVehicle) -> None:
    """An update that put the calibration back to its defaults."""
    keep: dict[str, Value] = {}
    for name, value in vehicle.parameters.items():
        found_again = vehicle.autopilot == "ardupilot" and ("DEV_ID" in name or "PRIO" in name)
        calibration = name.startswith(("INS_ACC", "INS_GYR", "INS_TCAL", "COMPASS_", "CAL_", "TC_"))
        keep[name] = value if found_again or not calibration or name == "INS_GYR_CAL" else _default(name)
    vehicle.parameters.clear()
    vehicle.parameters.update(keep)
    _uncalibrated(vehicle)
    vehicle.texts = ("PreArm: 3D Accel calibration needed",) if vehicle.autopilot == "ardupilot" else ()


def _default(name: str) -> Value:
    if name.endswith(("_ID", "ENABLE")):
        return 0
    return -300.0 if name.endswith("CALTEMP") else 0.0


def vibration(vehicle: BenchVehicle) -> None:
    """A motor that runs rough, or an accelerometer that clipped on the last flight."""
    rng = vehicle.rng
    if rng.integers(2):
        level = float(rng.uniform(5.0, 40.0))
        vehicle.rattle = 0.3 * level  # what the autopilot's filter leaves of it
        vehicle.shaking = Shaking((level, 0.7 * level, level), (0, 0, 0))
    else:
        vehicle.shaking = dataclasses.replace(vehicle.shaking, clips=(int(rng.integers(150, 5000)), 0, 0))


FAULTS = (
    Fault("magnet", "a 10 mm neodymium cube at 3 to 6 cm of a compass", magnet, frozenset({CheckId.COMPASS_FIELD})),
    Fault(
        "weak-magnet",
        "20 to 60 uT in any direction at one compass",
        weak_magnet,
        frozenset({CheckId.COMPASS_FIELD, CheckId.COMPASS_DIRECTION}),
    ),
    Fault(
        "bent-mount",
        "a compass mast folded or twisted by 15 to 50 deg, the field thereby turned by 15 deg or more",
        bent_mount,
        frozenset({CheckId.COMPASS_DIRECTION}),
    ),
    Fault("accel-off", "one accelerometer 0.3 m/s2 off", accel_off, frozenset({CheckId.ACCEL_FORCE})),
    Fault("gyro-wandered", "one gyroscope 1 to 3 deg/s off", gyro_wandered, frozenset({CheckId.GYRO_REST})),
    Fault("swapped-board", "another autopilot with the old parameters", swapped_board, frozenset({CheckId.SENSOR_IDS})),
    Fault(
        "temperature",
        "8 to 25 degC outside what was calibrated",
        out_of_temperature,
        frozenset({CheckId.TEMPERATURE}),
    ),
    Fault(
        "firmware-reset",
        "a firmware update that reset the calibration",
        firmware_reset,
        frozenset({CheckId.PARAMETERS_CHANGED}),
    ),
    Fault("vibration", "5 to 40 m/s2, or 150 to 5000 clips", vibration, frozenset({CheckId.VIBRATION})),
)
