"""All jobs of the service: holds the running ones, lists them all, and streams their events."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any

from mavcal.calib.procedures.protocol import Progress, Prompt
from mavcal.service.errors import DocumentUnknown, JobElsewhere, JobUnknown
from mavcal.service.jobs.core.codec import from_json, job_of
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.ports import Ownership
from mavcal.service.store.rows import EventRow, JobDocument, JobRow
from mavcal.service.store.sql import Store

UNSTORED: Mapping[str, tuple[Any, str]] = {
    "progress": (Progress | None, "progress"),
    "prompt": (Prompt | None, "prompt"),
}
"""Events that change a field of a job and no row of the store, with that field."""


class JobBook:
    """The jobs of all kinds and vehicles, by id, oldest first.

    Parameters
    ----------
    store
        Holds every job.
    ownership
        Which of them are ours. The others are known as the store last told of them.
    progress_s
        Progress is announced at most so often.
    clock, wall
        Monotonic time for pauses; wall time for stamps.
    """

    def __init__(
        self,
        store: Store,
        ownership: Ownership,
        progress_s: float,
        clock: Callable[[], float],
        wall: Callable[[], float],
    ) -> None:
        self._store = store
        self._ownership = ownership
        self._progress_s, self._clock, self._wall = progress_s, clock, wall
        self._feed = EventFeed(store)
        self._handles: dict[str, JobHandle] = {}
        self._others: dict[str, Job] = {}

    def load(self) -> list[JobHandle]:
        """Load every job of the store."""
        return self.take(self._store.each_job())

    def take(self, rows: Iterable[JobRow]) -> list[JobHandle]:
        """Take over these jobs."""
        return [self._hold(job_of(row, self._store)) for row in rows]

    def drop(self, of: Callable[[Job], bool]) -> list[JobHandle]:
        """Release these jobs to another instance; their last state stays listed."""
        dropped = [handle for handle in self._handles.values() if of(handle.job)]
        for handle in dropped:
            del self._handles[handle.id]
            self._others[handle.id] = handle.job
        return dropped

    def watch(self) -> None:
        """List every job of the store without owning one."""
        self._others = {row.id: job_of(row, self._store) for row in self._store.each_job()}

    def needs_row(self, event: EventRow) -> bool:
        """Whether the job of the event has to be read from the store: another instance owns it, and its row changed."""
        return event.job_id not in self._handles and not (event.kind in UNSTORED and event.job_id in self._others)

    def publish(self, event: EventRow, row: JobRow | None) -> None:
        """Publish an event; update a job that another instance owns from the event or from the job's `row`."""
        if event.job_id not in self._handles:
            if row is not None:
                self._others[row.id] = job_of(row, self._store)
            elif event.kind in UNSTORED and event.job_id in self._others:
                kind, field = UNSTORED[event.kind]
                change: dict[str, Any] = {field: from_json(dict(event.data), kind) if event.data else None}
                self._others[event.job_id] = dataclasses.replace(self._others[event.job_id], **change)
        self._feed.publish(event)

    def close(self) -> None:
        """End every subscription."""
        self._feed.close()

    def list(self) -> tuple[Job, ...]:
        """Every job, oldest first."""
        ours = tuple(handle.job for handle in self._handles.values())
        if not self._others:
            return ours
        return tuple(sorted((*ours, *self._others.values()), key=lambda job: job.created_at))

    def job(self, job_id: str) -> Job:
        """The job of that id, whichever instance owns it. Raises JobUnknown."""
        other = self._others.get(job_id)
        return self.handle(job_id).job if other is None else other

    def holds(self, handle: JobHandle) -> bool:
        """Whether this instance still owns that job."""
        return self._handles.get(handle.id) is handle

    def handle(self, job_id: str) -> JobHandle:
        """The handle of the job. Raises JobUnknown, or JobElsewhere if another instance owns it."""
        handle = self._handles.get(job_id)
        if handle is not None:
            return handle
        if job_id in self._others:
            raise JobElsewhere(f"job {job_id} belongs to another instance of the service, or to none yet: ask that one")
        raise JobUnknown(f"there is no job {job_id}")

    def subscribe(self, job_id: str | None, after: int) -> AsyncIterator[EventRow]:
        """Events after `after` (a sequence of that job, or an id over all jobs), for ever. Raises JobUnknown."""
        if job_id is not None:
            self.job(job_id)
        return self._feed.subscribe(job_id, after)

    async def document(self, job_id: str, name: str) -> JobDocument:
        """A document that the job has made. Raises JobUnknown, DocumentUnknown."""
        job = self.job(job_id)
        found = await self._store.do(partial(self._store.document, job_id, name))
        if found is None:
            raise DocumentUnknown(f"job {job_id} is {job.state} and has no document {name}")
        return found

    async def new(self, job: Job) -> JobHandle:
        """Add a job and store it; if it cannot be stored, it is not added. Raises DiskFull."""
        await self._ownership.begin(job)
        handle = self._hold(job)
        try:
            handle.change("state", {"state": job.state.value, "outcome": None})
            await handle.kept()
        except BaseException:
            del self._handles[job.id]
            raise
        return handle

    async def kept(self, limit_s: float) -> None:
        """Store the unsaved changes of every job within `limit_s`, at the end of the service."""
        await self._store.do(lambda: None)  # what was refused last is known only then
        await asyncio.gather(*(handle.kept_at_last(limit_s) for handle in self._handles.values() if handle.owes))

    def forget(self, job_id: str) -> None:
        """Remove a job that has ended and never wrote."""
        self._handles.pop(job_id, None)
        self._others.pop(job_id, None)
        self._store.soon(partial(self._store.delete_job, job_id))

    def _hold(self, job: Job) -> JobHandle:
        handle = JobHandle(
            job,
            self._ownership.store_of(job),
            (lambda _: self._ownership.changed()) if self._ownership.shared else self._feed.publish,
            progress_s=self._progress_s,
            wall=self._wall,
            clock=self._clock,
        )
        self._handles[job.id] = handle
        self._others.pop(job.id, None)
        return handle


