"""Samples that a procedure keeps: channels collected tick by tick, joined in blocks and for fits."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence

from mavcal.calib.procedures.roster import Instance, TickChannels
from mavcal.calib.recording import Channel, Recording, Sensor, join

BLOCK = 64
"""Ticks joined into one block: a tick holds a dozen samples, which cost less memory than its objects."""


class Pool:
    """Kept frames of the instances of some sensors; :meth:`channel` joins them."""

    def __init__(self, sensors: Iterable[Sensor]) -> None:
        self._sensors = frozenset(sensors)
        self._parts: dict[Instance, list[Channel]] = {}
        self._recent: dict[Instance, list[Channel]] = {}

    def add(self, frame: TickChannels) -> None:
        """Keep the samples of a tick."""
        for instance, channel in frame.items():
            if instance[0] in self._sensors:
                self._parts.setdefault(instance, [])
                recent = self._recent.setdefault(instance, [])
                recent.append(channel)
                if len(recent) >= BLOCK:
                    self._parts[instance].append(joined(recent))
                    recent.clear()

    def __contains__(self, instance: Instance) -> bool:
        return instance in self._parts

    def channel(self, instance: Instance) -> Channel:
        """All kept samples of `instance`."""
        parts = [*self._parts[instance], *self._recent[instance]]
        self._parts[instance], self._recent[instance] = [joined(parts)], []
        return self._parts[instance][0]

    def get(self, instance: Instance) -> Channel | None:
        """All kept samples of `instance`; None: there are none."""
        return self.channel(instance) if instance in self else None


def joined(parts: Sequence[Channel]) -> Channel:
    """One channel of `parts`, which are of one sensor and in order of time."""
    return join(Recording((part,)) for part in parts).channels[0]


class Tail:
    """Delays the last ticks of a still run, since they contain the onset of a movement before it is detected."""

    def __init__(self, ticks: int) -> None:
        self._held: deque[TickChannels] = deque()
        self._ticks = ticks

    def push(self, frame: TickChannels) -> TickChannels | None:
        """Take a tick; return the one that is old enough to be kept, if there is one."""
        self._held.append(frame)
        return self._held.popleft() if len(self._held) > self._ticks else None
