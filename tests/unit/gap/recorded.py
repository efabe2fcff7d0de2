"""A tumbling flight while it warms up, beside its ideal readings: with right sensors, or with four effects on two."""

from __future__ import annotations

import dataclasses

import numpy as np

from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.simulate import (
    MotionOptions,
    SensorErrors,
    SensorSuite,
    Simulated,
    Warming,
    motion_of,
    simulate,
    trajectory,
)

RATE = 100.0
FIELD = np.array([21.0, 1.1, 43.2])  # uT
QUIET = {Sensor.ACCEL: np.full(3, 0.003), Sensor.GYRO: np.full(3, 3e-4), Sensor.MAG: np.full(3, 0.05)}
CLEAN = SensorSuite(
    accel=SensorErrors(noise_density=QUIET[Sensor.ACCEL]),
    gyro=SensorErrors(noise_density=QUIET[Sensor.GYRO]),
    mag=SensorErrors(noise_density=QUIET[Sensor.MAG]),
)
REAL = SensorSuite(
    accel=SensorErrors(
        noise_density=QUIET[Sensor.ACCEL],
        temperature=np.array([[0.008], [-0.005], [0.012]]),
        t_ref=35.0,
        bias=np.array([0.05, 0.02, -0.03]),
    ),
    gyro=CLEAN.gyro,
    mag=SensorErrors(
        noise_density=QUIET[Sensor.MAG], bias=np.array([-6.0, 4.0, -3.0]), matrix=np.diag([1.05, 0.93, 1.02])
    ),
)


def recorded(suite: SensorSuite, seed: int, *, seconds: float = 60.0, rate: float = RATE) -> Recording:
    """A flight of `suite`, with what ideal sensors would have read beside it."""
    rng = np.random.default_rng(seed)
    motion = motion_of("tumble", MotionOptions(duration=seconds), rng)
    path = trajectory(motion.legs, rate, field=FIELD, start=motion.start, warming=Warming(22.0, 55.0, 25.0))
    made = simulate(path, suite, rng, mag_rate=min(rate, RATE))
    return dataclasses.replace(made.recording, reference=_ideal(made))


def _ideal(made: Simulated) -> tuple[Channel, ...]:
    path = made.trajectory
    readings = ((Sensor.ACCEL, path.force, "m/s2"), (Sensor.GYRO, path.rate, "rad/s"), (Sensor.MAG, path.field, "uT"))
    return tuple(Channel(sensor, 0, path.t, values, unit, Stage.RAW, "reference") for sensor, values, unit in readings)