PAGE = 200
RECENT = 1000
"""Events that are handed on without asking the store; a reader that lags more reads on from there."""


class EventFeed:
    """Serves events from the store, and the newest from memory, so that idle readers cost nothing."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._news: dict[str | None, asyncio.Event] = {}
        """One for the readers of each job, and one for those of all jobs (None): who waits is woken by its own."""
        self._recent: list[EventRow] = []
        self._loop: asyncio.AbstractEventLoop | None = None
        self._closed = False

    def publish(self, event: EventRow) -> None:
        """Hand on an event that the store has; from any thread, in the order of their ids."""
        if self._loop is not None:
            with suppress(RuntimeError):  # the loop has ended, and every reader with it
                self._loop.call_soon_threadsafe(self._arrived, event)

    def close(self) -> None:
        """End every subscription."""
        self._closed = True
        for key in tuple(self._news):
            self._wake(key)

    async def subscribe(self, job_id: str | None, after: int) -> AsyncIterator[EventRow]:
        """Events after `after`: a sequence number of that job, or an id over all jobs if `job_id` is None."""
        self._loop = asyncio.get_running_loop()
        while not self._closed:
            known = await self._store.do(self._store.last_event_id)
            from_store = await self._store.do(lambda: self._store.events(job_id, after=after, limit=PAGE))  # noqa: B023
            for event in from_store:
                after = _place(event, job_id)
                yield event
            while not from_store and not self._closed and self._goes_on_from(known):
                news = self._news.setdefault(job_id, asyncio.Event())
                fresh = self._recent[known + 1 - self._recent[0].id :] if self._recent else []
                for event in fresh:
                    known = event.id
                    if job_id in {None, event.job_id} and _place(event, job_id) > after:
                        after = _place(event, job_id)
                        yield event
                if not fresh:
                    await news.wait()

    def _goes_on_from(self, known: int) -> bool:
        """Whether nothing is missing between that id and the events in memory."""
        return not self._recent or self._recent[0].id <= known + 1

    def _arrived(self, event: EventRow) -> None:
        if self._recent and event.id != self._recent[-1].id + 1:
            self._recent = []
        self._recent.append(event)
        if len(self._recent) >= 2 * RECENT:
            self._recent = self._recent[-RECENT:]
        for key in (event.job_id, None):
            self._wake(key)

    def _wake(self, key: str | None) -> None:
        news = self._news.pop(key, None)
        if news is not None:
            news.set()


def _place(event: EventRow, job_id: str | None) -> int:
    return event.id if job_id is None else event.sequence
