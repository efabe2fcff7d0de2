"""Message rates of jobs: requested, remembered in the journal, put back."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Awaitable, Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress

import structlog

from mavcal.service.errors import ServiceError, VehicleUnknown
from mavcal.service.jobs.core.admission import require_vehicle
from mavcal.service.jobs.core.handle import JobHandle, waiting
from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import PHYSICAL, JobState
from mavcal.service.preflights import Preflights
from mavcal.service.vehicle.job_vehicle import JobVehicle, VehicleSource

log = structlog.get_logger(__name__)

ASKING_S = 1.0
"""About how long it takes to ask for messages and to hear that they are granted."""


async def ask_for_streams(
    handle: JobHandle, vehicle: JobVehicle, rates: Mapping[int, float], *, measure_s: float = 0.0
) -> None:
    """Have messages sent at `rates` (Hz by message id).

    What was before is in the journal before anything is changed. Raises VehicleError, LinkError.
    """
    known = handle.written().intervals
    measured = ", and measuring what the link carries" if measure_s > 0 else ""
    async with waiting(handle, f"starting the sensor streams{measured}", measure_s + ASKING_S):
        before = await vehicle.intervals([message for message in rates if message not in known])
        if before:
            await handle.record(JournalStep.STREAMS, intervals={str(k): v for k, v in before.items()})
        warnings = await vehicle.request_streams(rates, measure_s=measure_s, before={**known, **before})
    for warning in warnings:
        handle.warn(warning)


async def restore_streams(handle: JobHandle, vehicle: JobVehicle) -> None:
    """Put the message rates back that the journal remembers; one that fails is a warning, and is tried again later."""
    intervals = handle.written().intervals
    if not intervals:
        return
    try:
        await vehicle.set_intervals(intervals)
    except ServiceError as error:
        handle.warn(f"the message rates could not be put back yet: {error}")
        return
    await handle.record_anyway(JournalStep.STREAMS_RESTORED)


class Tidying:
    """The tasks that put rates back.

    `vehicle` waits for the vehicle of a job; `leaving` names tasks of jobs that are over.

    A job in review keeps its rates for `review_s`: an accept that follows at once needs the same ones.
    """

    def __init__(
        self,
        vehicle: Callable[[JobHandle], Awaitable[JobVehicle]],
        review_s: float,
        leaving: Callable[[str], set[asyncio.Task[None]]] = lambda _: set(),
    ) -> None:
        self._vehicle, self._review_s, self._leaving = vehicle, review_s, leaving
        self._of: dict[str, tuple[str, asyncio.Task[None]]] = {}
        """Job and task by vehicle."""
        self._hurry = asyncio.Event()

    @property
    def tasks(self) -> set[asyncio.Task[None]]:
        """Those that are under way."""
        return {task for _, task in self._of.values()}

    def begin(self, handle: JobHandle) -> None:
        """Put back what this job has left changed, if anything."""
        if not handle.written().intervals:
            return
        vehicle_id = require_vehicle(handle.job)
        task = asyncio.create_task(self._put_back(handle), name=f"rates of {handle.id}")
        mine = self._of[vehicle_id] = (handle.id, task)

        def done(ended: asyncio.Task[None]) -> None:
            if self._of.get(vehicle_id) is mine:
                del self._of[vehicle_id]
            if not ended.cancelled() and ended.exception() is not None:
                log.warning("message rates not put back", job=handle.id, reason=str(ended.exception()))

        task.add_done_callback(done)

    def holds(self, vehicle_id: str) -> bool:
        """Whether rates of this vehicle are being put back, or kept for an accept."""
        return vehicle_id in self._of

    async def finished(self, running: Callable[[], set[asyncio.Task[None]]]) -> None:
        """Wait for everything that is to be put back by now, and by the tasks that `running` names."""
        with self.hurrying():
            while waited := running() | self.tasks:
                await asyncio.wait(waited)

    async def before_capture(self, vehicle_id: str) -> None:
        """Wait until an earlier job of this vehicle has its rates put back, and do not let that wait for an accept.

        A job that was just cancelled has asked for messages a moment ago, and has not begun to put them back.
        """
        if leaving := self._leaving(vehicle_id):
            await asyncio.wait(leaving)
        _, task = self._of.get(vehicle_id, ("", None))
        if task is not None:
            with self.hurrying():
                await asyncio.wait({task})

    async def before_write(self, handle: JobHandle) -> None:
        """Keep the rates of this job's capture, which the write needs too; those of another job are put back first."""
        job_id, task = self._of.get(require_vehicle(handle.job), ("", None))
        if task is not None and job_id == handle.id:
            task.cancel()
            await asyncio.wait({task})
        else:
            await self.before_capture(require_vehicle(handle.job))

    @contextmanager
    def hurrying(self) -> Iterator[None]:
        """Meanwhile no rates are kept for an accept."""
        self._hurry.set()
        try:
            yield
        finally:
            self._hurry.clear()

    async def _put_back(self, handle: JobHandle) -> None:
        if handle.job.state == JobState.REVIEW:
            with suppress(TimeoutError):
                async with asyncio.timeout(self._review_s):  # no wait_for: that of Python 3.11 can lose a cancellation
                    await self._hurry.wait()
        await restore_streams(handle, await self._vehicle(handle))


TAKING_UP = "The service is finishing what was interrupted at its last stop; the vehicle is asked for samples then."


def claim_of(
    vehicle_id: str, jobs: Iterable[Job], running: Collection[str], tidying: Tidying, preflights: Preflights
) -> str | None:
    """In a sentence, for who would like to watch; None: nothing has them.

    `running`: the ids of jobs whose task is not over, whatever their state says.
    """
    for job in jobs:
        if job.vehicle_id == vehicle_id and (job.state in PHYSICAL or job.id in running):
            return f"A job ({job.kind}) has chosen which messages the vehicle sends; these are shown."
    if preflights.holds(vehicle_id):
        return "A preflight has chosen which messages the vehicle sends; these are shown."
    if tidying.holds(vehicle_id):
        return "The message rates are still those of the last job; they are put back first."
    return None


def named_now(jobs: Iterable[Job], vehicles: VehicleSource) -> Iterator[Job]:
    """Jobs, and of those that claim a vehicle the name that it has by now: another link may have named it before."""
    for job in jobs:
        if job.vehicle_id is None or job.state not in PHYSICAL:
            yield job
            continue
        try:
            yield dataclasses.replace(job, vehicle_id=vehicles.vehicle(job.vehicle_id).id)
        except VehicleUnknown:
            yield job
