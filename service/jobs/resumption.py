"""Resumes the jobs that an earlier run left: interrupted writes first and alone, the others when these have ended."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence

import structlog

from mavcal.service.jobs.handle import JobHandle
from mavcal.service.jobs.states import WRITING
from mavcal.service.jobs.tasks import JobTasks

log = structlog.get_logger(__name__)

How = Callable[[JobHandle], None]


class Resumption:
    """Takes jobs up where they were left, however their run ended.

    Parameters
    ----------
    tasks
        Where the work of a job runs.
    alone_s
        For so long other jobs wait for interrupted writes.
    recover, resume
        Take up a job that was writing, and any other one.
    """

    def __init__(self, tasks: JobTasks, alone_s: float, *, recover: How, resume: How) -> None:
        self._tasks = tasks
        self._alone_s = alone_s
        self._recover, self._resume = recover, resume
        self.waiting: set[asyncio.Task[None]] = set()
        """Those that wait for writes to end."""

    def begin(self, handles: Sequence[JobHandle]) -> None:
        """Take these jobs up."""
        writes = [handle for handle in handles if handle.job.state in WRITING]
        for handle in writes:
            _taken_up(handle, self._recover)
        others = [handle for handle in handles if handle not in writes]
        running = [task for handle in writes if (task := self._tasks.running.get(handle.id)) is not None]
        if running:
            task = asyncio.create_task(self._follow(running, others))
            self.waiting.add(task)
            task.add_done_callback(self.waiting.discard)
        else:
            self._take_up(others)

    async def _follow(self, writes: Iterable[asyncio.Task[None]], others: Sequence[JobHandle]) -> None:
        await asyncio.wait(tuple(writes), timeout=self._alone_s)
        self._take_up(others)

    def _take_up(self, handles: Iterable[JobHandle]) -> None:
        for handle in handles:
            _taken_up(handle, self._resume)


def _taken_up(handle: JobHandle, how: How) -> None:
    """Take one job up; what is wrong with it must not keep the others waiting."""
    try:
        how(handle)
    except Exception:  # of any kind: one job must not strand the writes after it; logged with its trace
        log.exception("job not taken up", job=handle.id, state=handle.job.state)
