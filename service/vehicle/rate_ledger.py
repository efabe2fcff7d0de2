"""Message rates of one vehicle: its watchers, rates that are being restored, and what is set on which link.

A :class:`~service.vehicle.vehicle.Vehicle` owns it. Watches and returns belong to the unit: where it is found anew, its
new ledger takes them over (:class:`service.rates.ledger.RateLedgers`). What is set on a link ends with the vehicle.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from typing import Any

import structlog

log = structlog.get_logger(__name__)


class RateUser(StrEnum):
    """Who returns rates in a task of its own; watches are attended by :mod:`service.rates.watching`."""

    JOB = "job"
    PREFLIGHT = "preflight"


@dataclass
class LiveWatch:
    """One client's request to see samples; it lapses unless its stream goes on taking them."""

    id: str
    vehicle_id: str
    rate_hz: float
    until: float


@dataclass(frozen=True)
class _Return:
    """A return of rates in progress: its owner, its task and the intervals owed."""

    owner: str
    task: asyncio.Task[Any]
    intervals: Mapping[int, int] = field(default_factory=dict)


class RateLedger:
    """The message rates of one vehicle."""

    def __init__(self) -> None:
        self.watches: dict[str, LiveWatch] = {}
        self.requested_us: dict[int, float] = {}
        """Intervals requested and not restored yet on any link, us by message."""
        self._before_us: dict[str, dict[int, int]] = {}
        """Earlier intervals of each link, us by message; both firmwares keep a set for each port."""
        self._returns: dict[RateUser, _Return] = {}
        self._hurry = asyncio.Event()
        self._following: asyncio.Task[None] | None = None

    @property
    def in_use(self) -> bool:
        """Whether anybody watches, or rates are being returned."""
        return bool(self.watches) or any(self.returning(user) for user in RateUser)

    def join(self, other: RateLedger) -> None:
        """Take over watches and returns of a ledger of the same unit, but not the intervals set on its links."""
        self.watches |= other.watches
        taken = {user: found for user, found in other._returns.items() if not self.returning(user)}
        self._returns |= taken
        if RateUser.JOB in taken:
            self._hurry = other._hurry  # what waits there for an accept hears of whoever needs the rates
        else:
            other._hurry.set()

    def wanted_hz(self, now: float) -> float:
        """The highest rate of any watch, Hz; 0: there is none. Lapsed watches are dropped."""
        self.watches = {key: watch for key, watch in self.watches.items() if watch.until > now}
        return max((watch.rate_hz for watch in self.watches.values()), default=0.0)

    def begin_return(
        self,
        user: RateUser,
        work: Coroutine[Any, Any, Any] | asyncio.Task[Any],
        *,
        owner: str = "",
        intervals: Mapping[int, int] | None = None,
    ) -> asyncio.Task[Any]:
        """Note that `work` returns the rates of a user; `owner` names the job. The ledger holds it until it ends."""
        task = work if isinstance(work, asyncio.Task) else asyncio.create_task(work, name=f"rates of {user} {owner}")
        self._returns[user] = _Return(owner, task, intervals or {})
        if user is RateUser.JOB:
            task.add_done_callback(partial(_log_failure, owner))
        return task

    def returning(self, user: RateUser) -> bool:
        """Whether rates of this user are being returned, or kept for an accept."""
        return self._under_way(user) is not None

    @property
    def tasks(self) -> set[asyncio.Task[Any]]:
        """Returns of jobs that are under way."""
        found = self._under_way(RateUser.JOB)
        return set() if found is None else {found.task}

    async def returned(self, user: RateUser) -> None:
        """Wait until the rates of this user are returned; those of a job do not wait for an accept then."""
        with self.hurrying() if user is RateUser.JOB else nullcontext():
            while (found := self._under_way(user)) is not None:
                await asyncio.wait({found.task})

    async def kept_for(self, owner: str) -> bool:
        """Stop returning the rates of this job, which it needs again; False: none were being returned."""
        found = self._under_way(RateUser.JOB)
        if found is None or found.owner != owner:
            return False
        found.task.cancel()
        await asyncio.wait({found.task})
        return True

    def taken_over(self, user: RateUser) -> dict[int, int]:
        """Stop returning the rates of this user; the caller takes over the rest."""
        found = self._under_way(user)
        if found is None:
            return {}
        del self._returns[user]
        found.task.cancel()
        return dict(found.intervals)

    def _under_way(self, user: RateUser) -> _Return | None:
        found = self._returns.get(user)
        return None if found is None or found.task.done() else found

    @contextmanager
    def hurrying(self) -> Iterator[None]:
        """Keep no rates for an accept inside the block."""
        self._hurry.set()
        try:
            yield
        finally:
            self._hurry.clear()

    async def wait_for_hurry(self) -> None:
        """Wait until somebody needs the rates."""
        await self._hurry.wait()

    # --- links

    def note_before(self, way: str, message_id: int, interval_us: int) -> None:
        """Note the interval that a link had, unless one is noted."""
        self._before_us.setdefault(way, {}).setdefault(message_id, interval_us)

    def knows_before(self, way: str, message_id: int) -> bool:
        """Whether it is noted which interval a link had."""
        return message_id in self._before_us.get(way, {})

    def before_us(self, way: str, intervals: Mapping[int, int]) -> dict[int, int]:
        """`intervals` (us), replaced by those of this link where known."""
        known = self._before_us.get(way, {})
        return {message_id: known.get(message_id, interval) for message_id, interval in intervals.items()}

    def note_restored(self, way: str, message_ids: tuple[int, ...]) -> dict[str, dict[int, int]]:
        """Note these as restored on a link; returns those still to be restored on others, us by message by link."""
        left: dict[str, dict[int, int]] = {}
        for message_id in message_ids:
            self.requested_us.pop(message_id, None)
            for name, known in self._before_us.items():
                interval = known.pop(message_id, None)
                if name != way and interval is not None:
                    left.setdefault(name, {})[message_id] = interval
        return left

    def forget_link(self, way: str) -> None:
        """Forget a link that is gone, and its rates with it."""
        self._before_us.pop(way, None)

    def begin_following(self, follow: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Have `follow` request the rates on the link now in use; those of the previous link stay."""
        if self._following is not None:
            self._following.cancel()
        if self.requested_us:
            self._following = asyncio.get_running_loop().create_task(follow())

    async def followed(self) -> None:
        """Wait until the rates have followed to the link in use."""
        if self._following is not None:
            await asyncio.wait({self._following})


def _log_failure(owner: str, ended: asyncio.Task[Any]) -> None:
    if not ended.cancelled() and ended.exception() is not None:
        log.warning("message rates not returned", job=owner, reason=str(ended.exception()))
