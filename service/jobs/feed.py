"""Streams job events to those who watch: replayed from the store, then as they come; a slow reader misses none."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress

from mavcal.service.store.protocol import JobStore
from mavcal.service.store.rows import EventRow

PAGE = 200
RECENT = 1000
"""Events that are handed on without asking the store; a reader that lags more reads on from there."""


class EventFeed:
    """The store is the buffer; the newest events are in memory as well, so that idle readers cost nothing."""

    def __init__(self, store: JobStore) -> None:
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
