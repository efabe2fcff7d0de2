"""The links over which one vehicle is heard, and which of them is in use.

Everything is sent over one link, the one in use. Heartbeats and the echoes of writes count from every link. All other
messages count only from the link in use, so that nothing counts twice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from mavcal.service.errors import LinkDown
from mavcal.service.link.capacity import nominal_capacity
from mavcal.service.link.link import Link
from mavcal.service.vehicle.boot_time import BootClock
from mavcal.service.vehicle.state import SILENT_S

AWAY_S = 3.0
"""Silence of a link, s, in which the vehicle may have restarted unseen."""


class LinkChannel:
    """One link as a way to one vehicle."""

    def __init__(self, link: Link, now: float) -> None:
        self.link = link
        self.clock = BootClock()
        self.clock_heard = False
        """Whether it was heard since the last heartbeat."""
        self.last_heard: float | None = None
        self.last_heartbeat: float | None = None
        self.stated_at = now
        """Time when the vehicle last stated its identity here, or was found."""
        self.stranger: str | None = None
        """Unique id of another unit that answers here while ours is heard elsewhere; None: there is none."""
        self.apart_since: float | None = None
        """Time since which its clock contradicts that of the link in use; None: it does not."""

    def silent(self, now: float) -> bool:
        """Whether the last heartbeat over this link is more than 3 s older than what was read of it."""
        heard_until = min(now, self.link.heard_until)
        return self.last_heartbeat is None or heard_until - self.last_heartbeat > SILENT_S

    def hear(self, at: float, restarts: int) -> None:
        """Note that a frame has come; `restarts` of the vehicle are known by now."""
        if self.last_heard is not None and at - self.last_heard > AWAY_S and self.clock.restarts < restarts:
            self.missed(restarts)
        self.last_heard = at

    def missed(self, restarts: int) -> None:
        """Note that the vehicle restarted while this link was silent: its next time stamp belongs to the new boot."""
        self.clock.forget()
        self.clock.restarts = restarts


class Channels:
    """At least one channel; the first is the one in use."""

    def __init__(self, link: Link, clock: Callable[[], float]) -> None:
        self._clock = clock
        self.in_use = LinkChannel(link, clock())
        self._all = [self.in_use]

    def __iter__(self) -> Iterator[LinkChannel]:
        return iter(tuple(self._all))

    def __len__(self) -> int:
        return len(self._all)

    def of(self, link: Link) -> LinkChannel:
        """The channel of a link."""
        return next(channel for channel in self._all if channel.link is link)

    def join(self, channel: LinkChannel) -> None:
        """Add a link to the vehicle."""
        self._all.append(channel)

    def leave(self, link: Link) -> None:
        """Remove a link that is not the only one; if it was in use, the best of the others takes over."""
        gone = self.of(link)
        self._all.remove(gone)
        if gone is self.in_use:
            self.in_use = self._best(self._all)

    @property
    def alive(self) -> tuple[LinkChannel, ...]:
        """The links over which the vehicle is heard now."""
        now = self._clock()
        return tuple(channel for channel in self._all if not channel.silent(now))

    @property
    def heard_until(self) -> float:
        """The time until which every link has been read, s: now, or earlier if this program is late."""
        return min(self._clock(), *(channel.link.heard_until for channel in self._all))

    def overdue(self) -> bool:
        """Whether the link in use is silent while the vehicle is heard over another one."""
        return len(self._all) > 1 and self.in_use.silent(self._clock()) and bool(self.alive)

    def fail_over(self) -> bool:
        """Use the best of the other links over which the vehicle is heard; False: there is none."""
        others = [channel for channel in self.alive if channel is not self.in_use]
        if others:
            self.in_use = self._best(others)
        return bool(others)

    def prefer(self) -> bool:
        """Switch to a link with more capacity, only while no exchange is under way; True if it switched."""
        if len(self._all) == 1:
            return False
        best = self._best(list(self.alive) or [self.in_use])
        better = _carries(best) > _carries(self.in_use)
        if better:
            self.in_use = best
        return better

    @staticmethod
    def _best(channels: list[LinkChannel]) -> LinkChannel:
        """The link of highest capacity; among equals the first."""
        return max(channels, key=_carries)

    async def caught_up(self) -> None:
        """Return once everything received over any of them has been passed on.

        Raises
        ------
        LinkDown
            If none of them is connected and read.
        """
        error: LinkDown | None = None
        reached = False
        for channel in self:
            try:
                await channel.link.caught_up()
                reached = True
            except LinkDown as down:
                error = down
        if not reached and error is not None:
            raise error

    def restarted(self, restarts: int) -> None:
        """Note a restart on every link that is silent now and so cannot show it."""
        now = self._clock()
        for channel in self._all:
            if channel.silent(now) and channel.clock.restarts < restarts:
                channel.missed(restarts)


def _carries(channel: LinkChannel) -> float:
    """Nominal capacity of a link in bytes per second; infinite where no limit is known."""
    known = nominal_capacity(channel.link.endpoint)
    return math.inf if known is None else known
