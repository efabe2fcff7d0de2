"""Message rates of jobs: requests, restoring by the journal, and the present user of a vehicle's rates."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Awaitable, Callable, Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, suppress
from typing import Any

from mavcal.service.errors import ServiceError, VehicleUnknown
from mavcal.service.jobs.core.admission import require_vehicle
from mavcal.service.jobs.core.handle import JobHandle, waiting
from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import PHYSICAL, JobState
from mavcal.service.rates.ledger import RateLedgers, request_rates, return_rates
from mavcal.service.vehicle.job_vehicle import JobVehicle, VehicleSource
from mavcal.service.vehicle.rate_ledger import RateUser

ASKING_S = 1.0
"""Approximate time to request messages and receive the confirmation, s."""
STARTING = "The service is finishing what was interrupted at its last stop; the vehicle is asked for samples then."


@dataclasses.dataclass(frozen=True)
class JournalOwed:
    """Message intervals that a job has to restore, kept in its journal; see :class:`service.rates.ledger.Owed`."""

    handle: JobHandle

    def intervals(self) -> Mapping[int, int]:
        """The intervals that are owed."""
        return self.handle.write_record().intervals

    async def owe(self, before: Mapping[int, int]) -> None:
        """Owe these as well. Raises DiskFull."""
        await self.handle.record(JournalStep.STREAMS, intervals={str(k): v for k, v in before.items()})

    async def returned(self) -> None:
        """Note that every interval was returned."""
        await self.handle.record_anyway(JournalStep.STREAMS_RESTORED)


async def ask_for_streams(
    handle: JobHandle, vehicle: JobVehicle, rates: Mapping[int, float], *, measure_s: float = 0.0
) -> None:
    """Have messages sent at `rates` (Hz by message id). Raises VehicleError, LinkError."""
    measured = ", and measuring what the link carries" if measure_s > 0 else ""
    async with waiting(handle, f"starting the sensor streams{measured}", measure_s + ASKING_S):
        warnings = await request_rates(vehicle, rates, JournalOwed(handle), measure_s=measure_s)
    for warning in warnings:
        handle.warn(warning)


async def return_streams(handle: JobHandle, vehicle: JobVehicle) -> None:
    """Return the message rates that the job owes; a failure is a warning, and is tried again later."""
    try:
        await return_rates(vehicle, JournalOwed(handle))
    except ServiceError as error:
        handle.warn(f"the message rates could not be put back yet: {error}")


class JobRates:
    """Returns the rates of jobs that are over, and tells who has the rates of a vehicle.

    A job in review keeps its rates for `review_s`: an accept that follows at once needs the same ones.

    Parameters
    ----------
    ledgers
        Those of all vehicles.
    vehicle
        Waits for the vehicle of a job.
    review_s
        See above.
    ending_tasks
        Names tasks of jobs that are over and still hold a vehicle.
    """

    def __init__(
        self,
        ledgers: RateLedgers,
        vehicle: Callable[[JobHandle], Awaitable[JobVehicle]],
        review_s: float,
        ending_tasks: Callable[..., set[asyncio.Task[None]]] = lambda *_: set(),
    ) -> None:
        self._ledgers = ledgers
        self._vehicle, self._review_s, self._ending_tasks = vehicle, review_s, ending_tasks
        self._turns: dict[str, asyncio.Lock] = {}

    @property
    def tasks(self) -> set[asyncio.Task[Any]]:
        """Returns that are under way."""
        return {task for ledger in self._ledgers.all() for task in ledger.tasks}

    def begin_return(self, handle: JobHandle) -> None:
        """Return the rates that this job owes, if any."""
        if handle.write_record().intervals:
            ledger = self._ledgers.of(require_vehicle(handle.job))
            ledger.begin_return(RateUser.JOB, self._return(handle), owner=handle.id)

    def turn(self, handle: JobHandle) -> asyncio.Lock:
        """Lock of whoever sets the rates of the job's vehicle: a capture, a write or its recovery, or a return.

        At a start a job that is over may still owe rates to a vehicle on which a write is recovered.
        """
        return self._turns.setdefault(require_vehicle(handle.job), asyncio.Lock())

    async def all_returned(self) -> None:
        """Wait until every job that is over has returned its rates."""
        while waited := self._ending_tasks() | self.tasks:
            with ExitStack() as hurrying:
                for ledger in self._ledgers.all():
                    hurrying.enter_context(ledger.hurrying())
                await asyncio.wait(waited)

    async def before_capture(self, vehicle_id: str) -> None:
        """Wait until earlier users have returned the vehicle's rates; none waits for an accept any more."""
        await self._ledgers.of(vehicle_id).returned(RateUser.PREFLIGHT)
        await self.before_preflight(vehicle_id)

    async def before_preflight(self, vehicle_id: str) -> None:
        """Wait until earlier jobs of this vehicle have returned its rates; a preflight takes over those of another.

        A job that was just cancelled has asked for messages a moment ago, and has not begun to return them.
        """
        if ending_tasks := self._ending_tasks(vehicle_id):
            await asyncio.wait(ending_tasks)
        await self._ledgers.of(vehicle_id).returned(RateUser.JOB)

    async def before_write(self, handle: JobHandle) -> None:
        """Keep the rates of this job's capture, which the write needs too; those of another job are returned first."""
        vehicle_id = require_vehicle(handle.job)
        await self._ledgers.of(vehicle_id).returned(RateUser.PREFLIGHT)
        if not await self._ledgers.of(vehicle_id).kept_for(handle.id):
            await self.before_preflight(vehicle_id)

    def user(self, vehicle_id: str, jobs: Iterable[Job], running: Collection[str], *, looked_at: bool) -> str | None:
        """A sentence on the job or preflight that sets the message rates of a vehicle; None: none does.

        `running` are the ids of jobs whose task is not over, whatever their state says.
        """
        for job in jobs:
            if job.vehicle_id == vehicle_id and (job.state in PHYSICAL or job.id in running):
                return f"A job ({job.kind}) has chosen which messages the vehicle sends; these are shown."
        ledger = self._ledgers.of(vehicle_id)
        if looked_at or ledger.returning(RateUser.PREFLIGHT):
            return "A preflight has chosen which messages the vehicle sends; these are shown."
        if ledger.returning(RateUser.JOB):
            return "The message rates are still those of the last job; they are put back first."
        return None

    async def _return(self, handle: JobHandle) -> None:
        if handle.job.state == JobState.REVIEW:
            with suppress(TimeoutError):
                async with asyncio.timeout(self._review_s):  # no wait_for: that of Python 3.11 can lose a cancellation
                    await self._ledgers.of(require_vehicle(handle.job)).wait_for_hurry()
        vehicle = await self._vehicle(handle)
        async with self.turn(handle):
            await return_streams(handle, vehicle)


def with_present_vehicles(jobs: Iterable[Job], vehicles: VehicleSource) -> Iterator[Job]:
    """The jobs, with the present id of their vehicle: another link may have given it another one."""
    for job in jobs:
        if job.vehicle_id is None or job.state not in PHYSICAL:
            yield job
            continue
        try:
            yield dataclasses.replace(job, vehicle_id=vehicles.vehicle(job.vehicle_id).id)
        except VehicleUnknown:
            yield job
