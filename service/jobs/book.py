"""Every job of the service: held while it runs, listed, told about, and forgotten."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from functools import partial

from mavcal.service.errors import DocumentUnknown, JobUnknown
from mavcal.service.jobs.feed import EventFeed
from mavcal.service.jobs.handle import JobHandle
from mavcal.service.jobs.model import Job
from mavcal.service.jobs.salvage import job_of
from mavcal.service.store.protocol import Store
from mavcal.service.store.rows import EventRow, JobDocument


class JobBook:
    """The jobs of all kinds and vehicles, by id, oldest first.

    Parameters
    ----------
    store
        Holds every job.
    progress_s
        Progress is announced at most so often.
    clock, wall
        Monotonic time for pauses; wall time for stamps.
    """

    def __init__(self, store: Store, progress_s: float, clock: Callable[[], float], wall: Callable[[], float]) -> None:
        self._store = store
        self._progress_s, self._clock, self._wall = progress_s, clock, wall
        self._feed = EventFeed(store)
        self._handles: dict[str, JobHandle] = {}

    def load(self) -> list[JobHandle]:
        """Take every job out of the store."""
        return [self._hold(job_of(row, self._store)) for row in self._store.jobs()]

    def close(self) -> None:
        """End every subscription."""
        self._feed.close()

    def list(self) -> tuple[Job, ...]:
        """Every job, oldest first."""
        return tuple(handle.job for handle in self._handles.values())

    def handle(self, job_id: str) -> JobHandle:
        """Holds the job of that id. Raises JobUnknown."""
        handle = self._handles.get(job_id)
        if handle is None:
            raise JobUnknown(f"there is no job {job_id}")
        return handle

    def subscribe(self, job_id: str | None, after: int) -> AsyncIterator[EventRow]:
        """Events after `after` (a sequence of that job, or an id over all jobs), for ever. Raises JobUnknown."""
        if job_id is not None:
            self.handle(job_id)
        return self._feed.subscribe(job_id, after)

    async def document(self, job_id: str, name: str) -> JobDocument:
        """A document that the job has made. Raises JobUnknown, DocumentUnknown."""
        job = self.handle(job_id).job
        found = await self._store.do(partial(self._store.document, job_id, name))
        if found is None:
            raise DocumentUnknown(f"job {job_id} is {job.state} and has no document {name}")
        return found

    async def new(self, job: Job) -> JobHandle:
        """A job that is in the store, or not there at all. Raises DiskFull."""
        handle = self._hold(job)
        try:
            handle.change("state", {"state": job.state.value, "outcome": None})
            await handle.kept()
        except BaseException:
            del self._handles[job.id]
            raise
        return handle

    def forget(self, job_id: str) -> None:
        """Remove a job that has ended and never wrote."""
        del self._handles[job_id]
        self._store.soon(partial(self._store.delete_job, job_id))

    def _hold(self, job: Job) -> JobHandle:
        handle = JobHandle(
            job,
            self._store,
            self._feed.publish,
            progress_s=self._progress_s,
            wall=self._wall,
            clock=self._clock,
        )
        self._handles[job.id] = handle
        return handle
