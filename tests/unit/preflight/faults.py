"""The faults, each with the checks that are right to fail."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.firmware.plan import Value
from mavcal.calib.preflight.check import CheckId, Report, Shaking
from mavcal.calib.preflight.installed import WORDS, announced
from mavcal.calib.preflight.run import preflight
from mavcal.calib.recording import Sensor
from tests.unit.preflight.vehicle import BenchVehicle, about, healthy, somewhere

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
    vehicle.culprit = f"compass {near + 1}"


def weak_magnet(vehicle: BenchVehicle) -> None:
    """20 to 60 uT in any direction at one compass."""
    i = _pick(vehicle, len(vehicle.mag_errors))
    vehicle.mag_errors[i] = vehicle.mag_errors[i] + vehicle.rng.uniform(20.0, 60.0) * _direction(vehicle.rng)
    vehicle.culprit = f"compass {i + 1}"


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
            vehicle.culprit = f"compass {i + 1}"
            return


def _dip(v: Array) -> float:
    return float(np.arctan2(v[2], np.hypot(v[0], v[1])))


def _between(a: Array, b: Array) -> float:
    return float(np.arctan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1]))


def accel_off(vehicle: BenchVehicle) -> None:
    """One accelerometer 0.3 m/s2 off, in any direction."""
    i = _pick(vehicle, vehicle.imus)
    vehicle.accel_errors[i] = vehicle.accel_errors[i] + 0.3 * _direction(vehicle.rng)
    vehicle.culprit = f"accelerometer {i + 1}"


def gyro_wandered(vehicle: BenchVehicle) -> None:
    """One gyroscope 1 to 3 deg/s off since its calibration."""
    i = _pick(vehicle, vehicle.imus)
    off = np.radians(vehicle.rng.uniform(1.0, 3.0)) * _direction(vehicle.rng)
    vehicle.gyro_errors[i] = vehicle.gyro_errors[i] + off
    vehicle.heading_error = float(rng_sign(vehicle) * np.radians(vehicle.rng.uniform(0.0, 40.0)))  # it drifted away
    vehicle.culprit = f"gyroscope {i + 1}"


def rng_sign(vehicle: BenchVehicle) -> float:
    """One way or the other."""
    return float(vehicle.rng.choice([-1.0, 1.0]))


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
        keep[name] = value if found_again or not calibration or name in vehicle.settings else _default(name)
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


def _used(vehicle: BenchVehicle, sensor: Sensor, *, least: int = 0) -> int:
    """One of the sensors that the parameters announce and use, from the instance `least` on."""
    known = announced(vehicle.autopilot, vehicle.parameters)
    return int(vehicle.rng.choice([i for kind, i in known if kind == sensor and i >= least]))


def _kill(vehicle: BenchVehicle, sensor: Sensor, instance: int, how: str) -> None:
    vehicle.dead[sensor, instance] = how
    vehicle.culprit = f"{WORDS[sensor][0]} {instance + 1}"


def use_all(vehicle: BenchVehicle) -> None:
    """Every sensor is in use, and was when it was verified."""
    used = {
        name: 75 if name.endswith("_PRIO") else 1
        for name in vehicle.parameters
        if name.startswith(("INS_USE", "COMPASS_USE")) or name.endswith("_PRIO")
    }
    vehicle.parameters |= used
    vehicle.verified = dataclasses.replace(vehicle.verified, parameters={**vehicle.verified.parameters, **used})


def dead_compass(vehicle: BenchVehicle) -> None:
    """A compass that reads nothing: three zeros."""
    _kill(vehicle, Sensor.MAG, _used(vehicle, Sensor.MAG), "zero")


def frozen_compass(vehicle: BenchVehicle) -> None:
    """A compass that stands still while the vehicle is turned by 90 deg."""
    use_all(vehicle)
    _kill(vehicle, Sensor.MAG, _used(vehicle, Sensor.MAG), "frozen")
    vehicle.turned_deg = 90.0


def stale_compass(vehicle: BenchVehicle) -> None:
    """A compass that froze before the vehicle was turned by 90 deg, and now stands still like the others."""
    use_all(vehicle)
    i = _used(vehicle, Sensor.MAG)
    _kill(vehicle, Sensor.MAG, i, "frozen")
    down = vehicle.body_from_ned @ np.array([0.0, 0.0, 1.0])
    vehicle.mag_turns[i] = about(down, rng_sign(vehicle) * np.pi / 2.0) @ vehicle.mag_turns[i]


def frozen_gyro(vehicle: BenchVehicle) -> None:
    """A gyroscope that stands still while the vehicle is turned by 90 deg."""
    use_all(vehicle)
    _kill(vehicle, Sensor.GYRO, _used(vehicle, Sensor.GYRO), "frozen")
    vehicle.turned_deg = 90.0


def ill_gyro(vehicle: BenchVehicle) -> None:
    """A second gyroscope that reads zero for ever; the vehicle says that a gyroscope is not healthy."""
    use_all(vehicle)
    _kill(vehicle, Sensor.GYRO, _used(vehicle, Sensor.GYRO, least=1), "zero")
    vehicle.ill = frozenset({Sensor.GYRO})
    vehicle.texts = ("PreArm: Gyros not healthy",) if vehicle.autopilot == "ardupilot" else ()


def frozen_accel(vehicle: BenchVehicle) -> None:
    """An accelerometer that repeats its last reading, among others of ordinary noise."""
    use_all(vehicle)
    vehicle.noises[Sensor.ACCEL] = [0.02] * vehicle.imus
    _kill(vehicle, Sensor.ACCEL, _used(vehicle, Sensor.ACCEL), "frozen")


def lost_unit(vehicle: BenchVehicle) -> None:
    """The message of the last inertial unit never comes."""
    use_all(vehicle)
    vehicle.lost = frozenset({vehicle.imus - 1})
    vehicle.culprit = f"gyroscope {vehicle.imus}"


def accel_sideways(vehicle: BenchVehicle) -> None:
    """One accelerometer 0.5 m/s2 off at right angles to gravity: it reads g all the same."""
    i = _pick(vehicle, vehicle.imus)
    down = vehicle.body_from_ned @ np.array([0.0, 0.0, 1.0])
    across = np.cross(down, _direction(vehicle.rng))
    vehicle.accel_errors[i] = vehicle.accel_errors[i] + 0.5 * across / np.linalg.norm(across)
    vehicle.culprit = f"accelerometer {i + 1}"


def _declined(vehicle: BenchVehicle) -> float:
    off = rng_sign(vehicle) * float(vehicle.rng.uniform(0.35, 0.7))
    if vehicle.autopilot == "ardupilot":
        vehicle.parameters |= {"COMPASS_AUTODEC": 0, "COMPASS_DEC": vehicle.field.declination + off}
    else:
        wrong = float(np.degrees(vehicle.field.declination + off))
        vehicle.parameters |= {"EKF2_DECL_TYPE": 0, "EKF2_MAG_DECL": wrong}
    vehicle.culprit = "declination"
    return off


def declination_set(vehicle: BenchVehicle) -> None:
    """A declination set by hand, 20 to 40 deg off, before the restart that makes it act."""
    _declined(vehicle)


def declination_acts(vehicle: BenchVehicle) -> None:
    """The same after the restart: the vehicle's heading is off by as much."""
    vehicle.heading_error = _declined(vehicle)


