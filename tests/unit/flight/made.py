"""Logs of a made vehicle: rest, flight, rest; inertial units that drift with temperature, each log in another pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.recording import Channel, Event, Identity, ParameterTimeline, Recording, Sensor, Stage

Array = NDArray[np.float64]

GRAVITY = 9.80665


@dataclass(frozen=True)
class Unit:
    """Errors of one inertial unit: offsets, and drift by powers of T - 35."""

    accel: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gyro: tuple[float, float, float] = (0.0, 0.0, 0.0)
    accel_drift: tuple[tuple[float, float, float], ...] = ()
    gyro_drift: tuple[tuple[float, float, float], ...] = ()


def drift(powers: Sequence[Sequence[float]], t: Array) -> Array:
    """(N, 3) at temperatures `t` (N,)."""
    d = t[:, None] - 35.0
    return sum((np.array(c) * d ** (k + 1) for k, c in enumerate(powers)), np.zeros((len(t), 3)))


def log(
    units: Sequence[Unit],
    temperatures: tuple[float, float],
    *,
    seed: int,
    before: float = 60.0,
    flight: float = 40.0,
    after: float = 20.0,
    rate: float = 50.0,
    roll: float = 0.0,
    noise: float = 0.02,
    vibration: float = 2.0,
    turn_on: tuple[float, float, float] = (0.0, 0.0, 0.0),
    events: bool = True,
    source: str = "made.bin",
) -> Recording:
    """Temperature moves evenly between its two ends; the second rest is rolled by three degrees more."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, before + flight + after, 1.0 / rate)
    flying = (t >= before) & (t < before + flight)
    temperature = np.interp(t, [t[0], t[-1]], temperatures)
    angle = np.radians(roll + np.where(t >= before + flight, 3.0, 0.0))
    force = -GRAVITY * np.stack([np.zeros_like(t), np.sin(angle), np.cos(angle)], axis=1)
    moved = np.where(flying[:, None], np.sin(t[:, None] * np.array([1.1, 1.7, 0.9])), 0.0)
    channels = []
    for i, unit in enumerate(units):
        shake = np.where(flying[:, None], vibration * rng.normal(size=(len(t), 3)), 0.0)
        accel = force + moved + shake + unit.accel + drift(unit.accel_drift, temperature)
        gyro = 0.5 * moved + 0.02 * shake + unit.gyro + np.array(turn_on) + drift(unit.gyro_drift, temperature)
        channels += [
            Channel(Sensor.ACCEL, i, t, accel + noise * rng.normal(size=accel.shape), "m/s2", Stage.RAW, "IMU"),
            Channel(Sensor.GYRO, i, t, gyro + 0.05 * noise * rng.normal(size=gyro.shape), "rad/s", Stage.RAW, "IMU"),
            Channel(Sensor.TEMPERATURE, i, t, temperature, "degC", Stage.RAW, "IMU"),
        ]
    said = (Event(before, "armed", ""), Event(before + flight, "disarmed", "")) if events and flight else ()
    return Recording(
        tuple(channels),
        events=said,
        identity=Identity("ardupilot"),
        parameters=ParameterTimeline.constant({"AHRS_ORIENTATION": 0}),
        source=source,
    )
