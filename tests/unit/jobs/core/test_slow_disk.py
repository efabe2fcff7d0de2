"""A disk that takes long to commit, such as an SD card: the event loop goes on, and the journal still comes first."""

from __future__ import annotations

import asyncio
import sqlite3
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest

from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store import SqliteStore
from tests.patience import patience
from tests.unit.jobs.conftest import NEW, OLD, MakeBench, float32, until
from tests.unit.jobs.fakes import FakeVehicle
from tests.unit.jobs.test_engine import reviewed, running

COMMIT_S = 0.25
TURNS = 3
"""Turns of the event loop that a commit may wait for: one may have been under way when it began."""


class SlowStore(SqliteStore):
    """Commits take long; notes the threads in which they were made, and whether the event loop went on meanwhile."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.threads: set[int] = set()
        self.turns: int | None = None
        """Turns of the event loop, while somebody counts them."""
        self.stood_still = 0
        """Commits that the event loop waited for."""

    def _commit(self, durable: bool) -> None:
        self.threads.add(threading.get_ident())
        if durable:
            time.sleep(COMMIT_S)
            self._wait_for_turns()
        super()._commit(durable)

    def _wait_for_turns(self) -> None:
        """A machine that is late gives the loop its turns later; a loop that waits for this commit never has them."""
        before, limit = self.turns, patience(5.0)
        while before is not None and self.turns is not None and self.turns < before + TURNS:
            if limit.over:
                self.stood_still += 1
                return
            time.sleep(0.002)


@asynccontextmanager
async def going_on(store: SlowStore) -> AsyncIterator[None]:
    """The event loop must not stand still while something is committed."""

    async def count() -> None:
        while True:
            await asyncio.sleep(0.002)
            assert store.turns is not None
            store.turns += 1

    store.turns = 0
    counting = asyncio.create_task(count())
    try:
        yield
    finally:
        counting.cancel()
        store.turns = None
    assert store.stood_still == 0, f"the event loop waited for {store.stood_still} commits"


async def test_no_commit_of_a_write_waits_on_the_event_loop(make_bench: MakeBench, tmp_path: Path) -> None:
    store = SlowStore(tmp_path)
    bench = make_bench(store=store)
    store.threads.clear()
    async with going_on(store):
        await bench.apply()
        await bench.handle.kept()
    assert bench.state == JobState.SUCCEEDED
    assert store.threads
    assert threading.get_ident() not in store.threads
    assert store.journal("j1")[-1].step == JournalStep.CLOSED


@pytest.mark.long
async def test_no_request_for_a_job_waits_for_the_disk_on_the_event_loop(tmp_path: Path) -> None:
    vehicle = FakeVehicle.with_floats(OLD)
    store = SlowStore(tmp_path)
    async with running(vehicle, reviewed(vehicle), store=store) as engine:
        store.threads.clear()
        async with going_on(store):
            await engine.cancel("j1")
            job = await engine.submit(vehicle.id, "gyro")
            await until(lambda: engine.get(job.id).state == JobState.RUNNING, seconds=20)
            events = engine.subscribe(None, 0)
            assert (await anext(events)).job_id == "j1"
            await engine.cancel(job.id)
        assert store.threads
        assert threading.get_ident() not in store.threads


async def test_a_parameter_is_sent_only_when_its_announcement_is_on_the_disk(
    make_bench: MakeBench, tmp_path: Path
) -> None:
    bench = make_bench(store=SlowStore(tmp_path))
    seen: list[tuple[str, str]] = []

    def look(_: int) -> None:
        """What somebody who opens the file now finds."""
        with sqlite3.connect(tmp_path / "mavcal.sqlite3") as db:
            (state,) = db.execute("SELECT state FROM jobs").fetchone()
            row = db.execute("SELECT json_extract(data, '$.name') FROM journal WHERE step = 'send' ORDER BY id DESC")
            seen.append((state, row.fetchone()[0]))
        db.close()

    bench.vehicle.before_set = look
    await bench.apply()
    assert seen == [("applying", name) for name in NEW]


async def test_what_was_begun_is_finished_before_a_cancelled_step_ends(make_bench: MakeBench, tmp_path: Path) -> None:
    bench = make_bench(store=SlowStore(tmp_path))
    recording = asyncio.create_task(bench.handle.record(JournalStep.STREAMS, intervals={"30": 0}))
    await asyncio.sleep(0)
    recording.cancel()
    await asyncio.wait({recording})
    assert recording.cancelled()
    assert bench.handle.write_record().intervals == {30: 0}


async def test_a_change_that_found_the_disk_full_is_kept_before_the_next_step(make_bench: MakeBench) -> None:
    bench = make_bench()
    store = bench.store
    pages = store._db.execute("PRAGMA page_count").fetchone()[0]
    store._db.execute(f"PRAGMA max_page_count = {pages}")
    bench.handle.change("note", {}, context={"filler": "x" * 100_000})
    bench.handle.move(JobState.VERIFYING)
    await store.do(lambda: None)
    kept = store.job("j1")
    assert kept is not None
    assert kept.state == "applying"
    store._db.execute("PRAGMA max_page_count = 100000")
    await bench.handle.record(JournalStep.VERIFIED)
    kept = store.job("j1")
    assert kept is not None
    assert kept.state == "verifying"
    assert [e.kind for e in store.events("j1")] == ["state", "note", "state"]


@pytest.mark.long
async def test_a_crash_after_every_commit_leaves_what_the_next_start_needs(
    make_bench: MakeBench, tmp_path: Path
) -> None:
    """Whatever commit is the last one, the journal and the vehicle bring the job to its end."""
    commits = 0
    while True:
        bench = make_bench(store=_Ending(tmp_path / str(commits), commits))
        with suppress(_Gone):
            await asyncio.wait_for(bench.apply(), 30)
        bench.store.close()  # the last changes may still have been on their way
        ended = not bench.store.gone  # type: ignore[attr-defined]
        again = SqliteStore(tmp_path / str(commits))
        row = again.job("j1")
        assert row is not None
        if ended:
            assert row.state == "succeeded"
            again.close()
            return
        if row.state == "succeeded":  # the power went with the announcement alone
            again.close()
            commits += 1
            continue
        handle = JobHandle(bench.handle.job, again, lambda _: None)
        from mavcal.service.jobs.core.codec import job_from_row

        handle.job = job_from_row(row)
        resumed = type(bench)(bench.vehicle, again, bench.plan, handle, bench.accept, bench.check)
        if handle.job.state != JobState.IN_DOUBT:
            handle.move(JobState.IN_DOUBT)
        await asyncio.wait_for(resumed.transaction.resolve(), 30)
        assert handle.job.state in {JobState.REVIEW, JobState.REVERTED, JobState.SUCCEEDED}, commits
        held = {n: bench.vehicle.values()[n] for n in NEW}
        whole = [{n: float32(v[n]) for n in NEW} for v in (OLD, NEW)]
        assert held in whole, commits
        again.close()
        commits += 1


class _Gone(BaseException):
    """The power is gone."""


class _Ending(SqliteStore):
    """Loses power at a commit: nothing of it and nothing after it is on the disk."""

    def __init__(self, folder: Path, commits: int) -> None:
        super().__init__(folder)
        self.gone = False
        self._left = commits + 3  # the first make the job and its snapshot

    def _commit(self, durable: bool) -> None:
        self._left -= 1
        if self._left < 0:
            self.gone = True
            raise _Gone
        super()._commit(durable)
