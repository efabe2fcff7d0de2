"""What a job says of itself while it runs."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import cast

import pytest

from mavcal.calib.procedures.protocol import Progress, Prompt, PromptStep
from mavcal.service.errors import DiskFull
from mavcal.service.jobs.core import handle as handle_module
from mavcal.service.jobs.core.codec import job_from_row, row_from_job
from mavcal.service.jobs.core.handle import JobHandle, counting
from mavcal.service.jobs.core.journal import JournalStep, as_heard
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import JournalRow, Json
from tests.stores import new_store
from tests.unit.jobs.fakes import FakeRegistry


@pytest.fixture
def handle() -> Iterator[JobHandle]:
    store = new_store()
    found = JobHandle(Job("j1", "v", "gyro", {}, JobState.RUNNING, 0.0, 0.0), store, lambda _: None)
    found.change("state", {})
    yield found
    store.close()


def test_what_is_counted_estimates_the_rest_from_the_pace_so_far(
    handle: JobHandle, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [100.0]
    monkeypatch.setattr(handle_module.time, "monotonic", lambda: now[0])
    told = counting(handle, "reading")
    told(0, 40)
    assert handle.job.progress is not None
    assert handle.job.progress.eta is None
    now[0] = 103.0
    told(10, 40)
    progress = handle.job.progress
    assert (progress.current, progress.target, progress.eta) == (10.0, 40.0, 9.0)
    assert progress.text == "reading: 10 of 40"


async def test_progress_is_announced_as_soon_as_it_may_be_and_not_before() -> None:
    store = new_store()
    now = [10.0]
    job = Job("j1", "v", "gyro", {}, JobState.RUNNING, 0.0, 0.0)
    handle = JobHandle(job, store, lambda _: None, progress_s=0.5, clock=lambda: now[0])
    handle.change("state", {})
    for k, at in enumerate((10.0, 10.25, 10.5, 10.75, 11.25)):
        now[0] = at
        handle.progress(Progress(float(k), 9.0, "", ""))
        assert handle.job.progress is not None
        assert handle.job.progress.current == k  # who asks is told each
    await handle.kept()
    told = [event.data["current"] for event in store.events("j1") if event.kind == "progress"]
    store.close()
    assert told == [0, 2, 4]


def test_a_job_that_has_ended_asks_nothing(handle: JobHandle) -> None:
    handle.move(JobState.CANCELLED, prompt=None)
    handle.prompt(Prompt(PromptStep.SILENT, "The vehicle is silent."))
    assert handle.job.prompt is None


def test_a_warning_is_kept_once_and_a_prompt_replaces_another(handle: JobHandle) -> None:
    handle.warn("slow")
    handle.warn("slow")
    handle.warn("slower")
    assert handle.job.warnings == ("slow", "slower")
    handle.prompt(None)
    assert handle.job.prompt is None


async def test_a_change_counts_as_kept_only_when_it_is_on_the_disk(handle: JobHandle) -> None:
    """What found the disk full is tried again, and who waits for it is told as long as it fails."""
    store = cast(SqliteStore, handle.store)
    pages = store._db.execute("PRAGMA page_count").fetchone()[0]
    store._db.execute(f"PRAGMA max_page_count = {pages}")
    handle.change("note", {}, context={"filler": "x" * 100_000})
    with pytest.raises(DiskFull):
        await handle.kept()
    store._db.execute("PRAGMA max_page_count = 100000")
    await handle.kept()
    row = store.job("j1")
    assert row is not None
    assert job_from_row(row).context == handle.job.context
    assert [event.kind for event in store.events("j1")] == ["state", "note"]


class Refusing(SqliteStore):
    """Its journal takes nothing while `refuses` is set."""

    refuses = False

    def add_journal(self, job_id: str, at: float, step: str, data: Json) -> JournalRow:
        """See Store."""
        if self.refuses:
            raise DiskFull
        return super().add_journal(job_id, at, step, data)


async def test_steps_that_the_disk_refused_are_in_the_journal_once_it_takes_them_again() -> None:
    store = Refusing(None)
    handle = JobHandle(Job("j1", "v", "gyro", {}, JobState.RUNNING, 0.0, 0.0), store, lambda _: None)
    handle.change("state", {})
    await handle.record(JournalStep.ECHO, name="A", value=2.0)
    store.refuses = True
    await handle.record_anyway(JournalStep.UNDO, name="A")
    await handle.record_anyway(JournalStep.UNDONE, name="A", value=1.0)
    store.refuses = False
    handle.change("state", {})
    await handle.kept()
    steps = [row.step for row in store.journal("j1")]
    store.close()
    assert steps == ["echo", "undo", "undone"]
    assert "recorded late" in handle.job.warnings[0]


async def test_an_undo_that_the_disk_refused_already_makes_the_value_uncertain() -> None:
    store = Refusing(None)
    handle = JobHandle(Job("j1", "v", "gyro", {}, JobState.ROLLING_BACK, 0.0, 0.0), store, lambda _: None)
    handle.change("state", {})
    await handle.record(JournalStep.SEND, name="A", old=1.0, new=2.0, kind="real32", session=False)
    await handle.record(JournalStep.ECHO, name="A", value=2.0)
    store.refuses = True
    await handle.record_anyway(JournalStep.UNDO, name="A")
    (standing,) = as_heard(handle.write_record(), {})
    assert not standing.certain
    await handle.record_anyway(JournalStep.UNDONE, name="A", value=1.0)
    (standing,) = as_heard(handle.write_record(), {})
    assert (standing.value, standing.certain) == (1.0, True)
    store.close()


async def test_two_undos_of_one_instant_both_count_though_the_disk_has_taken_one() -> None:
    store = Refusing(None)
    handle = JobHandle(
        Job("j1", "v", "gyro", {}, JobState.ROLLING_BACK, 0.0, 0.0), store, lambda _: None, wall=lambda: 7.0
    )
    handle.change("state", {})
    for name in ("A", "B"):
        await handle.record(JournalStep.SEND, name=name, old=1.0, new=2.0, kind="real32", session=False)
        await handle.record(JournalStep.ECHO, name=name, value=2.0)
    await handle.record_anyway(JournalStep.UNDO, name="A")
    store.refuses = True
    await handle.record_anyway(JournalStep.UNDO, name="B")
    assert [one.certain for one in as_heard(handle.write_record(), {})] == [False, False]
    store.close()


async def test_what_the_disk_refused_last_is_saved_without_another_change(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(handle_module, "RETRY_S", 0.01)
    store = Refusing(None)
    handle = JobHandle(Job("j1", "v", "gyro", {}, JobState.RUNNING, 0.0, 0.0), store, lambda _: None)
    handle.change("state", {})
    await handle.kept()
    store.refuses = True
    await handle.record_anyway(JournalStep.CLOSED)
    handle.move(JobState.FAILED)
    store.refuses = False
    async with asyncio.timeout(20):
        while (row := store.job("j1")) is None or row.state != "failed":  # noqa: ASYNC110 - the store is polled
            await asyncio.sleep(0.01)
    assert [step.step for step in store.journal("j1")] == ["closed"]
    store.close()


async def test_a_service_that_ends_saves_what_its_store_refused_as_soon_as_it_is_back() -> None:
    store = Refusing(None)
    store.save_job(row_from_job(Job("j1", "v", "gyro", {}, JobState.QUEUED, 0.0, 0.0)))
    engine = JobEngine(store, FakeRegistry({}))
    (handle,) = engine.book.load()
    store.refuses = True
    await handle.record_anyway(JournalStep.CLOSED)
    handle.move(JobState.FAILED)
    stopping = asyncio.create_task(engine.stop())
    await asyncio.sleep(0.01)
    store.refuses = False
    await stopping
    row = store.job("j1")
    store.close()
    assert row is not None
    assert row.state == "failed"


async def test_a_store_that_stays_away_holds_no_end_up_for_long() -> None:
    store = Refusing(None)
    handle = JobHandle(Job("j1", "v", "gyro", {}, JobState.RUNNING, 0.0, 0.0), store, lambda _: None)
    handle.change("state", {})
    await handle.kept()
    store.refuses = True
    await handle.record_anyway(JournalStep.CLOSED)
    await store.do(lambda: None)
    assert handle.owes
    assert not await handle.kept_at_last(0.0)
    store.refuses = False
    assert await handle.kept_at_last(0.0)
    assert not handle.owes
    store.close()