def far_place(vehicle: BenchVehicle) -> None:
    """A position where the field is 15 uT stronger or weaker, or dips 20 deg otherwise."""
    while True:
        found, place = somewhere(vehicle.rng)
        apart = abs(found.norm - vehicle.field.norm), abs(found.inclination - vehicle.field.inclination)
        if apart[0] > 15.0 or apart[1] > np.radians(20.0):
            break
    vehicle.believed = place
    vehicle.culprit = "position"


def remembers(vehicle: BenchVehicle) -> None:
    """An estimator that remembers old offsets: its attitude is 2 to 5 deg off."""
    vehicle.tilt_error = np.radians(vehicle.rng.uniform(2.1, 5.0))
    vehicle.culprit = "the vehicle's estimator"


_HEARD = frozenset({CheckId.SENSORS_HEARD})
_FIELD_OR_DIRECTION = frozenset({CheckId.COMPASS_FIELD, CheckId.COMPASS_DIRECTION})
_DIRECTION = frozenset({CheckId.COMPASS_DIRECTION})

FAULTS = (
    Fault("dead-compass", "a compass that reads three zeros", dead_compass, _HEARD),
    Fault("frozen-compass", "a compass frozen while the vehicle turns by 90 deg", frozen_compass, _HEARD),
    Fault(
        "stale-compass",
        "a compass that froze before a turn by 90 deg",
        stale_compass,
        _HEARD | _FIELD_OR_DIRECTION,
    ),
    Fault("frozen-gyro", "a gyroscope frozen while the vehicle turns by 90 deg", frozen_gyro, _HEARD),
    Fault("ill-gyro", "a gyroscope at zero for ever, not healthy by the vehicle", ill_gyro, _HEARD),
    Fault("frozen-accel", "an accelerometer that repeats its last reading", frozen_accel, _HEARD),
    Fault("lost-unit", "an inertial unit whose message never comes", lost_unit, _HEARD),
    Fault(
        "accel-sideways",
        "one accelerometer 0.5 m/s2 off across gravity",
        accel_sideways,
        frozenset({CheckId.ACCEL_FORCE}),
    ),
    Fault("declination-set", "a declination 20 to 40 deg off, before the restart", declination_set, _DIRECTION),
    Fault("declination-acts", "a declination 20 to 40 deg off, after the restart", declination_acts, _DIRECTION),
    Fault("far-place", "a position with another field (15 uT or 20 deg of dip)", far_place, _FIELD_OR_DIRECTION),
    Fault("remembers", "an attitude 2 to 5 deg off: the estimator remembers", remembers, frozenset({CheckId.ATTITUDE})),
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


def looked_at(fault: Fault | None, seed: int) -> tuple[BenchVehicle, Report]:
    """One vehicle, healthy or with a fault, and its preflight."""
    vehicle = healthy(seed, redundant=fault is not None)
    if fault is not None:
        fault.do(vehicle)
    return vehicle, preflight(vehicle.snapshot())


def report_of(fault: Fault | None, seed: int) -> Report:
    """The preflight of one vehicle."""
    return looked_at(fault, seed)[1]
