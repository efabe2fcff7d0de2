"""Events of jobs to whoever watches: replayed from the store, then as they come; none is lost to a slow reader."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

from service.store.protocol import JobStore
from service.store.rows import EventRow

PAGE = 200


class EventFeed:
    """The store is the buffer: a reader that lags reads on from there."""

    def __init__(self, store: JobStore) -> None:
        self._store = store
        self._news = asyncio.Event()
        self._closed = False

    def publish(self, _: EventRow) -> None:
        """Tell the readers that the store has more."""
        news, self._news = self._news, asyncio.Event()
        news.set()

    def close(self) -> None:
        """End every subscription."""
        self._closed = True
        self._news.set()

    async def subscribe(self, job_id: str | None, after: int) -> AsyncIterator[EventRow]:
        """Events after `after`: a sequence number of that job, or an id over all jobs if `job_id` is None."""
        while not self._closed:
            news = self._news
            events = self._store.events(job_id, after=after, limit=PAGE)
            for event in events:
                after = event.id if job_id is None else event.sequence
                yield event
            if not events:
                await news.wait()
