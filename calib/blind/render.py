"""From a world and its effects to the two logs: columns of the interchange format, as written to a table."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavcal.calib.blind.effects.place import ReferenceTilt
from mavcal.calib.blind.missions import OVERSAMPLING, Rng, World
from mavcal.calib.blind.sensors import SENSORS, Effect, Suite, mean_signal, read_sensor
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

Array = NDArray[np.float64]
Columns = dict[str, Array]
TELEMETRY_EVERY = {"temperature": 10, "current": 4, "throttle": 4}
UNITS = {"accel": "m/s2", "gyro": "rad/s", "mag": "uT", "temperature": "degC", "current": "A", "throttle": "1"}


def render(world: World, suite: Suite, effects: Sequence[Effect], rng: Rng) -> tuple[Columns, Columns]:
    """The real log with the effects, the simulated one without; both with what the simulated sensor reads ideally."""
    start = round(float(rng.uniform(5.0, 400.0)), 3)
    on_reference = [e for e in effects if isinstance(e, ReferenceTilt)]
    on_sensors = [e for e in effects if not isinstance(e, ReferenceTilt)]
    reference = {s: mean_signal(world, s, [e for e in on_reference if s in e.sensors])[::OVERSAMPLING] for s in SENSORS}
    real = _frame(world, start, rng)
    sim = dict(real)
    for sensor in SENSORS:
        quality = suite[sensor]
        _put(real, sensor, read_sensor(world, sensor, quality, on_sensors, rng), quality.every)
        simulated = read_sensor(_as_seen(world, sensor, on_reference), sensor, quality, (), rng)
        _put(sim, sensor, simulated, quality.every)
    for columns in (real, sim):
        for sensor in SENSORS:
            for axis, name in enumerate("xyz"):
                columns[f"ref_{sensor}_{name}"] = reference[sensor][:, axis]
        _put_pose(columns, world, on_reference)
    return real, sim


def _as_seen(world: World, sensor: str, tilts: Sequence[ReferenceTilt]) -> World:
    """The simulated sensor flies the reference's attitude, wrong as it may be."""
    if not tilts:
        return world
    signal = mean_signal(world, sensor, [e for e in tilts if sensor in e.sensors])
    match sensor:
        case "accel":
            return dataclasses.replace(world, force=signal)
        case "gyro":
            return dataclasses.replace(world, rate=signal)
        case _:
            return dataclasses.replace(world, field=signal)


def _frame(world: World, start: float, rng: Rng) -> Columns:
    t = world.t[::OVERSAMPLING]
    n = len(t)
    read = {
        "temperature": np.round(world.temperature[::OVERSAMPLING] + 0.01 * rng.standard_normal(n), 2),
        "current": np.round(world.current[::OVERSAMPLING] + 0.03 * rng.standard_normal(n), 2),
        "throttle": np.round(world.throttle[::OVERSAMPLING], 3),
    }
    columns = {"t": start + t}
    for name, values in read.items():
        columns[name] = _thinned(values, TELEMETRY_EVERY[name])
    for k in range(world.rotor_hz.shape[1]):
        # Fine enough that its integral keeps the phase over the log: severity counts the vibration as coherent.
        columns[f"rotor_hz_{k + 1}"] = np.round(world.rotor_hz[::OVERSAMPLING, k], 2)
    return columns


def _thinned(values: Array, every: int) -> Array:
    out = np.full(len(values), np.nan)
    out[::every] = values[::every]
    return out


def _put(columns: Columns, sensor: str, values: Array, every: int) -> None:
    for axis, name in enumerate("xyz"):
        column = np.full(len(columns["t"]), np.nan)
        column[::every] = values[:, axis]
        columns[f"{sensor}_{name}"] = column


def _put_pose(columns: Columns, world: World, tilts: Sequence[ReferenceTilt]) -> None:
    attitude = world.attitude[::OVERSAMPLING]
    for tilt in tilts:  # a vector read as Exp(e) v is read in the attitude R Exp(-e)
        attitude = attitude * Rotation.from_rotvec(-tilt.error[::OVERSAMPLING])
    q = attitude.as_quat()[:, [3, 0, 1, 2]]
    for k, name in enumerate("wxyz"):
        columns[f"ref_q_{name}"] = q[:, k]
    for what, values in (("pos", world.place), ("vel", world.velocity)):
        for k, name in enumerate("ned"):
            columns[f"ref_{what}_{name}"] = values[::OVERSAMPLING, k]


def recording(columns: Mapping[str, Array], source: str) -> Recording:
    """The same as a recording in memory."""
    t = columns["t"]

    def channel(sensor: Sensor, names: Sequence[str], unit: str) -> Channel:
        values = np.stack([columns[name] for name in names], axis=1)
        there = np.isfinite(values).all(axis=1)
        return Channel(sensor, 0, t[there], values[there], unit, Stage.RAW, source)

    def triad(prefix: str, sensor: str) -> Channel:
        return channel(Sensor(sensor), [f"{prefix}{sensor}_{axis}" for axis in "xyz"], UNITS[sensor])

    channels = [triad("", sensor) for sensor in SENSORS]
    channels += [channel(Sensor(name), [name], UNITS[name]) for name in ("temperature", "current", "throttle")]
    rotors = sorted(name for name in columns if name.startswith("rotor_hz"))
    if rotors:
        channels.append(channel(Sensor.ROTOR_SPEED, rotors, "Hz"))
    reference = [triad("ref_", sensor) for sensor in SENSORS]
    reference.append(channel(Sensor.ATTITUDE, [f"ref_q_{k}" for k in "wxyz"], "1"))
    reference.append(channel(Sensor.PLACE, [f"ref_pos_{k}" for k in "ned"], "m"))
    reference.append(channel(Sensor.VELOCITY, [f"ref_vel_{k}" for k in "ned"], "m/s"))
    return Recording(channels=tuple(channels), reference=tuple(reference), source=source)
