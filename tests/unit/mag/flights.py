"""Synthetic flights with everything known: for tests of compass calibration from flights, and its benchmark."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from mavcal.calib.mag.flight_path import Turning
from mavcal.calib.mag.motor_drives import Drive, DriveKind
from mavcal.calib.recording import Channel, Sensor, Stage
from tests.fields import field_of

Array = NDArray[np.float64]

FIELD = field_of(50.0, np.radians(60.0), np.radians(10.0), norm_sd=0.1)
ON_GROUND = 15.0  # s


@dataclass(frozen=True)
class Truth:
    """What is wrong with the compass, the gyroscope, and the log's attitude."""

    offset: Array = field(default_factory=lambda: np.array([6.0, -4.0, 3.0]))
    matrix: Array = field(default_factory=lambda: np.eye(3))
    motor: Array = field(default_factory=lambda: np.zeros(3))
    noise: float = 0.3
    gyro_bias: Array = field(default_factory=lambda: np.array([0.01, -0.02, 0.015]))
    heading_error: float = 0.2  # rad, sd, wandering over 30 s
    tilt: float = np.radians(20.0)  # of the banks
    turns: float = 2.0  # whole circles on the spot
    wander: float = 0.2  # rad, of the heading
    duration: float = 120.0


@dataclass(frozen=True, eq=False)
class Flown:
    """The channels of a flight."""

    mag: Channel
    turning: Turning
    current: Channel
    throttle: Channel

    @property
    def drives(self) -> list[Drive]:
        """Current, then throttle."""
        found = [Drive.of(DriveKind.CURRENT, self.current), Drive.of(DriveKind.THROTTLE, self.throttle)]
        return [drive for drive in found if drive is not None]


def _smooth(rng: np.random.Generator, count: int, width: float) -> Array:
    walk = gaussian_filter1d(rng.normal(size=count), width, mode="wrap")
    return np.asarray(walk / walk.std())


def fly(truth: Truth, rng: np.random.Generator) -> Flown:
    """One flight: still on the ground, take-off, banks and circles, hover; 100 Hz gyroscope, 10 Hz compass."""
    rate = 100.0
    t = np.arange(int(truth.duration * rate)) / rate
    up = np.clip((t - ON_GROUND) / 3.0, 0.0, 1.0)
    angles = truth.tilt * up[:, None] * np.stack([_smooth(rng, len(t), 120.0) for _ in range(2)], axis=1) / 2.0
    since = np.clip((t - ON_GROUND - 10.0) / (truth.duration - ON_GROUND - 20.0), 0.0, 1.0)
    yaw = (
        0.3
        + 2.0 * np.pi * truth.turns * since**2 * (3.0 - 2.0 * since)
        + truth.wander * up * _smooth(rng, len(t), 300.0)
    )
    attitude = Rotation.from_euler("ZYX", np.column_stack([yaw, angles]))
    steps = (attitude[:-1].inv() * attitude[1:]).as_rotvec() * rate
    walk = np.radians(0.05) * np.sqrt(rate)
    rates = np.vstack([steps, steps[-1:]]) + truth.gyro_bias + walk * rng.normal(size=(len(t), 3))
    gyro = Channel(Sensor.GYRO, 0, t + 0.5 / rate, rates, "rad/s", Stage.CORRECTED, "test")
    sizes = (0.02, 0.02, truth.heading_error)
    wrong = np.column_stack([size * _smooth(rng, len(t), 1500.0) for size in sizes])
    logged = (Rotation.from_rotvec(wrong) * attitude)[::10].as_quat()[:, [3, 0, 1, 2]]
    said = Channel(Sensor.ATTITUDE, 0, t[::10], logged, "1", Stage.RAW, "test")
    amperes = 0.5 + up * (15.0 + 3.0 * _smooth(rng, len(t), 300.0))
    current = Channel(Sensor.CURRENT, 0, t[::10], amperes[::10], "A", Stage.RAW, "test")
    throttle = Channel(
        Sensor.THROTTLE, 0, t[::10], up[::10] * (0.4 + 0.02 * _smooth(rng, len(t[::10]), 30.0)), "1", Stage.RAW, "test"
    )
    body = attitude.inv().apply(FIELD.north_east_down)[::10]
    seen = body @ truth.matrix.T + truth.offset + np.outer(amperes[::10], truth.motor)
    seen = seen + truth.noise * rng.normal(size=seen.shape)
    mag = Channel(Sensor.MAG, 0, t[::10], seen, "uT", Stage.RAW, "test")
    return Flown(mag, Turning(gyro, said), current, throttle)
