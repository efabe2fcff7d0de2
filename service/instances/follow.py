"""Repeats here the job events of all instances: read from the database, in their order, as they come."""

from __future__ import annotations

import asyncio
from contextlib import suppress

import structlog

from mavcal.service.errors import StoreError
from mavcal.service.jobs.core.book import JobBook
from mavcal.service.store.rows import EventRow, JobRow
from mavcal.service.store.sql import Store

log = structlog.get_logger(__name__)

PERIOD_S = 0.5
"""How late an event of another instance is told; one of ours is told at once."""
PAGE = 500


class Follower:
    """Reads on after the newest event that was known at the start."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._after = store.last_event_id()
        self._loop = asyncio.get_running_loop()
        self._news = asyncio.Event()

    def news(self) -> None:
        """Notify that there is an event to read; callable from any thread."""
        with suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._news.set)

    async def run(self, book: JobBook) -> None:
        """Publish every event to the book, until cancelled."""
        while True:
            self._news.clear()
            try:
                while await self._page(book):
                    pass
            except StoreError as error:
                log.warning("events were not read", reason=str(error))
            with suppress(TimeoutError):  # no wait_for: Python 3.11 loses a cancellation that comes with the news
                async with asyncio.timeout(PERIOD_S):
                    await self._news.wait()

    async def _page(self, book: JobBook) -> bool:
        def read() -> tuple[tuple[EventRow, ...], dict[str, JobRow | None]]:
            events = self._store.events(after=self._after, limit=PAGE)
            return events, {event.job_id: self._store.job(event.job_id) for event in events if book.needs_row(event)}

        events, rows = await self._store.do(read)
        for event in events:
            self._after = event.id
            book.publish(event, rows.get(event.job_id))
        return len(events) == PAGE
