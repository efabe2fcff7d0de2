"""Runs one task for each job, resumes what an earlier run left, and recovers a write whose task was lost."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Sequence
from functools import partial

import structlog

from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Failure
from mavcal.service.jobs.core.states import CAPTURING, ENDED, WRITING, JobState

log = structlog.get_logger(__name__)

Work = Callable[[], Awaitable[None]]
How = Callable[[JobHandle], None]
LOST = "the write lost its task, by a defect of the program; its log says more"


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
        self.resuming: set[asyncio.Task[None]] = set()
        """Tasks in which jobs wait to be resumed until interrupted writes have ended."""

    def spawn(self, handle: JobHandle, work: Work) -> None:
        """Run a job's work as its task."""
        task = asyncio.create_task(self._supervised(handle, work), name=f"job {handle.id}")
        self.running[handle.id], self._handles[handle.id] = task, handle
        task.add_done_callback(partial(self._over, handle))

    def ending_tasks(self, vehicle_id: str | None = None) -> set[asyncio.Task[None]]:
        """Tasks of jobs that are over, and still hold this vehicle or any: a cancelled one ends a moment later."""
        over = ENDED | {JobState.REVIEW}
        jobs = ((task, self._handles[job_id].job) for job_id, task in self.running.items())
        return {task for task, job in jobs if vehicle_id in {None, job.vehicle_id} and job.state in over}

    def cancel(self, job_id: str) -> None:
        """Cancel the task of a job, if it has one."""
        task = self.running.get(job_id)
        if task is not None:
            task.cancel()

    async def _supervised(self, handle: JobHandle, work: Work) -> None:
        """Run a job's work; whatever breaks, a job that is not at an end is never left without a task.

        A job has a second task if an operator takes a write back while the first still checks the vehicle after it. The
        first then leaves the job alone.
        """
        pause = 0.0
        while True:
            try:
                await work()
            except asyncio.CancelledError as error:
                task = asyncio.current_task()
                if self.stopping or (task is not None and task.cancelling()):
                    raise  # a stop of the service is a crash: the journal decides at the next start
                note_defect(handle, error)
            except Exception as error:  # noqa: BLE001 - every kind of defect; `note_defect` logs it with its trace
                note_defect(handle, error)
            if handle.job.state not in WRITING or self.running.get(handle.id) is not asyncio.current_task():
                return
            await asyncio.sleep(pause)
            pause = self._retry_s
            work = partial(self._recovered, handle, LOST)

    def resume(self, handles: Sequence[JobHandle], recover: How, resume: How, *, alone_s: float) -> None:
        """Take jobs up where an earlier run left them, however it ended.

        Interrupted writes are recovered first and alone; the others are resumed when these have ended, or after
        `alone_s`.
        """
        writes = [handle for handle in handles if handle.job.state in WRITING]
        _each(writes, recover)
        others = [handle for handle in handles if handle not in writes]
        running = [task for handle in writes if (task := self.running.get(handle.id)) is not None]

        async def follow() -> None:
            await asyncio.wait(running, timeout=alone_s)
            _each(others, resume)

        if running:
            task = asyncio.create_task(follow())
            self.resuming.add(task)
            task.add_done_callback(self.resuming.discard)
        else:
            _each(others, resume)

    def _over(self, handle: JobHandle, task: asyncio.Task[None]) -> None:
        if self.running.get(handle.id) is task:
            del self.running[handle.id], self._handles[handle.id]
            self._ended(handle)


def note_defect(handle: JobHandle, error: BaseException) -> None:
    """Note a defect in a job's work; a job that has written nothing ends with it."""
    log.error("job broke", job=handle.id, state=handle.job.state, exc_info=error)
    if handle.job.state in CAPTURING | {JobState.FITTING}:
        cause = f"a defect of the program ended the job ({type(error).__name__})"
        remedy = "Its log says more. What was recorded is kept."
        handle.move(JobState.FAILED, outcome=Failure("internal-error", cause, remedy), prompt=None)


def _each(handles: Iterable[JobHandle], how: How) -> None:
    """Resume each job; an error in one does not delay the others."""
    for handle in handles:
        try:
            how(handle)
        except Exception:  # of any kind: one job must not strand the writes after it; logged with its trace
            log.exception("job not taken up", job=handle.id, state=handle.job.state)
