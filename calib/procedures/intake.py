"""Cuts chunks of any size into ticks of fixed length on the vehicle's clock.

A procedure decides at ticks, whose content does not depend on how the samples were chunked. It therefore takes the same
steps live, from a replayed log and in a test. A tick is closed when samples later than its end by :data:`GRACE` have
arrived. Messages reordered by less still fall into their own tick.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.recording import Channel, Recording, Sensor, Stage, join

TICK = 0.25
"""Length of a tick, s: a human notices a delay of more, and a 10 Hz compass still has two samples in it."""

GRACE = 0.5
"""How long a tick stays open after its end for samples of other messages, s."""

BACKWARD = 1.0
"""Step back of the time stamps, s, above which the vehicle restarted; less is a late datagram."""

SANE = 1e6
"""Largest valid reading of any sensor in any unit used here."""

Key = tuple[Sensor, int, str]

_USED = frozenset({Sensor.ACCEL, Sensor.GYRO, Sensor.MAG, Sensor.TEMPERATURE})
_BREAKS = {
    "reboot": ("the vehicle restarted", "wait until it is up again and start the job again"),
    "armed": ("the vehicle was armed", "disarm it and start the job again"),
    "onboard_calibration": (
        "the vehicle began a calibration of its own, which changes what it streams",
        "let it finish or cancel it, then start the job again",
    ),
}


@dataclass(frozen=True, eq=False)
class Tick:
    """The samples with ``start <= t < end``, by channel key."""

    start: float
    end: float
    channels: dict[Key, Channel]


@dataclass(frozen=True)
class Break:
    """Nothing after `t` belongs to this capture."""

    t: float
    cause: str
    remedy: str


@dataclass
class Intake:
    """Sorts chunks into ticks, drops invalid rows and detects the break of a capture."""

    dropped: dict[Key, int] = field(default_factory=dict)
    """Number of non-finite rows, by channel."""
    horizon: float = -math.inf
    """Latest time stamp heard."""
    broken: Break | None = None
    _buffers: dict[Key, _Buffer] = field(default_factory=dict)
    _next: int | None = None
    _kept: frozenset[Key] | None = None

    def add(self, chunk: Recording) -> None:
        """Take the samples of `chunk`."""
        for event in chunk.events:
            if event.kind in _BREAKS:
                self._break(event.t, *_BREAKS[event.kind])
        for channel in chunk.channels:
            wanted = channel.sensor in _USED if self._kept is None else channel.key in self._kept
            if wanted and channel.stage != Stage.DEBIASED and len(channel):
                self._append(channel)

    def keep(self, keys: Iterable[Key]) -> None:
        """Keep only these channels from now on."""
        self._kept = frozenset(keys)
        self._buffers = {key: buffer for key, buffer in self._buffers.items() if key in self._kept}

    def ticks(self, *, to_the_end: bool = False) -> Iterator[Tick]:
        """The complete ticks; with `to_the_end` also incomplete ones."""
        limit = self.horizon - GRACE
        while True:
            first = min((b.first for b in self._buffers.values() if b.first is not None), default=None)
            if first is None:
                return
            index = math.floor(first / TICK) if self._next is None else max(self._next, math.floor(first / TICK))
            start, end = index * TICK, (index + 1) * TICK
            if end > limit and not (to_the_end or self.broken):
                return
            if self.broken and first >= self.broken.t:
                return
            self._next = index + 1
            channels = self._cut(start, min(end, self.broken.t) if self.broken else end)
            if channels:
                yield Tick(start, end, channels)

    def _cut(self, start: float, end: float) -> dict[Key, Channel]:
        parts = {}
        for key, buffer in self._buffers.items():
            part = buffer.take(start, end)
            if part is None:
                continue
            # abs < bound is False for NaN too
            good: NDArray[np.bool_] = np.logical_and.reduce(np.abs(part.values) < SANE, axis=1)
            if not good.all():
                self.dropped[key] = self.dropped.get(key, 0) + int(np.count_nonzero(~good))
                part = part.take(good)
            if len(part):
                parts[key] = part
        return parts

    def _append(self, channel: Channel) -> None:
        stamped = np.isfinite(channel.t)
        if not stamped.all():
            channel = channel.take(stamped)
        buffer = self._buffers.setdefault(channel.key, _Buffer())
        back = np.flatnonzero(np.diff(channel.t, prepend=buffer.last) < -BACKWARD)
        if back.size:
            at = int(back[0])
            before = float(channel.t[at - 1]) if at else buffer.last
            self._break(math.nextafter(before, math.inf), *_BREAKS["reboot"])
            channel = channel.take(slice(0, at))
        if self.broken:
            channel = channel.take(channel.t < self.broken.t)
        if len(channel):
            buffer.append(channel)
            self.horizon = max(self.horizon, float(channel.t.max()))

    def _break(self, t: float, cause: str, remedy: str) -> None:
        if self.broken is None or t < self.broken.t:
            self.broken = Break(t, cause, remedy)


class _Buffer:
    """Samples of one channel that are not yet in a tick."""

    def __init__(self) -> None:
        self.last = -math.inf
        self._head: Channel | None = None
        self._at = 0
        self._parts: list[Channel] = []

    def append(self, channel: Channel) -> None:
        self._parts.append(channel)
        self.last = max(self.last, float(channel.t[-1]))

    @property
    def first(self) -> float | None:
        """Earliest time stamp of the waiting samples; None: none wait."""
        waiting = [float(p.t.min()) for p in self._parts]
        if self._head is not None and self._at < len(self._head):
            waiting.append(float(self._head.t[self._at]))
        return min(waiting, default=None)

    def take(self, start: float, end: float) -> Channel | None:
        """The waiting samples with ``start <= t < end``; None: there is none. Older ones came too late: dropped."""
        head = self._merged()
        if head is None:
            return None
        i, j = (int(k) for k in np.searchsorted(head.t, (start, end)))
        i, self._at = max(i, self._at), max(j, self._at)
        return head.take(slice(i, j)) if j > i else None

    def _merged(self) -> Channel | None:
        if not self._parts:
            return self._head
        rest = [] if self._head is None else [self._head.take(slice(self._at, None))]
        merged = join(Recording((part,)) for part in [*rest, *self._parts]).channels[0]
        if (np.diff(merged.t) < 0).any():
            merged = merged.take(np.argsort(merged.t, kind="stable"))
        self._head, self._at, self._parts = merged, 0, []
        return merged
