"""Readers of events: each hears everything of its job, and nobody is woken for what is not his."""

from __future__ import annotations

import asyncio
from pathlib import Path

from mavcal.service.jobs.core.book import EventFeed
from mavcal.service.jobs.core.codec import row_from_job
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store import SqliteStore
from tests.unit.jobs.conftest import until

READERS, EVENTS = 30, 20


class Counted(EventFeed):
    """Counts how often a reader looks for news."""

    looks = 0

    def _goes_on_from(self, known: int) -> bool:
        self.looks += 1
        return super()._goes_on_from(known)


async def test_readers_of_a_job_sleep_through_the_events_of_others(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path)
    feed = Counted(store)
    for name in ("quiet", "busy"):
        store.save_job(row_from_job(Job(name, "v", "gyro", {}, JobState.RUNNING, 1.0, 1.0)))
    heard: dict[str, list[int]] = {"quiet": [], "busy": []}

    async def read(job_id: str) -> None:
        async for event in feed.subscribe(job_id, 0):
            heard[job_id].append(event.sequence)

    try:
        async with asyncio.TaskGroup() as readers:
            for _ in range(READERS):
                readers.create_task(read("quiet"))
            readers.create_task(read("busy"))
            await until(lambda: feed.looks == READERS + 1)
            for k in range(EVENTS):
                feed.publish(store.add_event("busy", 2.0, "note", {"k": k}))
                await until(lambda: len(heard["busy"]) == k + 1)  # noqa: B023
            assert feed.looks <= READERS + 1 + 2 * EVENTS  # those of one reader, not of all
            feed.publish(store.add_event("quiet", 3.0, "note", {}))
            await until(lambda: len(heard["quiet"]) == READERS)
            feed.close()
        assert heard["busy"] == list(range(1, EVENTS + 1))
    finally:
        store.close()
