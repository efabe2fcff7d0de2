"""Events of all instances, told here once, in their order, whoever kept them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager

import pytest

from mavcal.service.errors import StoreError
from mavcal.service.instances import instance
from mavcal.service.instances.instance import Follower
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import EventRow, JobRow
from tests.patience import scaled


class Book:
    """What was told of; it knows the jobs of `known`."""

    def __init__(self, *known: str) -> None:
        self.known = set(known)
        self.told: list[tuple[EventRow, JobRow | None]] = []
        self.changed = asyncio.Event()

    def needs_row(self, event: EventRow) -> bool:
        return event.job_id not in self.known

    def publish(self, event: EventRow, row: JobRow | None) -> None:
        self.told.append((event, row))
        self.changed.set()

    async def until(self, count: int) -> None:
        async with asyncio.timeout(60):
            while len(self.told) < count:
                self.changed.clear()
                await self.changed.wait()


def row(job_id: str, state: str = "queued") -> JobRow:
    return JobRow(job_id, None, "fit", state, 1.0, 1.0, {})


@pytest.fixture
def store() -> Iterator[SqliteStore]:
    made = SqliteStore(None)
    yield made
    made.close()


@pytest.fixture(autouse=True)
def _no_look_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only news wake the follower, except where a test says otherwise."""
    monkeypatch.setattr(instance, "PERIOD_S", 3600.0)


@asynccontextmanager
async def following(follower: Follower, book: Book) -> AsyncIterator[None]:
    task = asyncio.create_task(follower.run(book))  # type: ignore[arg-type]
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_what_was_known_at_the_start_is_not_told_again(store: SqliteStore) -> None:
    store.save_job(row("a"), event=("state", {"n": 0}))
    follower, book = Follower(store), Book()
    store.add_event("a", 2.0, "progress", {"n": 1})
    async with following(follower, book):
        await book.until(1)
    assert [event.data["n"] for event, _ in book.told] == [1]


async def test_every_event_is_told_once_and_in_order_over_many_pages(
    store: SqliteStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(instance, "PAGE", 3)
    store.save_job(row("a"))
    follower, book = Follower(store), Book("a")
    for n in range(7):
        store.add_event("a", 1.0, "progress", {"n": n})
    async with following(follower, book):
        await book.until(7)
        store.add_event("a", 1.0, "progress", {"n": 7})
        follower.news()
        await book.until(8)
    assert [event.data["n"] for event, _ in book.told] == list(range(8))


async def test_the_row_of_a_job_comes_with_an_event_that_asks_for_it(store: SqliteStore) -> None:
    follower, book = Follower(store), Book("ours")
    for job_id in ("ours", "theirs"):
        store.save_job(row(job_id, "fitting"), event=("state", {}))
    async with following(follower, book):
        await book.until(2)
    assert [found for _, found in book.told] == [None, row("theirs", "fitting")]


async def test_events_of_others_are_found_without_news(store: SqliteStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(instance, "PERIOD_S", 0.001)
    store.save_job(row("a"))
    follower, book = Follower(store), Book()
    async with following(follower, book):
        for _ in range(3):
            await asyncio.sleep(0)
        store.add_event("a", 1.0, "progress", {})
        await book.until(1)


async def test_a_database_that_is_away_for_a_while_costs_no_event(
    store: SqliteStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(instance, "PERIOD_S", 0.001)
    store.save_job(row("a"))
    follower, book = Follower(store), Book()
    store.add_event("a", 1.0, "progress", {})
    read, failures = store.events, 0

    def fail_twice(*arguments: object, **options: object) -> tuple[EventRow, ...]:
        nonlocal failures
        failures += 1
        if failures <= 2:
            raise StoreError("it is away")
        return read(*arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(store, "events", fail_twice)
    async with following(follower, book):
        await book.until(1)
    assert failures > 2
    assert len(book.told) == 1


@pytest.mark.parametrize("steps", range(6))
async def test_news_at_the_moment_of_the_stop_do_not_keep_it_going(store: SqliteStore, steps: int) -> None:
    """`asyncio.wait_for` of Python 3.11 takes such a cancellation for itself, and the service never ended."""
    follower, book = Follower(store), Book()
    store.save_job(row("a"), event=("state", {}))
    task = asyncio.create_task(follower.run(book))  # type: ignore[arg-type]
    await book.until(1)
    for _ in range(20):  # it waits for news
        await asyncio.sleep(0)
    follower.news()
    for _ in range(steps):
        await asyncio.sleep(0)
    task.cancel()
    await asyncio.wait({task}, timeout=scaled(2))
    assert task.cancelled()


def test_news_after_the_end_of_the_loop_are_no_error(store: SqliteStore) -> None:
    """The store's thread may still keep an event while the service stops."""

    async def made() -> Follower:
        return Follower(store)

    asyncio.run(made()).news()
