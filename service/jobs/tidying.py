"""Puts back the message rates that jobs have left changed, one vehicle at a time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress

import structlog

from mavcal.service.jobs.admission import require_vehicle
from mavcal.service.jobs.handle import JobHandle
from mavcal.service.jobs.port import JobVehicle
from mavcal.service.jobs.states import JobState
from mavcal.service.jobs.streams import restore_streams

log = structlog.get_logger(__name__)


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
