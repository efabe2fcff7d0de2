"""A flight of a made vehicle with true sensors: rest, climb, turns with banks, landing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavcal.calib.earth import earth_field
from mavcal.calib.recording import Channel, Event, Identity, ParameterTimeline, Recording, Sensor, Stage

Array = NDArray[np.float64]

PLACE = (47.4, 8.5, 500.0)
FIELD = earth_field(*PLACE, 2025.5).north_east_down
CALIBRATED = {
    **{f"INS_ACC{n}OFFS_{a}": 0.1 for n in ("", "2") for a in "XYZ"},
    **{f"COMPASS_OFS{n}_{a}": 20.0 for n in ("", "2") for a in "XYZ"},
}


def flight(seed: int, *, units: int = 2, parameters: dict[str, float] | None = None, rest: float = 20.0) -> Recording:
    """About three minutes: 50 Hz inertial samples, 10 Hz of everything else."""
    rng, beside = np.random.default_rng(seed), np.random.default_rng(1000 + seed)
    t = np.arange(0.0, rest + 160.0, 0.02)
    flying = (t > rest) & (t < rest + 140.0)
    phase = rng.uniform(0.0, 6.0, 3)
    bank = np.where(flying, 0.12, 0.0)
    roll, pitch = bank * np.sin(0.5 * t + phase[0]), bank * np.sin(0.31 * t + phase[1])
    yaw = np.cumsum(np.where(flying, 0.25 * np.sin(0.05 * t + phase[2]), 0.0)) * 0.02
    turned = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))
    climb = np.where(flying, 0.4 * np.sin(0.35 * t), 0.0)
    force = turned.inv().apply(np.column_stack([np.zeros_like(t), np.zeros_like(t), -9.80665 - climb]))
    rate = np.vstack([(turned[:-1].inv() * turned[1:]).as_rotvec() / 0.02, np.zeros(3)])
    throttle = np.where(flying, 0.4 + 0.05 * np.sin(0.7 * t), 0.0)
    slow = slice(None, None, 5)
    field = turned[slow].inv().apply(FIELD)
    channels = [
        Channel(Sensor.ATTITUDE, 0, t[slow], turned[slow].as_quat(scalar_first=True), "1", Stage.RAW, "ATT"),
        Channel(Sensor.POSITION, 0, t[slow], np.tile(PLACE, (len(t[slow]), 1)), "deg deg m", Stage.RAW, "GPS"),
        Channel(Sensor.THROTTLE, 0, t[slow], throttle[slow], "1", Stage.RAW, "CTUN"),
    ]
    level = np.where(flying, 3.0, 0.1)[slow, None] * beside.uniform(0.8, 1.2, (len(t[slow]), 3))
    channels.append(Channel(Sensor.VIBRATION, 0, t[slow], level, "m/s2", Stage.RAW, "VIBE"))
    for i in range(units):
        warm = 30.0 + 0.05 * t[slow] + 0.01 * beside.normal(size=len(t[slow]))
        channels.append(Channel(Sensor.TEMPERATURE, i, t[slow], warm, "degC", Stage.RAW, "IMU"))
        shake = np.where(flying, 1.5, 0.02)[:, None] * rng.normal(size=(len(t), 3))
        own = 0.05 * rng.normal(size=3), np.radians(0.1) * rng.normal(size=3), 0.6 * rng.normal(size=3)
        channels += [
            _inertial(Sensor.ACCEL, i, t, force + shake + own[0], "m/s2"),
            _inertial(Sensor.GYRO, i, t, rate + 0.01 * shake + own[1], "rad/s"),
            Channel(
                *(Sensor.MAG, i, t[slow], field + 0.4 * rng.normal(size=field.shape) + own[2], "uT"),
                *(Stage.CORRECTED, "MAG"),
            ),
        ]
    return Recording(
        tuple(channels),
        events=(Event(rest, "armed", ""), Event(rest + 140.0, "disarmed", "")),
        identity=Identity("ardupilot"),
        parameters=ParameterTimeline.constant(CALIBRATED if parameters is None else parameters),
        source="made.bin",
    )


def _inertial(sensor: Sensor, instance: int, t: Array, values: Any, unit: str) -> Channel:
    return Channel(sensor, instance, t, values, unit, Stage.CORRECTED, "IMU")
