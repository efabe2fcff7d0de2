"""Samples that a procedure keeps: channels put together tick by tick, joined only when a fit asks for them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from calib.procedures.roster import Frame, Instance
from calib.recording import Channel, Recording, Sensor, join


class Pool:
    """Kept frames of the instances of some sensors; :meth:`channel` joins them."""

    def __init__(self, sensors: Iterable[Sensor]) -> None:
        self._sensors = frozenset(sensors)
        self._parts: dict[Instance, list[Channel]] = {}

    def add(self, frame: Frame) -> None:
        """Keep the samples of a tick."""
        for instance, channel in frame.items():
            if instance[0] in self._sensors:
                self._parts.setdefault(instance, []).append(channel)

    def __contains__(self, instance: Instance) -> bool:
        return instance in self._parts

    def channel(self, instance: Instance) -> Channel:
        """All kept samples of `instance`."""
        parts = self._parts[instance]
        if len(parts) > 1:
            parts[:] = [join(Recording((part,)) for part in parts).channels[0]]
        return parts[0]

    def get(self, instance: Instance) -> Channel | None:
        """All kept samples of `instance`; None: there are none."""
        return self.channel(instance) if instance in self else None


class Tail:
    """Holds back the last ticks of a still run: the onset of a movement is in them before it is noticed."""

    def __init__(self, ticks: int) -> None:
        self._held: deque[Frame] = deque()
        self._ticks = ticks

    def push(self, frame: Frame) -> Frame | None:
        """Take a tick; return the one that is old enough to be kept, if there is one."""
        self._held.append(frame)
        return self._held.popleft() if len(self._held) > self._ticks else None
