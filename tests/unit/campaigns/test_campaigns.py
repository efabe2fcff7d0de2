"""Campaigns go through items: bounded, one after the other where asked, cancelled, interrupted, and taken up again."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.service.campaigns import campaigns
from mavcal.service.campaigns.campaigns import CAMPAIGN, CampaignTask, ItemTurn, uploads_of_campaign
from mavcal.service.campaigns.items import Item, ItemEnd, ItemOutcome, item_from_row, row_from_item
from mavcal.service.errors import (
    CampaignsBusy,
    ChildEnded,
    DiskFull,
    IllegalTransition,
    JobUnknown,
    ServiceError,
    VehicleArmed,
)
from mavcal.service.jobs.core.codec import row_from_job
from mavcal.service.jobs.core.model import Failure, Job, Result
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import ItemRow, JobDocument
from tests.unit.jobs.conftest import OLD, until
from tests.unit.jobs.fakes import FakeVehicle
from tests.unit.jobs.test_engine import running as running_engine

DONE = ItemEnd(ItemOutcome.DONE, "fine", "pass")


@dataclass
class FakeWork:
    """Ends each item as it is told; one whose subject is in `held` waits until it is let go."""

    ends: Mapping[str, ItemEnd | Exception] = field(default_factory=dict)
    held: set[str] = field(default_factory=set)
    most: int = 100
    most_starts: int | None = None
    begun: list[str] = field(default_factory=list)
    cancels: list[str] = field(default_factory=list)
    at_once: int = 0
    under_way: int = 0
    again: dict[str, bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.lane = asyncio.Semaphore(self.most)

    async def run(self, turn: ItemTurn) -> ItemEnd:
        subject = turn.item.subject
        self.begun.append(subject)
        self.again[subject] = turn.again
        self.under_way += 1
        self.at_once = max(self.at_once, self.under_way)
        try:
            await asyncio.sleep(0.001)
            while subject in self.held:
                if subject.startswith("person"):
                    await turn.place.wait_for_person()
                await asyncio.sleep(0.001)
        finally:
            self.under_way -= 1
        end = self.ends.get(subject, DONE)
        if isinstance(end, Exception):
            raise end
        return end

    async def cancelled(self, turn: ItemTurn) -> str:
        self.cancels.append(turn.item.subject)
        return "it was ended"


def with_campaigns(engine: Any) -> None:
    engine.campaigns = campaigns.Campaigns(engine.book, engine.tasks, engine._clock, engine._wall)
    engine.resumed_by[campaigns.CAMPAIGN] = engine.campaigns.resume_at_start


def running(vehicle: FakeVehicle, *jobs: Job, **more: Any) -> AbstractAsyncContextManager[Any]:
    return running_engine(vehicle, *jobs, before=with_campaigns, **more)


def with_work(engine: JobEngine, work: FakeWork) -> FakeWork:
    engine.campaigns.works[CampaignTask.FIT] = work
    engine.campaigns.works[CampaignTask.PREFLIGHT] = work
    return work


async def begin(engine: JobEngine, subjects: Sequence[str], task: CampaignTask = CampaignTask.FIT, **more: Any) -> Job:
    options = {"at_once": more.pop("at_once", None)}
    return await engine.campaigns.begin(task, options, [(s, f"{s}.bin") for s in subjects], **more)


async def ended(engine: JobEngine, job: Job) -> Job:
    await until(lambda: engine.get(job.id).state != JobState.RUNNING)
    await engine.book.handle(job.id).kept()
    return engine.get(job.id)


def items(engine: JobEngine, job: Job) -> list[Item]:
    return [item_from_row(row) for row in engine._store.items(job.id)]


def outcomes(engine: JobEngine, job: Job) -> dict[str, str]:
    return {item.subject: item.outcome.value for item in items(engine, job)}


@pytest.fixture
def vehicle() -> FakeVehicle:
    return FakeVehicle.with_floats(OLD)


async def test_every_item_has_an_outcome_in_words_and_none_ends_the_campaign(vehicle: FakeVehicle) -> None:
    refused = ItemEnd(ItemOutcome.REFUSED, "gyro_rest fails", "fail", result={"n": 1})
    ends: dict[str, ItemEnd | Exception] = {
        "b": refused,
        "c": VehicleArmed(),
        "d": ChildEnded("it needed more than 1 GiB of memory"),
        "e": InvalidInputError("there is nothing in it"),
        "f": ZeroDivisionError("no"),
    }
    async with running(vehicle) as engine:
        with_work(engine, FakeWork(ends))
        job = await begin(engine, "abcdef", CampaignTask.PREFLIGHT)
        assert (job.kind, job.vehicle_id, job.state) == (CAMPAIGN, None, JobState.RUNNING)
        done = await ended(engine, job)
        assert done.state == JobState.SUCCEEDED
        assert isinstance(done.outcome, Result)
        assert done.outcome.text == "6 vehicles: 1 done, 1 refused, 1 skipped, 3 failed."
        found = items(engine, job)
        assert [(i.outcome.value, i.code) for i in found] == [
            ("done", "pass"),
            ("refused", "fail"),
            ("skipped", "vehicle-armed"),
            ("failed", "file-not-processed"),
            ("failed", "invalid-input"),
            ("failed", "internal-error"),
        ]
        assert found[1].result == {"n": 1}
        assert found[2].text == "The vehicle is armed, or was a moment ago. Disarm it, on the ground, and wait 2 s."
        assert found[4].text == "There is nothing in it."
        assert "ZeroDivisionError" in found[5].text
        assert all(i.name == f"{i.subject}.bin" and i.began_at and i.ended_at for i in found)
        events = engine._store.events(job.id)
        told = [(e.data["number"], e.data["outcome"]) for e in events if e.kind == "item"]
        assert sorted(told) == [(i.number, i.outcome.value) for i in found]
        assert any(e.kind == "progress" and e.data["target"] == 6.0 for e in events)


async def test_documents_are_kept_before_their_item_says_that_it_is_done(vehicle: FakeVehicle) -> None:
    document = JobDocument("item-1-report.json", "application/json", b"{}")
    async with running(vehicle) as engine:
        with_work(engine, FakeWork({"a": replace(DONE, documents=(document,))}))
        job = await begin(engine, "a")
        await ended(engine, job)
        assert await engine.document(job.id, document.name) == document


async def test_the_queue_and_the_campaign_bound_what_is_done_at_once(vehicle: FakeVehicle) -> None:
    names = {letter: [f"{letter}{n}" for n in range(12)] for letter in "abc"}
    async with running(vehicle) as engine:
        work = with_work(engine, FakeWork(most=4, held={name for some in names.values() for name in some}))
        both = [await begin(engine, names[letter]) for letter in "ab"]
        await _filled(work, 4)  # of both campaigns together
        for job in both:
            assert (await ended(engine, job)).state == JobState.SUCCEEDED
        assert work.at_once == 4
        work.at_once, work.held = 0, set(names["c"])
        job = await begin(engine, names["c"], at_once=2)
        await _filled(work, 2)
        await ended(engine, job)
        assert work.at_once == 2


async def _filled(work: FakeWork, places: int) -> None:
    """Every item waits until all places are taken; nobody takes one more; then all go on."""
    await until(lambda: work.under_way >= places)
    await asyncio.sleep(0.02)
    assert work.under_way == places
    work.held.clear()


async def test_who_waits_for_a_person_holds_no_place_until_too_many_wait(
    vehicle: FakeVehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(campaigns, "WAITING_AT_ONCE", 2)
    people = [f"person{n}" for n in range(4)]
    async with running(vehicle) as engine:
        work = with_work(engine, FakeWork(held=set(people), most=2))
        job = await begin(engine, [*people, "a", "b"])
        await until(lambda: work.begun == people)  # two wait, and two more have the places
        await asyncio.sleep(0.02)
        assert work.begun == people
        work.held.discard("person2")
        await until(lambda: work.begun == [*people, "a", "b"])
        work.held.clear()
        await ended(engine, job)
        assert set(outcomes(engine, job).values()) == {"done"}
        assert work.lane._value == 2  # every place is given back
        assert engine.campaigns._waiting._value == 2


async def test_a_cancelled_campaign_ends_what_is_under_way_and_begins_nothing_more(vehicle: FakeVehicle) -> None:
    async with running(vehicle) as engine:
        work = with_work(engine, FakeWork(held={"b", "c"}, most=2))
        job = await begin(engine, "abcd")
        await until(lambda: work.begun == ["a", "b", "c"])
        assert (await engine.cancel(job.id)).state == JobState.CANCELLED
        await until(lambda: not engine.tasks.running)
        assert outcomes(engine, job) == {"a": "done", "b": "cancelled", "c": "cancelled", "d": "cancelled"}
        assert sorted(work.cancels) == ["b", "c"]
        assert [i.text for i in items(engine, job)] == ["fine", "it was ended", "it was ended", ""]
        assert work.lane._value == 2
        again = await begin(engine, "e")
        assert (await ended(engine, again)).state == JobState.SUCCEEDED


async def test_a_campaign_that_waits_for_its_queue_can_be_cancelled(vehicle: FakeVehicle) -> None:
    async with running(vehicle) as engine:
        work = with_work(engine, FakeWork(held={"a"}, most=1))
        first, second = await begin(engine, "a"), await begin(engine, "b")
        await until(lambda: work.begun == ["a"])
        await engine.cancel(second.id)
        await until(lambda: set(engine.tasks.running) == {first.id})
        work.held.clear()
        await ended(engine, first)
        assert (outcomes(engine, first), outcomes(engine, second)) == ({"a": "done"}, {"b": "cancelled"})
        assert work.lane._value == 1


async def test_a_stopped_service_goes_on_with_what_has_not_ended(vehicle: FakeVehicle) -> None:
    store = Shared()
    async with running(vehicle, store=store) as engine:
        work = with_work(engine, FakeWork(held={"b"}, most=2))
        job = await begin(engine, "abcd", at_once=1)
        await until(lambda: work.begun == ["a", "b"])
        assert outcomes(engine, job) == {"a": "done", "b": "running", "c": "waiting", "d": "waiting"}
    assert work.cancels == []
    engine = JobEngine(store, engine._vehicles)
    with_campaigns(engine)
    more = with_work(engine, FakeWork())
    await engine.start()
    done = await ended(engine, job)
    assert more.begun == ["b", "c", "d"]
    assert more.again == {"b": True, "c": False, "d": False}
    assert isinstance(done.outcome, Result)
    assert done.outcome.text == "4 logs: 4 done."
    await engine.stop()
    store.really_close()


async def test_an_item_that_stops_the_service_is_not_begun_for_ever(vehicle: FakeVehicle) -> None:
    poison = replace(Item(1, "a"), outcome=ItemOutcome.RUNNING, starts=3)
    store = holding(poison, Item(2, "b"))
    engine = JobEngine(store, FakeVehicles())
    with_campaigns(engine)
    work = with_work(engine, FakeWork(most_starts=3))
    await engine.start()
    job = await ended(engine, engine.get("c1"))
    assert job.state == JobState.SUCCEEDED
    assert work.begun == ["b"]
    assert [(i.outcome.value, i.code) for i in items(engine, job)] == [
        ("failed", "computation-interrupted"),
        ("done", "pass"),
    ]
    await engine.stop()
    store.close()


async def test_one_that_a_command_ran_waits_to_be_resumed(vehicle: FakeVehicle) -> None:
    store = holding(Item(1, "a", outcome=ItemOutcome.DONE), Item(2, "b"), attended=True)
    async with running(vehicle, store=store) as engine:
        work = with_work(engine, FakeWork())
        job = engine.get("c1")
        assert job.state == JobState.INTERRUPTED
        assert isinstance(job.outcome, Failure)
        assert "mavcal campaign resume c1" in job.outcome.remedy
        assert (await engine.campaigns.resume("c1")).outcome is None
        assert (await ended(engine, job)).state == JobState.SUCCEEDED
        assert work.begun == ["b"]
        with pytest.raises(IllegalTransition, match="succeeded"):
            await engine.campaigns.resume("c1")
        with pytest.raises(JobUnknown):
            await engine.campaigns.resume("c2")


async def test_one_whose_list_was_not_kept_is_no_campaign(vehicle: FakeVehicle) -> None:
    store = holding(state=JobState.QUEUED)
    async with running(vehicle, store=store) as engine:
        job = engine.get("c1")
        assert job.state == JobState.FAILED
        assert isinstance(job.outcome, Failure)
        assert "Nothing was begun" in job.outcome.cause


async def test_what_cannot_be_kept_interrupts_it(vehicle: FakeVehicle) -> None:
    async with running(vehicle) as engine:
        work = with_work(engine, FakeWork(held={"b"}))
        job = await begin(engine, "ab")
        await until(lambda: len(work.begun) == 2 and outcomes(engine, job)["a"] == "done")
        save, engine._store.save_item = engine._store.save_item, _full  # type: ignore[method-assign]
        work.held.clear()
        stopped = await ended(engine, job)
        assert stopped.state == JobState.INTERRUPTED
        assert isinstance(stopped.outcome, Failure)
        assert stopped.outcome.code == "store-error"
        engine._store.save_item = save  # type: ignore[method-assign]
        await engine.campaigns.resume(job.id)
        assert (await ended(engine, job)).state == JobState.SUCCEEDED
        assert work.begun == ["a", "b", "b"]


@pytest.mark.parametrize(
    ("subjects", "why"), [([], "no log is selected"), (["a", "b", "a"], "a is named twice"), ("abcd", "split it")]
)
async def test_what_is_no_list_of_items_is_refused(
    vehicle: FakeVehicle, subjects: Sequence[str], why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(campaigns, "MOST_ITEMS", 3)
    async with running(vehicle) as engine:
        with pytest.raises(InvalidInputError, match=why):
            await begin(engine, subjects)
        assert engine.list() == ()


async def test_too_many_campaigns_are_refused(vehicle: FakeVehicle, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaigns, "MOST_RUNNING", 1)
    async with running(vehicle) as engine:
        with_work(engine, FakeWork(held={"a"}))
        await begin(engine, "a")
        with pytest.raises(CampaignsBusy, match="1 campaigns are running"):
            await begin(engine, "b")


def test_uploads_stay_for_what_a_campaign_still_goes_through() -> None:
    store = holding(Item(1, "a", outcome=ItemOutcome.DONE), Item(2, "b"), sim="s", nominal=["n"])
    job = Job("c1", None, CAMPAIGN, {"task": "gap", "sim": "s", "nominal": ["n"]}, JobState.RUNNING, 1.0, 1.0)
    assert uploads_of_campaign(job, store) == {"b", "s", "n"}
    assert uploads_of_campaign(replace(job, state=JobState.INTERRUPTED), store) == {"b", "s", "n"}
    assert uploads_of_campaign(replace(job, state=JobState.SUCCEEDED), store) == set()
    assert uploads_of_campaign(replace(job, options={"task": "preflight"}), store) == set()
    store.close()


def test_an_item_survives_its_row_and_a_damaged_one_says_what_is_left() -> None:
    item = Item(3, "a", "a.bin", ItemOutcome.REVIEW, "review", "waits", "j1", 1.0, 2.0, 1, {"fits": []})
    assert item_from_row(row_from_item("c1", item)) == item
    found = item_from_row(ItemRow("c1", 3, "a", "done", {"starts": "many"}))
    assert (found.number, found.outcome, found.text) == (3, ItemOutcome.DONE, "The record of this item is damaged.")
    assert item_from_row(ItemRow("c1", 3, "a", "?", {"starts": "many"})).outcome == ItemOutcome.FAILED


class Shared(SqliteStore):
    """A store that outlives the engine that closes it."""

    def __init__(self) -> None:
        super().__init__(None)

    def close(self) -> None:
        self._line.caught_up()

    def really_close(self) -> None:
        super().close()


class FakeVehicles:
    def vehicle(self, vehicle_id: str) -> Any:
        raise ServiceError(vehicle_id)


def holding(*kept: Item, state: JobState = JobState.RUNNING, attended: bool = False, **options: Any) -> SqliteStore:
    store = SqliteStore(None)
    chosen = {"task": "fit", "at_once": None, **options}
    job = Job("c1", None, CAMPAIGN, chosen, state, 1.0, 1.0, context={"attended": attended})
    store.save_job(row_from_job(job))
    store.add_items([row_from_item("c1", item) for item in kept])
    return store


def _full(_row: ItemRow) -> None:
    raise DiskFull
