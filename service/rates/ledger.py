"""One ledger a vehicle: who watches it at which rate, and whose rates are being returned.

Both firmwares keep one set of rates for a link, so only one user has them at a time. A job goes before a preflight,
and either before those who watch. Each keeps the intervals of before somewhere (:class:`Owed`) until they are returned.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from typing import Any, Protocol

import structlog

from mavcal.service.errors import VehicleUnknown
from mavcal.service.rates.owed import OwedRates
from mavcal.service.vehicle.job_vehicle import JobVehicle, VehicleSource

log = structlog.get_logger(__name__)


class RateUser(StrEnum):
    """Who returns rates in a task of its own; watches are attended by :mod:`service.rates.watching`."""

    JOB = "job"
    PREFLIGHT = "preflight"


class Owed(Protocol):
    """Keeps message intervals (us by message: -1 off, 0 the vehicle's default) as they were before a change."""

    def intervals(self) -> Mapping[int, int]:
        """The intervals that are owed to the vehicle."""
        ...

    async def owe(self, before: Mapping[int, int]) -> None:
        """Owe these as well. On the disk before anything is changed, where they have to survive a crash."""
        ...

    async def returned(self) -> None:
        """Nothing is owed any more."""
        ...


async def request_rates(
    vehicle: JobVehicle, rates: Mapping[int, float], owed: Owed, *, measure_s: float
) -> tuple[str, ...]:
    """Have messages sent at `rates` (Hz); returns what comes slower, in sentences. Raises VehicleError, LinkError."""
    known = owed.intervals()
    before = await vehicle.intervals([message_id for message_id in rates if message_id not in known])
    if before:
        await owed.owe(before)
    return await vehicle.request_streams(rates, measure_s=measure_s, before={**known, **before})


async def return_rates(vehicle: JobVehicle, owed: Owed) -> None:
    """Restore the intervals that are owed. Raises VehicleError, LinkError; all of them are still owed then."""
    intervals = owed.intervals()
    if intervals:
        await vehicle.set_intervals(intervals)
        await owed.returned()


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
        self._returns: dict[RateUser, _Return] = {}
        self._hurry = asyncio.Event()

    @property
    def in_use(self) -> bool:
        """Whether anybody watches, or rates are being returned."""
        return bool(self.watches) or any(self.returning(user) for user in RateUser)

    def join(self, other: RateLedger) -> None:
        """Take over the ledger of what turned out to be the same vehicle."""
        self.watches |= other.watches
        other._hurry.set()  # what waits there for an accept would not hear of anybody else who needs the rates
        self._returns |= {user: found for user, found in other._returns.items() if not self.returning(user)}

    def wanted_hz(self, now: float) -> float:
        """The fastest rate that anybody watches at; 0: nobody watches. Watches that have lapsed are forgotten."""
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
        """End a return of this job's rates, which are needed again; False: there is none."""
        found = self._under_way(RateUser.JOB)
        if found is None or found.owner != owner:
            return False
        found.task.cancel()
        await asyncio.wait({found.task})
        return True

    def taken_over(self, user: RateUser) -> dict[int, int]:
        """End a return of this user's rates; what it owes is the caller's from now on."""
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


class RateLedgers:
    """The ledgers of all vehicles.

    Parameters
    ----------
    vehicles
        Where vehicles are found.
    kept
        Rates owed to vehicles that were watched; None: nobody watches.
    """

    def __init__(self, vehicles: VehicleSource, kept: OwedRates | None = None) -> None:
        self.vehicles, self.kept = vehicles, kept
        self._all: dict[str, RateLedger] = {}

    def of(self, vehicle_id: str) -> RateLedger:
        """The ledger of a vehicle, by any id that it has had; not to be held over an await.

        A vehicle gets its lasting id when it has said which unit it is, and may turn out to be one on another link.
        """
        present = self._present_id(vehicle_id)
        found = self._all.get(present)
        if found is None:
            self._all = {key: ledger for key, ledger in self._all.items() if ledger.in_use}
            found = self._all[present] = RateLedger()
        for key in [key for key in self._all if key != present and self._present_id(key) == present]:
            found.join(self._all.pop(key))
        return found

    def all(self) -> tuple[RateLedger, ...]:
        """Every ledger in use."""
        return tuple(ledger for ledger in self._all.values() if ledger.in_use)

    def _present_id(self, vehicle_id: str) -> str:
        try:
            return self.vehicles.vehicle(vehicle_id).id
        except VehicleUnknown:
            return vehicle_id


def _log_failure(owner: str, ended: asyncio.Task[Any]) -> None:
    if not ended.cancelled() and ended.exception() is not None:
        log.warning("message rates not returned", job=owner, reason=str(ended.exception()))
