"""One hold of a pose: its samples, and the standard deviation of the length of its mean specific force."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcal.calib.procedures.base import mean_temperature
from mavcal.calib.procedures.pool import Pool, Tail
from mavcal.calib.procedures.poses import angle
from mavcal.calib.procedures.protocol import Pose
from mavcal.calib.procedures.roster import TickChannels
from mavcal.calib.recording import Array, Channel, Sensor
from mavcal.calib.stats.stillness import PoseMean, Still, pose_means

GUARD_TICKS = 1
"""Ticks before a detected movement that are not part of the hold: a quarter of a second."""

SHORTEST = 2.0
"""Shortest hold, s: tremor of 1 Hz and more averages out."""

LONGEST = 20.0
"""Longest hold, s: nobody holds a pose for longer."""

CREEP = math.radians(8.0)
"""Angle, rad, of creep beyond which a hold is a different pose."""


class Hold:
    """Collects the ticks of a hold."""

    def __init__(self, direction: Array | None = None) -> None:
        self.seconds = 0.0
        self.direction: Array | None = direction
        """The body direction that pointed down when it began; None: does not matter."""
        self._pool = Pool((Sensor.ACCEL, Sensor.GYRO, Sensor.TEMPERATURE))
        self._tail = Tail(GUARD_TICKS)
        self._lengths: dict[int, list[float]] = {}

    def add(self, frame: TickChannels, seconds: float) -> None:
        """Take a still tick."""
        kept = self._tail.push(frame)
        if kept is None:
            return
        self._pool.add(kept)
        self.seconds += seconds
        for (sensor, instance), channel in kept.items():
            if sensor == Sensor.ACCEL:
                self._lengths.setdefault(instance, []).append(float(np.linalg.norm(channel.values.mean(axis=0))))

    def crept(self, direction: Array) -> bool:
        """Whether `direction` is another pose than the one that this hold began with."""
        return self.direction is not None and angle(self.direction, direction) > CREEP

    @property
    def error(self) -> float:
        """Standard error of the mean's length over the worst accelerometer, m/s2.

        From the scatter of the ticks' means, so that a tremor's slow part counts; |C (m - b)| = g sees lengths only.
        """
        series = self._lengths.values()
        if not series or min(map(len, series)) < 4:
            return math.inf
        return max(float(np.std(s, ddof=1)) / math.sqrt(len(s)) for s in series)

    def complete(self, goal: float) -> bool:
        """Whether the hold may end."""
        return self.seconds >= LONGEST or (self.seconds >= SHORTEST and self.error <= goal)

    def channel(self, sensor: Sensor, instance: int) -> Channel | None:
        """All samples of one sensor over the hold; None: there are none."""
        return self._pool.get((sensor, instance))

    def temperature(self, instance: int) -> float | None:
        """Mean temperature of an inertial unit over the hold, degC; None: it does not stream."""
        return mean_temperature(self._pool, instance)

    def mean(self, instance: int) -> PoseMean | None:
        """Mean of one accelerometer over the hold; None: it gave too few samples."""
        if (Sensor.ACCEL, instance) not in self._pool:
            return None
        accel = self._pool.channel((Sensor.ACCEL, instance))
        still = Still(float(accel.t[0]), float(np.nextafter(accel.t[-1], np.inf)), None, None)
        gyro, temperature = (
            self._pool.channel((sensor, instance)) if (sensor, instance) in self._pool else None
            for sensor in (Sensor.GYRO, Sensor.TEMPERATURE)
        )
        means = pose_means(accel, (still,), gyro=gyro, temperature=temperature)
        return means[0] if means else None


@dataclass(frozen=True, eq=False)
class HeldPose:
    """A pose that was held long enough: the mean specific force of every accelerometer."""

    number: int
    pose: Pose
    direction: Array
    means: dict[int, PoseMean]


def pose_of_hold(hold: Hold, number: int, pose: Pose, direction: Array, instances: tuple[int, ...]) -> HeldPose:
    """The pose that `hold` gives for the accelerometers `instances`."""
    means = {i: hold.mean(i) for i in instances}
    return HeldPose(number, pose, direction, {i: m for i, m in means.items() if m is not None})
