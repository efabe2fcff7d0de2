"""Chooses the channel of every sensor instance, and detects instances that stop or freeze."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from mavcal.calib.procedures.intake import TICK, Key, Tick
from mavcal.calib.recording import Array, Channel, Sensor

Instance = tuple[Sensor, int]
TickChannels = dict[Instance, Channel]
"""The samples of one tick, one channel an instance."""

ROSTER = 2.0
"""Time, s, of watching the streams before the channel of each instance is chosen."""

ROSTER_EXPECTED = 5.0
"""Longest wait, s, for an expected instance that does not stream."""

LOST_TICKS = round(5.0 / TICK)
"""Ticks (5 s) without new values, while others stream, after which an instance is lost."""

STUCK_TICKS = round(2.0 / TICK)
"""Ticks (2 s) of exact repeats, while the sensor must have changed, after which it is frozen."""

MOVED = {Sensor.ACCEL: 1.0, Sensor.GYRO: 0.2, Sensor.MAG: 3.0}
"""A change of a tick's mean by more than this is a movement, not noise; m/s2, rad/s, uT."""

EVIDENCE = {
    Sensor.ACCEL: {Sensor.ACCEL},
    Sensor.GYRO: {Sensor.ACCEL, Sensor.GYRO},
    Sensor.MAG: {Sensor.ACCEL, Sensor.GYRO, Sensor.MAG},
}
"""Sensors whose movement a sensor must share: a turn about the vertical changes no accelerometer, a current only
compasses."""

NAMES = {Sensor.ACCEL: "accelerometer", Sensor.GYRO: "gyro", Sensor.MAG: "compass", Sensor.TEMPERATURE: "thermometer"}


def label(sensor: Sensor, instance: int) -> str:
    """Name of a sensor for operators, whose ground stations count from 1.

    >>> label(Sensor.MAG, 0)
    'compass 1'
    """
    return f"{NAMES[sensor]} {instance + 1}"


@dataclass(frozen=True)
class Roster:
    """The channel key of every instance that takes part."""

    keys: Mapping[Instance, Key]

    def frame(self, tick: Tick) -> TickChannels:
        """The tick's samples by instance."""
        return {i: tick.channels[k] for i, k in self.keys.items() if k in tick.channels}


def choose(ticks: Iterable[Tick]) -> Roster:
    """For every instance the channel with the finest quantum, then the one with more samples.

    The same rule as :meth:`calib.recording.Recording.channel`.
    """
    count: dict[Key, int] = {}
    quantum: dict[Key, float] = {}
    for tick in ticks:
        for key, channel in tick.channels.items():
            count[key] = count.get(key, 0) + len(channel)
            quantum[key] = channel.quantum
    best: dict[Instance, Key] = {}
    for key in sorted(count, key=lambda k: (quantum[k], -count[k], k[2])):
        best.setdefault((key[0], key[1]), key)
    return Roster(dict(sorted(best.items())))


@dataclass
class Attendance:
    """Detects instances that stop, freeze, or were expected and never streamed."""

    present: set[Instance]
    _silent: dict[Instance, int] = field(default_factory=dict)
    _last: dict[Instance, tuple[float, ...]] = field(default_factory=dict)
    _constant: dict[Instance, int] = field(default_factory=dict)
    _mean: dict[Instance, Array] = field(default_factory=dict)

    def update(self, frame: TickChannels) -> tuple[tuple[Instance, str], ...]:
        """Take a tick; return the instances that fall out with it, each with its reason."""
        constant = {i for i in self.present & frame.keys() if self._repeats(i, frame[i])}
        movers = self._movers(frame, constant)
        out = []
        for instance in sorted(self.present):
            if instance not in frame:
                self._silent[instance] = self._silent.get(instance, 0) + 1
                if self._silent[instance] >= LOST_TICKS:
                    out.append((instance, f"{label(*instance)} stopped giving new values"))
                continue
            self._silent[instance] = 0
            # A quiet quantised sensor may repeat at rest; only a movement that others saw shows that it is stuck.
            if instance not in constant:
                self._constant[instance] = 0
            elif _never_repeats(instance, frame[instance]) or any(m[0] in EVIDENCE[instance[0]] for m in movers):
                self._constant[instance] = self._constant.get(instance, 0) + 1
                if self._constant[instance] >= STUCK_TICKS:
                    out.append((instance, f"{label(*instance)} is frozen: it repeats one value"))
        self.present -= {instance for instance, _ in out}
        return tuple(out)

    def _repeats(self, instance: Instance, channel: Channel) -> bool:
        if instance[0] == Sensor.TEMPERATURE:
            return False
        values = channel.values
        first, last = tuple(values[0]), tuple(values[-1])
        previous = self._last.get(instance)
        self._last[instance] = last
        return first == last == previous and bool((values == values[0]).all())

    def _movers(self, frame: TickChannels, constant: set[Instance]) -> set[Instance]:
        movers = set()
        for instance in self.present & frame.keys() - constant:
            bound = MOVED.get(instance[0])
            if bound is None:
                continue
            mean = frame[instance].values.mean(axis=0)
            before = self._mean.get(instance)
            self._mean[instance] = mean
            if before is not None and np.abs(mean - before).max() > bound:
                movers.add(instance)
        return movers


def _never_repeats(instance: Instance, channel: Channel) -> bool:
    """Whether the noise of an intact sensor shows in every sample: inertial ones that stream as floating point."""
    return channel.quantum == 0.0 and instance[0] in (Sensor.ACCEL, Sensor.GYRO)
