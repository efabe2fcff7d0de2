"""Measured streams: rates by the vehicle's own time stamps, from the first sample on, and losses.

A vehicle may begin a second after the request, and this process may be held up by others. Neither tells anything about
the link. The measures are therefore time stamps, sequence numbers and the age of the youngest samples.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from mavcal.calib.wire.frames import Frame
from mavcal.service.link.capacity import Arrivals
from mavcal.service.link.types import Batch, LinkStatistics
from mavcal.service.vehicle.boot_time import own_time

if TYPE_CHECKING:
    from mavcal.service.vehicle.vehicle import Vehicle

START_S = 5.0
"""Longest wait for the first sample, s: a vehicle was seen to begin 0.97 s after it was asked, and may be busier."""
OTHERS_S = 3.0
"""Longest delay of a stream behind the first sample of any other, s."""
LONGEST_S = 10.0
"""Longest watch of a stream whose time stamps advance too slowly, s after the first sample."""
_LOOK_S = 0.05
_PARTS = 3
_FEWEST = 9
"""Fewest samples from which the delays of the first and last third are compared."""


class Meter:
    """Counts one message: its time stamps, and their delays up to a constant."""

    def __init__(self) -> None:
        self.count = 0
        self.first = self.last = 0.0
        self.first_at = self.last_at = 0.0
        self._lags: list[tuple[float, float]] = []

    def see(self, frame: Frame, at: float) -> None:
        """Count a frame that arrived at `at`, s of the wall clock."""
        stamp = own_time(frame) or 0.0
        if not self.count:
            self.first, self.first_at = stamp, at
        self.last, self.last_at = stamp, at
        self.count += 1
        self._lags.append((stamp, at - stamp))

    @property
    def span(self) -> float:
        """Seconds of the vehicle's time; of the wall clock for messages without a stamp."""
        return self.last - self.first if self.last != self.first else self.last_at - self.first_at

    def rate(self, wall_rate: float) -> float:
        """Messages per second of the vehicle's time, or `wall_rate` if too few came."""
        span = self.last - self.first
        return (self.count - 1) / span if self.count > 2 and span > 0 else wall_rate

    def queued(self) -> float:
        """Growth of the delay, s per s: above 0 a buffer on the way fills.

        The youngest samples of the first and the last third are compared: a process that is held up sees some samples
        late, but never all.
        """
        span = self.last - self.first
        if span <= 0 or self.count < _FEWEST:
            return 0.0
        early = [lag for stamp, lag in self._lags if stamp - self.first <= span / _PARTS]
        late = [lag for stamp, lag in self._lags if self.last - stamp <= span / _PARTS]
        grown = min(late, default=0.0) - min(early, default=0.0)
        return max(grown / (span * (_PARTS - 1) / _PARTS), 0.0)


class Watch:
    """Counts the arrivals of some messages, from the first one on."""

    def __init__(self, vehicle: Vehicle, message_ids: Collection[int]) -> None:
        self.meters = {message_id: Meter() for message_id in message_ids}
        self._vehicle = vehicle
        self._link = vehicle.link
        """Link whose losses are counted, even if another one comes into use meanwhile."""
        self._began: tuple[float, LinkStatistics] | None = None

    @property
    def first_at(self) -> float | None:
        """Time of the first sample; None: none has come yet."""
        return None if self._began is None else self._began[0]

    def take(self, frames: Sequence[Frame], batch: Batch) -> None:
        """See :meth:`Vehicle.subscribe`."""
        if self._began is None:
            self._began = self._vehicle.clock(), self._statistics()
        for frame in frames:
            self.meters[frame.message_id].see(frame, batch.received_at)

    def arrivals(self, began: float) -> Arrivals:
        """The counts so far; `began` is the start of the watch, s of the wall clock."""
        now, after = self._vehicle.clock(), self._statistics()
        since, before = self._began or (began, after)
        elapsed = now - since
        wall = {key: meter.count / elapsed if elapsed > 0 else 0.0 for key, meter in self.meters.items()}
        received, lost = after.received - before.received, max(after.lost - before.lost, 0)
        return Arrivals(
            own_hz={key: meter.rate(wall[key]) for key, meter in self.meters.items()},
            wall_hz=wall,
            loss=lost / (received + lost) if received + lost > 0 else 0.0,
            bytes_per_s=(after.bytes_received - before.bytes_received) / elapsed if elapsed > 0 else 0.0,
            queued={key: meter.queued() for key, meter in self.meters.items()},
        )

    def _statistics(self) -> LinkStatistics:
        return self._link.statistics(self._vehicle.system, self._vehicle.component)


async def watch(vehicle: Vehicle, message_ids: Collection[int], seconds: float, fast: Collection[int] = ()) -> Arrivals:
    """Watch these messages.

    Parameters
    ----------
    vehicle
        Whose.
    message_ids
        Which.
    seconds
        How long, by the time stamps of those in `fast` from the first of each on; 0: not at all.
    fast
        Those of samples, which are waited for; none: `seconds` of the wall clock are watched.
    """
    seen = Watch(vehicle, message_ids)
    forget = vehicle.subscribe(frozenset(message_ids), seen.take)
    began = vehicle.clock()
    try:
        while seconds > 0 and not _enough(seen, began, vehicle.clock(), seconds, fast):
            await vehicle.waits.sleep(_LOOK_S)
    finally:
        forget()
    return seen.arrivals(began)


def _enough(seen: Watch, began: float, now: float, seconds: float, fast: Collection[int]) -> bool:
    if not fast:
        return now - began >= seconds
    if seen.first_at is None:
        return now - began >= START_S
    elapsed = now - seen.first_at
    coming = [seen.meters[key] for key in fast if seen.meters[key].count]
    if elapsed >= LONGEST_S + seconds:
        return True
    if not coming or (len(coming) < len(fast) and elapsed < OTHERS_S):
        return False
    return min((meter.span for meter in coming), default=math.inf) >= seconds
