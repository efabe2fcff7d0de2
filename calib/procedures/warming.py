"""Temperatures of the inertial units over time: span and rate of the warm-up."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mavcal.calib.procedures.roster import TickChannels
from mavcal.calib.recording import Sensor

_PARTS = (0.0, 0.25, 0.5)
"""Shares of the last minute after which it is extrapolated from."""
_SPREAD = 0.25
"""Share of what is left by which these may differ."""
_NEAR = 1.0
"""degC by which they always may."""


@dataclass(frozen=True)
class WarmUpEnd:
    """Where a temperature is heading."""

    left: float
    """Seconds until its rate falls below the bound."""
    at: float
    """Where it ends, degC."""
    spread: float
    """How far extrapolations from parts of the last minute differ from that, degC."""


class Warmth:
    """Follows every unit's temperature."""

    def __init__(self, over: float) -> None:
        self._over = over
        self._all = _Range()
        self._kept = _Range()
        self._history: deque[tuple[float, float]] = deque()
        self.now: dict[int, float] = {}
        """Latest temperature of every unit, degC."""

    def update(self, frame: TickChannels, units: tuple[int, ...]) -> None:
        """Take a tick; only `units` count."""
        for unit in set(self.now) - set(units):
            del self.now[unit]
        self._all.add(frame, units)
        for unit in units:
            channel = frame.get((Sensor.TEMPERATURE, unit))
            if channel is not None:
                self.now[unit] = float(channel.values[-1, 0])
                if unit == min(self.now):
                    self._history.append((float(channel.t[-1]), self.now[unit]))
        while len(self._history) > 2 and self._history[-1][0] - self._history[1][0] >= self._over:
            self._history.popleft()

    def keep(self, frame: TickChannels) -> None:
        """The samples of `frame` are kept for the fit."""
        self._kept.add(frame, tuple(self.now))

    @property
    def moved(self) -> float:
        """Range that every unit went through, degC."""
        return self._all.least(self.now)

    @property
    def span(self) -> float:
        """Range that was kept of every unit, degC."""
        return self._kept.least(self.now)

    @property
    def rate(self) -> float:
        """Rate of the first unit over the last minute, degC/s; 0 as long as it is not known."""
        if len(self._history) < 2:
            return 0.0
        (t0, first), (t1, last) = self._history[0], self._history[-1]
        return (last - first) / (t1 - t0) if t1 > t0 else 0.0

    def settles(self, bound: float) -> WarmUpEnd | None:
        """When the rate falls below `bound` (degC per minute), and where the first unit's temperature ends.

        Told by how the rate fell within the last minute, as a body's does that comes to the temperature around it.
        The later parts of that minute tell it again. None as long as it does not fall, or the parts disagree: a curve
        that has hardly bent yet says nothing of its end.
        """
        if len(self._history) < 3 or self._history[-1][0] - self._history[0][0] < 0.5 * self._over:
            return None
        begin, (end, last) = self._history[0][0], self._history[-1]
        found = []
        for share in _PARTS:
            start = begin + share * (end - begin)
            rate = _extrapolated([point for point in self._history if point[0] >= start])
            if rate is None:
                return None
            found.append(rate)
        constant, at = found[0]
        spread = max(abs(other - at) for _, other in found[1:])
        if spread > max(_SPREAD * abs(at - last), _NEAR):
            return None
        left = constant * math.log(max(abs(self.rate) * 60.0 / bound, 1.0))
        return WarmUpEnd(left, at, spread)

    def is_steady(self, bound: float) -> bool:
        """Whether the rate over a whole minute lies below `bound` (degC per minute)."""
        if len(self._history) < 2 or self._history[-1][0] - self._history[0][0] < self._over:
            return False
        return abs(self.rate) * 60.0 < bound


def _extrapolated(history: Sequence[tuple[float, float]]) -> tuple[float, float] | None:
    """Time constant (s) and end (degC) of the exponential through the first, the middle and the last point."""
    if len(history) < 3:
        return None
    middle = 0.5 * (history[0][0] + history[-1][0])
    (t0, first), (t2, last) = history[0], history[-1]
    t1, between = min(history, key=lambda point: abs(point[0] - middle))
    if not t0 < t1 < t2:
        return None
    early, late = (between - first) / (t1 - t0), (last - between) / (t2 - t1)
    if early * late <= 0.0 or abs(late) >= 0.98 * abs(early):
        return None
    constant = 0.5 * (t2 - t0) / math.log(early / late)
    now = late * math.exp(-0.5 * (t2 - t1) / constant)
    return constant, last + now * constant


class _Range:
    """Lowest and highest temperature of every unit."""

    def __init__(self) -> None:
        self._ends: dict[int, tuple[float, float]] = {}

    def add(self, frame: TickChannels, units: Iterable[int]) -> None:
        for unit in units:
            channel = frame.get((Sensor.TEMPERATURE, unit))
            if channel is not None:
                low, high = float(channel.values.min()), float(channel.values.max())
                known = self._ends.get(unit, (low, high))
                self._ends[unit] = (min(known[0], low), max(known[1], high))

    def least(self, units: Iterable[int]) -> float:
        ends = [self._ends.get(unit, (0.0, 0.0)) for unit in units]
        return min((high - low for low, high in ends), default=0.0)
