"""A stretch of steady turning (or of rest): its samples, its rate, and how well that is known."""

from __future__ import annotations

import math

import numpy as np

from mavcal.calib.procedures.pool import Pool, Tail
from mavcal.calib.procedures.results import mean_temperature
from mavcal.calib.procedures.roster import TickChannels
from mavcal.calib.procedures.turning import Spin
from mavcal.calib.recording import Array, Channel, Sensor

GUARD_TICKS = 1
"""The last quarter of a second before a change was noticed belongs to the change."""

SETTLE_TICKS = 2
"""The first ticks of a stretch may hold the end of a run-up."""

STEADY = 0.05
"""A tick whose rate is off by more of the rate belongs to another stretch: a run-up, or a turntable that slips."""

STEADY_AT_LEAST = math.radians(1.0)
"""The same for slow turns, rad/s."""


class Stretch:
    """Collects the ticks of one steady turn about `axis` (3,), a body axis; of a rest if it is zero."""

    def __init__(self, axis: Array) -> None:
        self.axis = axis
        self.seconds = 0.0
        self._pool = Pool((Sensor.GYRO, Sensor.TEMPERATURE))
        self._tail = Tail(GUARD_TICKS)
        self._skip = SETTLE_TICKS
        self._rates: list[float] = []
        self._last = math.nan

    def goes_on(self, spin: Spin) -> bool:
        """Whether a tick turns as the one before it."""
        rate = spin.about(self.axis)
        allowed = max(STEADY * abs(rate), STEADY_AT_LEAST)
        return math.isnan(self._last) or abs(rate - self._last) <= allowed

    def add(self, frame: TickChannels, spin: Spin) -> None:
        """Take a tick."""
        self._last = spin.about(self.axis)
        if self._skip > 0:
            self._skip -= 1
            return
        kept = self._tail.push(frame)
        if kept is not None:
            self._pool.add(kept)
            self.seconds += spin.seconds
            self._rates.append(self._last)

    @property
    def error(self) -> float:
        """Standard error of the mean rate, from the scatter of the ticks, rad/s."""
        if len(self._rates) < 4:
            return math.inf
        return float(np.std(self._rates, ddof=1)) / math.sqrt(len(self._rates))

    def channel(self, instance: int) -> Channel | None:
        """What one gyro read; None: nothing."""
        return self._pool.get((Sensor.GYRO, instance))

    def temperature(self, instance: int) -> float | None:
        """Mean temperature of an inertial unit, degC; None: it does not stream."""
        return mean_temperature(self._pool, instance)
