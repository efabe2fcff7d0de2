"""Runs one task for each job, and another one whenever a task ends before its write does."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from functools import partial

from mavcal.service.jobs.ending import LOST, broke
from mavcal.service.jobs.handle import JobHandle
from mavcal.service.jobs.states import ENDED, WRITING, JobState

Work = Callable[[], Awaitable[None]]


class JobTasks:
    """The tasks of all jobs.

    Parameters
    ----------
    retry_s
        Pause before a write whose task broke is taken up once more.
    recovered
        Takes up a write that was left, for a reason.
    ended
        Called with a job whose task is over.
    """

    def __init__(
        self,
        retry_s: float,
        recovered: Callable[[JobHandle, str], Awaitable[None]],
        ended: Callable[[JobHandle], None],
    ) -> None:
        self._retry_s, self._recovered, self._ended = retry_s, recovered, ended
        self.running: dict[str, asyncio.Task[None]] = {}
        self._handles: dict[str, JobHandle] = {}
        self.stopping = False
        """Set before the tasks of a stopping service are cancelled."""

    def spawn(self, handle: JobHandle, work: Work) -> None:
        """Run a job's work as its task."""
        task = asyncio.create_task(self._supervised(handle, work), name=f"job {handle.id}")
        self.running[handle.id], self._handles[handle.id] = task, handle
        task.add_done_callback(partial(self._over, handle))

    def leaving(self, vehicle_id: str) -> set[asyncio.Task[None]]:
        """Tasks of jobs that are over and still hold this vehicle: one that was cancelled ends a moment later."""
        over = ENDED | {JobState.REVIEW}
        jobs = ((task, self._handles[job_id].job) for job_id, task in self.running.items())
        return {task for task, job in jobs if job.vehicle_id == vehicle_id and job.state in over}

    def cancel(self, job_id: str) -> None:
        """Cancel the task of a job, if it has one."""
        task = self.running.get(job_id)
        if task is not None:
            task.cancel()

    async def _supervised(self, handle: JobHandle, work: Work) -> None:
        """Run a job's work; whatever breaks, a job that is not at an end is never left without a task.

        A job has a second task while the first still looks at the vehicle after a write and an operator takes the
        write back: the first then leaves the job alone.
        """
        pause = 0.0
        while True:
            try:
                await work()
            except asyncio.CancelledError as error:
                task = asyncio.current_task()
                if self.stopping or (task is not None and task.cancelling()):
                    raise  # a stop of the service is a crash: the journal decides at the next start
                broke(handle, error)
            except Exception as error:  # noqa: BLE001 - every kind of defect; `broke` logs it with its trace
                broke(handle, error)
            if handle.job.state not in WRITING or self.running.get(handle.id) is not asyncio.current_task():
                return
            await asyncio.sleep(pause)
            pause = self._retry_s
            work = partial(self._recovered, handle, LOST)

    def _over(self, handle: JobHandle, task: asyncio.Task[None]) -> None:
        if self.running.get(handle.id) is task:
            del self.running[handle.id], self._handles[handle.id]
            self._ended(handle)
