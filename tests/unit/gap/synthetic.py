"""Traces of a tumbling flight with white noise, for the diagnosis: no code in common with the catalogue."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from mavcal.calib.gap.problem import GapProblem, ReferenceInfo, ReferenceKind, Trace
from mavcal.calib.recording import Sensor

SIGMA = {Sensor.ACCEL: 0.05, Sensor.GYRO: 0.003, Sensor.MAG: 0.5}
Gap = Callable[[Trace], np.ndarray | float]


def _smooth(rng: np.random.Generator, t: np.ndarray, k: int, highest: float) -> np.ndarray:
    waves = [
        rng.normal(size=k)
        * np.sin(2 * np.pi * rng.uniform(0.03, highest) * t[:, None] + rng.uniform(0, 2 * np.pi, size=k))
        for _ in range(10)
    ]
    return np.sum(waves, axis=0) / 3.0


def flight(rng: np.random.Generator, seconds: float = 40.0, fs: float = 50.0) -> dict[str, np.ndarray]:
    t = np.arange(int(seconds * fs)) / fs
    angles = 2.0 * _smooth(rng, t, 3, 0.2)
    body = Rotation.from_euler("ZYX", angles)
    rate = (body[:-1].inv() * body[1:]).as_rotvec() * fs
    rate = np.vstack([rate, rate[-1:]])
    force = body.inv().apply(_smooth(rng, t, 3, 0.7) - np.array([0.0, 0.0, 9.80665]))
    field = body.inv().apply(np.tile([20.0, 1.0, 42.0], (len(t), 1)))
    throttle = np.clip(0.5 + 0.4 * _smooth(rng, t, 1, 0.3)[:, 0], 0.0, 1.0) * (t > 4.0)
    x, y, z, w = body.as_quat().T
    return {
        "t": t,
        "force": force,
        "rate": rate,
        "spin": np.gradient(rate, 1.0 / fs, axis=0),
        "field": field,
        "attitude": np.column_stack([w, x, y, z]),
        "temperature": 25.0 + 12.0 * (1.0 - np.exp(-t / 15.0)) + 2.0 * np.sin(0.2 * t),
        "current": 0.5 + 20.0 * throttle**1.5,
        "throttle": throttle,
        "motors": np.repeat(throttle[:, None], 4, axis=1),
    }


def problem_of(
    rng: np.random.Generator,
    sensors: tuple[Sensor, ...],
    gap: Gap | None = None,
    *,
    instances: int = 1,
    only: int | None = None,
    reference: ReferenceInfo | None = None,
    error: Callable[[dict[str, np.ndarray], Sensor], np.ndarray] | None = None,
) -> GapProblem:
    """`gap` is added to instance `only`, or to all; `error` is common to all instances: the reference's own."""
    truth = flight(rng)
    ideal = {Sensor.ACCEL: truth["force"], Sensor.GYRO: truth["rate"], Sensor.MAG: truth["field"]}
    traces = []
    for sensor in sensors:
        for i in range(instances):
            reading = ideal[sensor]
            noise = SIGMA[sensor] * rng.normal(size=reading.shape)
            measured = reading + noise + (0.0 if error is None else error(truth, sensor))
            parts = {k: v for k, v in truth.items() if k != "t"}
            seen = np.ones(len(reading), dtype=bool)
            trace = Trace(sensor, (i,), truth["t"], measured, reading, seen, sigma=np.full(3, SIGMA[sensor]), **parts)
            if gap is not None and (only is None or only == i):
                measured += gap(trace)
            traces.append(trace)
    info = reference or ReferenceInfo(ReferenceKind.SIM)
    return GapProblem(tuple(traces), info, float(truth["t"][-1]))
