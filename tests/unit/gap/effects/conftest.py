"""Synthetic traces: a mission in attitude, from which everything a trace holds follows by physics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.gap.problem import Trace
from mavcal.calib.recording import Sensor

G = 9.80665
EARTH = np.array([20.0, 1.5, 45.0])


def _angles(kind: str, t: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw in rad."""
    z = np.zeros_like(t)
    if kind == "static":
        return np.stack([z + 0.02, z - 0.01, z + 0.4], axis=1)
    if kind == "hover":
        return np.stack([0.03 * np.sin(1.9 * t), 0.03 * np.cos(1.3 * t), 0.4 + 0.05 * np.sin(0.4 * t)], axis=1)
    return np.stack([2.5 * np.sin(0.31 * t), 1.3 * np.sin(0.23 * t + 1.0), 2.9 * np.sin(0.17 * t)], axis=1)


def make(sensor: Sensor, kind: str = "tumble", *, seconds: float = 70.0, fs: float = 100.0, turn=None, **over) -> Trace:
    """A trace of an ideal `sensor`: measured equals ideal. `turn`: the body's frame turned by this rotation."""
    t = np.arange(int(seconds * fs)) / fs
    turn = Rotation.identity() if turn is None else turn
    ned_from_body = Rotation.from_euler("ZYX", _angles(kind, t)[:, ::-1]) * turn.inv()
    flat = 0.0 if kind == "static" else 1.0
    path = flat * np.stack([3.0 * np.sin(0.2 * t), 2.0 * np.sin(0.33 * t), -0.5 * np.cos(0.1 * t)], axis=1)
    accel = np.gradient(np.gradient(path, t, axis=0), t, axis=0)
    body = ned_from_body.inv()
    force = body.apply(accel - [0, 0, G])
    step = (ned_from_body[:-1].inv() * ned_from_body[1:]).as_rotvec() * fs
    rate = np.vstack([step[:1], 0.5 * (step[1:] + step[:-1]), step[-1:]])
    spin = np.gradient(rate, t, axis=0)
    field = body.apply(np.tile(EARTH, (len(t), 1)))
    throttle = flat * np.where((t > 0.2 * seconds) & (t < 0.9 * seconds), 0.45 + 0.1 * np.sin(0.9 * t), 0.0)
    ideal = {Sensor.ACCEL: force, Sensor.GYRO: rate, Sensor.MAG: field}[sensor]
    x, y, z, w = ned_from_body.as_quat().T
    values = {
        "measured": ideal.copy(),
        "observed": np.ones(len(t), bool),
        "force": force,
        "rate": rate,
        "spin": spin,
        "field": field,
        "attitude": np.stack([w, x, y, z], axis=1),
        "place": path,
        "temperature": 30.0 + flat * (10.0 * np.sin(2 * np.pi * t / seconds) + 4 * np.sin(0.7 * t)),
        "current": 40.0 * throttle**1.5,
        "throttle": throttle,
        "rotor_hz": np.sqrt(throttle)[:, None] * np.array([60.0, 62.0, 58.0, 61.0]),
    }
    return Trace(sensor, (0,), t, ideal=ideal, **(values | over))


@pytest.fixture
def trace() -> Callable[..., Trace]:
    return make
