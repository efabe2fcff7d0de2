"""Events to whoever watches: none lost, none twice, whatever arrives while somebody reads."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest

from mavcal.service.jobs.core import book as feed_module
from mavcal.service.jobs.core.book import EventFeed
from mavcal.service.jobs.core.codec import row_from_job
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import EventRow
from tests.patience import scaled
from tests.unit.jobs.conftest import until


class Watched:
    """A store, its feed, and readers of it."""

    def __init__(self) -> None:
        self.store = SqliteStore(None)
        self.feed = EventFeed(self.store)
        self.read: list[EventRow] = []
        for job_id in "ab":
            self.store.save_job(row_from_job(Job(job_id, "v", "gyro", {}, JobState.RUNNING, 0.0, 0.0)))

    def tell(self, job_id: str) -> EventRow:
        event = self.store.add_event(job_id, 0.0, "state", {})
        self.feed.publish(event)
        return event

    async def follow(self, job_id: str | None, after: int = 0) -> None:
        async for event in self.feed.subscribe(job_id, after):
            self.read.append(event)

    @property
    def ids(self) -> list[int]:
        return [event.id for event in self.read]


@pytest.fixture
def watched() -> Iterator[Watched]:
    found = Watched()
    yield found
    found.feed.close()
    found.store.close()


async def ended(task: asyncio.Task[None], watched: Watched) -> None:
    watched.feed.close()
    async with asyncio.timeout(scaled(5.0)):
        await task


async def test_a_reader_of_one_job_gets_its_events_alone_old_ones_first(watched: Watched) -> None:
    for job_id in ("a", "b", "a"):
        watched.tell(job_id)
    reading = asyncio.create_task(watched.follow("a"))
    await until(lambda: len(watched.read) == 2)
    for job_id in ("b", "a", "b", "b", "a"):
        watched.tell(job_id)
    await until(lambda: len(watched.read) == 4)
    await ended(reading, watched)
    assert watched.ids == [1, 3, 5, 8]
    assert [event.sequence for event in watched.read] == [1, 2, 3, 4]


async def test_a_reader_of_all_jobs_gets_each_event_once(watched: Watched) -> None:
    watched.tell("a")
    reading = asyncio.create_task(watched.follow(None, after=1))
    await asyncio.sleep(0)
    for k in range(40):
        watched.tell("ab"[k % 2])
        await asyncio.sleep(0)
    await until(lambda: len(watched.read) == 40)
    await ended(reading, watched)
    assert watched.ids == list(range(2, 42))


async def test_a_reader_that_lags_behind_what_is_in_memory_reads_on_from_the_store(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feed_module, "RECENT", 3)
    taken: asyncio.Semaphore = asyncio.Semaphore(0)

    async def slowly() -> None:
        async for event in watched.feed.subscribe(None, 0):
            watched.read.append(event)
            await taken.acquire()

    reading = asyncio.create_task(slowly())
    watched.tell("a")
    await until(lambda: watched.ids == [1])
    for _ in range(30):
        watched.tell("a")
    for _ in range(100):
        taken.release()
    await until(lambda: len(watched.read) == 31)
    await ended(reading, watched)
    assert watched.ids == list(range(1, 32))


async def test_an_event_that_never_came_by_is_read_from_the_store(watched: Watched) -> None:
    reading = asyncio.create_task(watched.follow(None))
    watched.tell("a")
    await until(lambda: watched.ids == [1])
    watched.store.add_event("a", 0.0, "state", {})  # kept, and not announced
    watched.tell("a")
    await until(lambda: len(watched.read) == 3)
    await ended(reading, watched)
    assert watched.ids == [1, 2, 3]


async def test_nobody_is_told_anything_after_the_end(watched: Watched) -> None:
    watched.feed.close()
    await watched.follow(None)
    assert watched.read == []


async def test_an_event_that_was_never_announced_is_read_from_the_store(watched: Watched) -> None:
    watched.tell("a")
    reading = asyncio.create_task(watched.follow(None, after=1))
    await asyncio.sleep(0)
    watched.tell("a")
    await until(lambda: watched.ids == [2])
    watched.store.add_event("a", 0.0, "state", {})
    watched.tell("b")
    await until(lambda: watched.ids == [2, 3, 4])
    await ended(reading, watched)


@pytest.mark.parametrize("job_id", ["a", None])
async def test_a_reader_gets_only_what_comes_behind_its_place(watched: Watched, job_id: str | None) -> None:
    """Also of events that are in memory alone: its place may be ahead of the store, say of one that was put back."""
    reading = asyncio.create_task(watched.follow(job_id, after=2))
    await until(lambda: bool(watched.feed._news))
    for _ in range(4):
        watched.tell("a")
    await until(lambda: len(watched.read) >= 2)
    await ended(reading, watched)
    assert watched.ids == [3, 4]


async def test_no_more_events_are_in_memory_than_twice_the_recent_ones(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feed_module, "RECENT", 3)
    reading = asyncio.create_task(watched.follow(None))
    sizes = []
    for k in range(20):
        watched.tell("a")
        await until(lambda: len(watched.read) == k + 1)  # noqa: B023
        sizes.append(len(watched.feed._recent))
    await ended(reading, watched)
    assert max(sizes) < 6
    assert min(sizes[5:]) >= 3
