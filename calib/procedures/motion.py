"""Whether the vehicle is still, tick by tick, and what moves if it is not.

Prompts and collection use this live judgement; :mod:`calib.stats.stillness` finds still spans in recordings. It uses
every unit's accelerometer and gyro, because they complement each other: a steady turn keeps the gyro's spread small,
and a turn about the vertical does not change the accelerometer.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from mavcal.calib.gyro.rest import LARGEST_BIAS
from mavcal.calib.procedures.roster import Instance, TickChannels, label
from mavcal.calib.recording import Array, Sensor

_AXES = "xyz"


@dataclass(frozen=True)
class StillLimits:
    """Bounds on one tick, per axis. Wander is the distance of a tick's mean from the mean of the last seconds."""

    accel_wander: float
    gyro_wander: float
    accel_spread: float
    gyro_spread: float
    rate: float
    """Largest plausible zero-rate offset plus the allowance for a hold, rad/s."""


RESTING = StillLimits(
    accel_wander=0.06, gyro_wander=math.radians(0.25), accel_spread=0.6, gyro_spread=0.06, rate=LARGEST_BIAS
)
"""On a firm surface: 0.35 deg of tilt, and noise up to six times a poor sensor's."""

HELD = StillLimits(
    accel_wander=0.7,
    gyro_wander=math.radians(12),
    accel_spread=1.2,
    gyro_spread=math.radians(20),
    rate=math.radians(35),
)
"""In human hands: 4 deg of wander and a tremor of some deg/s."""

REFERENCE_TICKS = 20
"""Length, in ticks, of the reference mean: 5 s, so that slow thermal drift does not count as movement."""

SETTLE_TICKS = 3
"""Still ticks of a run before it counts: they may contain the end of the movement."""


@dataclass(frozen=True, eq=False)
class TickStatistics:
    """Mean, standard deviation and number of one sensor's samples in one tick."""

    mean: Array
    spread: Array
    n: int


def statistics(values: Array) -> TickStatistics:
    """Summary of `values` with shape (n, 3)."""
    mean = values.mean(axis=0)
    deviation = values - mean
    return TickStatistics(mean, np.sqrt((deviation * deviation).mean(axis=0)), len(values))


class _Reference:
    """Mean over the last ticks of one sensor, and the standard error of one tick's mean due to noise."""

    def __init__(self) -> None:
        self._means = np.zeros((REFERENCE_TICKS, 3))
        self._errors = np.zeros((REFERENCE_TICKS, 3))
        self._count = 0
        self.mean = np.zeros(3)
        self.error = np.zeros(3)

    def add(self, tick: TickStatistics) -> None:
        row = self._count % REFERENCE_TICKS
        self._means[row] = tick.mean
        self._errors[row] = tick.spread / math.sqrt(max(tick.n - 1, 1))
        self._count += 1
        rows = min(self._count, REFERENCE_TICKS)
        self.mean = self._means[:rows].mean(axis=0)
        self.error = self._errors[:rows].mean(axis=0)

    def clear(self) -> None:
        self._count = 0

    def __len__(self) -> int:
        return self._count


class Disturbance(StrEnum):
    """Kind of movement, for a prompt that does not change with every value."""

    NONE = ""
    SILENT = "no samples come in"
    SHAKES = "it shakes"
    TURNS = "it turns"
    TILTS = "it is tilted or pushed"


@dataclass(frozen=True)
class StillnessVerdict:
    """Whether a tick belongs to a still run.

    `ticks` counts the run's ticks so far, `why` says what moves and by how much (empty while still), `what` names
    its kind.
    """

    still: bool
    ticks: int
    why: str
    what: Disturbance

    @property
    def counted(self) -> bool:
        """Whether the tick is still and the run past its settling time."""
        return self.still and self.ticks > SETTLE_TICKS


class _Excess(NamedTuple):
    """Ratio of a disturbance to its bound (above 1: not still), with its text and kind."""

    ratio: float
    why: str
    what: Disturbance


