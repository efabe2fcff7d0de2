"""From a flight to its log: inertial units with their errors, the estimator, rates, and columns of a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter

from mavcal.calib.blind.airframe.draw import log_uniform
from mavcal.calib.blind.airframe.flight import LOOP_HZ, LOOP_S, Errors, Flown
from mavcal.calib.blind.airframe.vehicle import FRAMES, SEA_LEVEL, Vehicle
from mavcal.calib.recording import Channel, ParameterTimeline, Recording, Sensor, Stage

Array = NDArray[np.float64]
Rng = np.random.Generator
Columns = dict[str, Array]

RATES = (400, 200, 100)
"""Of the log, Hz."""
SLOW_HZ = {"voltage": 10, "current": 10, "height": 20, "throttle": 10, "pressure": 10, "air_temperature": 10}
GAS, WARMER, AIR_K = 287.05, (10.0, 5.0), (268.0, 308.0)
"""Gas constant of air, J/(kg K); by how many K a barometer is warmer than the air, mean and deviation; days, K."""


@dataclass(frozen=True)
class Unit:
    """One inertial unit: where it sits (m from the frame's centre), white noise a loop, bias, and what is wrong.

    `shaken` is noise of the accelerometer in flight, m/s2; it and the gyroscope's are of all axes, or of each.
    `accel_scale` and `gyro_scale` multiply each axis.
    """

    place: tuple[float, float, float]
    accel_sd: float
    gyro_sd: float | tuple[float, float, float]
    shaken: float | tuple[float, float, float]
    accel_bias: tuple[float, float, float]
    gyro_bias: tuple[float, float, float]
    every: int = 1
    accel_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    gyro_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Logging:
    """Rates (Hz), filter cutoff (Hz) and quality of the estimator, the same in both flights of a case.

    `velocity_sd` m/s with its correlation time, s; `attitude_sd` rad of roll and pitch.
    """

    hz: int
    attitude_hz: int
    velocity_hz: int
    cutoff: float
    velocity_sd: float
    velocity_s: float
    attitude_sd: float


def draw_logging(rng: Rng) -> Logging:
    """As owners set it who want the airframe diagnosed."""
    hz = int(rng.choice(RATES, p=(0.4, 0.4, 0.2)))
    return Logging(
        hz=hz,
        attitude_hz=int(rng.choice([hz, 100, 50])),
        velocity_hz=int(rng.choice([50, 25, 10])),
        cutoff=float(rng.choice([20.0, 30.0, 40.0, 60.0])) if hz > 100 else 20.0,
        velocity_sd=rng.uniform(0.02, 0.05),
        velocity_s=rng.uniform(1.0, 4.0),
        attitude_sd=np.radians(rng.uniform(0.05, 0.15)),
    )


def draw_units(rng: Rng) -> tuple[Unit, Unit]:
    """Two consumer units, noise as in data sheets over half the loop rate. Both flights of a case carry the same."""
    units = []
    for every in (1, int(rng.choice([2, 4]))):
        units.append(
            Unit(
                place=(rng.uniform(-0.02, 0.02), rng.uniform(-0.02, 0.02), rng.uniform(-0.01, 0.01)),
                accel_sd=log_uniform(rng, 0.01, 0.06),
                gyro_sd=log_uniform(rng, 0.001, 0.006),
                shaken=log_uniform(rng, 0.05, 0.5),
                accel_bias=_three(rng.normal(0.0, [0.02] * 3)),
                gyro_bias=_three(rng.normal(0.0, [0.0005] * 3)),
                every=every,
            )
        )
    return units[0], units[1]


def _three(values: Array) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def coloured(rng: Rng, count: int, sd: Sequence[float], tau: float) -> Array:
    """First-order noise of those deviations (count, len(sd)) and that correlation time, by loop."""
    keep = float(np.exp(-LOOP_S / tau))
    white = rng.standard_normal((count, len(sd))) * np.sqrt(1.0 - keep * keep)
    white[0] = rng.standard_normal(len(sd))
    out: Array = lfilter([1.0], [1.0, -keep], white, axis=0) * np.asarray(sd)
    return out


def draw_errors(rng: Rng, count: int, logging: Logging, unit: Unit) -> Errors:
    """What the autopilot feels beside the truth; heading is known a few times worse than the horizon."""
    tilt, drift = logging.attitude_sd, logging.velocity_sd
    return Errors(
        velocity=coloured(rng, count, [drift] * 3, logging.velocity_s),
        attitude=coloured(rng, count, [tilt, tilt, 4.0 * tilt], 20.0),
        gyro=np.array(unit.gyro_sd) * rng.standard_normal((count, 3)) + np.array(unit.gyro_bias),
        height=coloured(rng, count, [0.02], 0.5)[:, 0],
        cutoff=logging.cutoff,
    )


def columns_of(
    flown: Flown, vehicle: Vehicle, units: tuple[Unit, Unit], errors: Errors, logging: Logging, rng: Rng
) -> Columns:
    """The log as columns of a table: nan where a message had no sample in that row."""
    count = len(flown.t)
    start = round(float(rng.uniform(5.0, 400.0)), 3)
    every = LOOP_HZ // logging.hz
    rows = slice(None, None, every)
    columns: Columns = {"t": start + flown.t[rows]}
    for number, unit in enumerate(units):
        name = "" if number == 0 else str(number + 1)
        rate = flown.felt_rate if number == 0 else _filtered(_own_rate(flown, unit, rng), logging.cutoff)
        force = _filtered(_own_force(flown, vehicle, unit, rng), logging.cutoff)
        _put(columns, f"gyro{name}", "xyz", (rate * np.array(unit.gyro_scale))[rows], unit.every)
        _put(columns, f"accel{name}", "xyz", force[rows], unit.every)
    _put(columns, "motor", [str(k + 1) for k in range(flown.command.shape[1])], np.round(flown.command[rows], 5), 1)
    attitude = _tilted(flown.attitude, errors.attitude[:count])
    _put(columns, "q", "wxyz", attitude[rows], logging.hz // logging.attitude_hz)
    _put(columns, "vel", "ned", (flown.velocity + errors.velocity[:count])[rows], logging.hz // logging.velocity_hz)
    slow = {
        "voltage": np.round(flown.voltage + 0.01 * rng.standard_normal(count), 3),
        "current": np.round(flown.current + 0.05 * rng.standard_normal(count), 2),
        "height": np.round(np.maximum(-flown.place[:, 2] + errors.height[:count], 0.0), 3),
        "throttle": np.round(flown.command.mean(axis=1), 4),
        **_air(vehicle, start, count),
    }
    for name, values in slow.items():
        _put(columns, name, None, values[rows][:, None], logging.hz // SLOW_HZ[name])
    return columns


def _air(vehicle: Vehicle, start: float, count: int) -> dict[str, Array]:
    """What a barometer reads in air of the vehicle's density; the day is drawn from the log's first stamp."""
    day = np.random.default_rng(round(1000.0 * start))
    kelvin = float(day.uniform(*AIR_K))
    warm = kelvin - 273.15 + float(day.normal(*WARMER))
    pressure = vehicle.density * SEA_LEVEL * GAS * kelvin
    return {"pressure": np.full(count, round(pressure, 1)), "air_temperature": np.full(count, round(warm, 2))}


def _own_rate(flown: Flown, unit: Unit, rng: Rng) -> Array:
    noise = np.array(unit.gyro_sd) * rng.standard_normal(flown.rate.shape)
    out: Array = flown.rate + np.array(unit.gyro_bias) + noise
    return out


def _own_force(flown: Flown, vehicle: Vehicle, unit: Unit, rng: Rng) -> Array:
    """Specific force where the unit sits, with its errors; vibration grows with the thrust."""
    arm = np.array(unit.place) - np.array(vehicle.hull.centre)
    there = flown.force + np.cross(flown.spin, arm) + np.cross(flown.rate, np.cross(flown.rate, arm))
    speed = (flown.speeds**2).mean(axis=1, keepdims=True)
    loud = speed / max(float(np.median(speed[speed > 0.0])), 1.0) if (speed > 0.0).any() else np.zeros_like(speed)
    sd = np.hypot(unit.accel_sd, np.array(unit.shaken) * loud)
    out: Array = there * np.array(unit.accel_scale) + np.array(unit.accel_bias)
    out += sd * rng.standard_normal(there.shape)
    return out


def _filtered(values: Array, cutoff: float) -> Array:
    """As the loop's own filter, at rest before."""
    b, a = butter(2, cutoff, fs=LOOP_HZ)
    out: Array = lfilter(b, a, values - values[0], axis=0) + values[0]
    return out


def _tilted(attitude: Array, error: Array) -> Array:
    """Attitudes w x y z after small rotations of `error` in the body."""
    w, x, y, z = attitude.T
    a, b, c = 0.5 * error.T
    out = np.column_stack(
        [w - x * a - y * b - z * c, x + w * a + y * c - z * b, y + w * b + z * a - x * c, z + w * c + x * b - y * a]
    )
    turned: Array = out / np.linalg.norm(out, axis=1, keepdims=True)
    return turned


def _put(columns: Columns, name: str, axes: Sequence[str] | None, values: Array, every: int) -> None:
    kept = np.full_like(values, np.nan)
    kept[:: max(every, 1)] = values[:: max(every, 1)]
    for k, axis in enumerate(axes or [""]):
        columns[f"{name}_{axis}" if axes else name] = kept[:, k]


def recording_of(columns: Mapping[str, Array], frame: str, source: str) -> Recording:
    """The same as a recording in memory, which says its frame in ArduPilot's parameters."""
    t = columns["t"]

    def channel(sensor: Sensor, instance: int, names: Sequence[str], unit: str) -> Channel | None:
        if not names or not all(name in columns for name in names):
            return None
        values = np.stack([columns[name] for name in names], axis=1)
        there = np.isfinite(values).all(axis=1)
        # Raw, as every table is read: nothing is known of what the firmware did to it.
        return Channel(sensor, instance, t[there], values[there], unit, Stage.RAW, source) if there.any() else None

    motors = [name for name in columns if name.startswith("motor_")]
    channels = [
        channel(sensor, k, [f"{sensor.value}{k + 1 if k else ''}_{axis}" for axis in "xyz"], unit)
        for k in (0, 1)
        for sensor, unit in ((Sensor.ACCEL, "m/s2"), (Sensor.GYRO, "rad/s"))
    ]
    channels += [
        channel(Sensor.MOTOR, 0, motors, "1"),
        channel(Sensor.CURRENT, 0, ["current"], "A"),
        channel(Sensor.THROTTLE, 0, ["throttle"], "1"),
    ]
    dynamics = [
        channel(Sensor.ATTITUDE, 0, [f"q_{axis}" for axis in "wxyz"], "1"),
        channel(Sensor.VELOCITY, 0, [f"vel_{axis}" for axis in "ned"], "m/s"),
        channel(Sensor.VOLTAGE, 0, ["voltage"], "V"),
        channel(Sensor.HEIGHT, 0, ["height"], "m"),
        channel(Sensor.AIR, 0, ["pressure", "air_temperature"], "Pa degC"),
    ]
    layout = FRAMES[frame]
    return Recording(
        channels=tuple(c for c in channels if c is not None),
        dynamics=tuple(c for c in dynamics if c is not None),
        parameters=ParameterTimeline.constant({"FRAME_CLASS": layout.frame_class, "FRAME_TYPE": layout.frame_type}),
        source=source,
    )