class StillWatch:
    """Judges tick after tick against the run of still ticks before it."""

    def __init__(self, limits: StillLimits, inertial: Iterable[Instance]) -> None:
        self._limits = limits
        self._references = {i: _Reference() for i in inertial if i[0] in (Sensor.ACCEL, Sensor.GYRO)}
        self._ticks = 0
        self.latest: dict[Instance, TickStatistics] = {}
        """Statistics of the last tick."""

    def drop(self, instance: Instance) -> None:
        """Stop judging this sensor."""
        self._references.pop(instance, None)
        self.latest.pop(instance, None)

    def reset(self) -> None:
        """Begin a new run."""
        self._ticks = 0
        for reference in self._references.values():
            reference.clear()

    def update(self, frame: TickChannels) -> StillnessVerdict:
        """Take a tick."""
        self.latest = {i: statistics(frame[i].values) for i in self._references if i in frame}
        if not self.latest:
            self.reset()
            return StillnessVerdict(still=False, ticks=0, why="no samples come in", what=Disturbance.SILENT)
        worst = max((self._judge(i, tick) for i, tick in self.latest.items()), key=lambda e: e.ratio)
        still = worst.ratio <= 1.0
        if not still:
            self.reset()
        self._ticks += 1
        for instance, tick in self.latest.items():
            self._references[instance].add(tick)
        if still:
            return StillnessVerdict(still=True, ticks=self._ticks, why="", what=Disturbance.NONE)
        return StillnessVerdict(still=False, ticks=0, why=worst.why, what=worst.what)

    def _judge(self, instance: Instance, tick: TickStatistics) -> _Excess:
        accel = instance[0] == Sensor.ACCEL
        limits = self._limits
        checks = [self._spread(instance, tick, limits.accel_spread if accel else limits.gyro_spread)]
        if not accel:
            checks.append(self._rate(instance, tick))
        if len(self._references[instance]):
            checks.append(self._bias_change(instance, tick, limits.accel_wander if accel else limits.gyro_wander))
        return max(checks, key=lambda e: e.ratio)

    def _spread(self, instance: Instance, tick: TickStatistics, bound: float) -> _Excess:
        axis = int(tick.spread.argmax())
        amount = _in_words(instance[0], float(tick.spread[axis]))
        text = f"{label(*instance)} sees shaking of {amount} along {_AXES[axis]}"
        return _Excess(float(tick.spread[axis]) / bound, text, Disturbance.SHAKES)

    def _rate(self, instance: Instance, tick: TickStatistics) -> _Excess:
        rate = float(np.linalg.norm(tick.mean))
        axis = int(np.abs(tick.mean).argmax())
        text = f"{label(*instance)} sees a turn of {math.degrees(rate):.1f} deg/s, mostly about {_AXES[axis]}"
        return _Excess(rate / self._limits.rate, text, Disturbance.TURNS)

    def _bias_change(self, instance: Instance, tick: TickStatistics, bound: float) -> _Excess:
        reference = self._references[instance]
        deviation = np.abs(tick.mean - reference.mean)
        # Noise alone moves a tick's mean: five of its standard errors are no movement.
        allowed = np.maximum(bound, 5.0 * reference.error)
        axis = int((deviation / allowed).argmax())
        gyro = instance[0] == Sensor.GYRO
        amount = _in_words(instance[0], float(deviation[axis]))
        verb = "turns" if gyro else "is tilted or pushed"
        text = f"the vehicle {verb}: {label(*instance)} changed by {amount} along {_AXES[axis]}"
        what = Disturbance.TURNS if gyro else Disturbance.TILTS
        return _Excess(float(deviation[axis] / allowed[axis]), text, what)


def _in_words(sensor: Sensor, amount: float) -> str:
    return f"{amount:.2f} m/s2" if sensor == Sensor.ACCEL else f"{math.degrees(amount):.1f} deg/s"
