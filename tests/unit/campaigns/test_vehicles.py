"""What an item of a vehicle does: it begins a job, follows it, accepts its plan once, and says how that ended."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.preflight.check import Check, CheckId, Report, Verdict
from mavcal.service.campaigns.begin import CalibrationOrder, CampaignDesk, running_campaigns
from mavcal.service.campaigns.campaigns import CAMPAIGN, CampaignTask
from mavcal.service.campaigns.items import BEGUN_BY, Item, ItemOutcome, item_from_row, row_from_item
from mavcal.service.campaigns.vehicles import of_preflight
from mavcal.service.errors import Forbidden, VehicleArmed
from mavcal.service.jobs.core.codec import from_json, row_from_job
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Accept, Attempt, Failure, Job, Result, Unwritten, WriteResult
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.preflights import Preflight
from mavcal.service.store import SqliteStore
from tests.unit.jobs.conftest import OLD, QUICK, make_plan, until
from tests.unit.jobs.fakes import FakeRegistry, FakeVehicle

GYRO = CalibrationOrder("gyro", {}, {})
APPLY = replace(GYRO, apply=True, actor="the depot")


@dataclass
class Calibrating:
    """Stands for the capture and the fit of a job: its vehicle decides how that ends."""

    plans: dict[str, Any] = field(default_factory=dict)
    begun: list[str] = field(default_factory=list)
    asks: set[str] = field(default_factory=set)
    held: asyncio.Event = field(default_factory=asyncio.Event)

    async def __call__(self, handle: JobHandle) -> None:
        vehicle_id = str(handle.job.vehicle_id)
        self.begun.append(vehicle_id)
        if handle.job.state == JobState.QUEUED:
            handle.move(JobState.RUNNING)
        if vehicle_id in self.asks:
            handle.move(JobState.WAITING_FOR_OPERATOR)
            await self.held.wait()
            handle.move(JobState.RUNNING)
        handle.move(JobState.FITTING)
        plan = self.plans.get(vehicle_id)
        if plan is None:
            handle.move(JobState.FAILED, outcome=Failure("capture-ended", "it was moved", "leave it at rest"))
        else:
            handle.move(JobState.REVIEW, plan=plan)


@dataclass
class Applies:
    """Stands for the write of an accepted plan."""

    engine: JobEngine
    to: JobState = JobState.SUCCEEDED
    error: Exception | None = None
    accepts: list[tuple[str, Accept]] = field(default_factory=list)

    async def __call__(self, job_id: str, accept: Accept, _key: str | None = None) -> Job:
        if self.error is not None:
            raise self.error
        self.accepts.append((job_id, accept))
        handle = self.engine.book.handle(job_id)
        handle.move(JobState.APPLYING)
        if self.to == JobState.SUCCEEDED:
            handle.move(JobState.VERIFYING)
            handle.move(JobState.SUCCEEDED, outcome=Result("written"))
        else:
            handle.move(self.to)
        return handle.job


@dataclass
class Life:
    engine: JobEngine
    desk: CampaignDesk
    vehicles: dict[str, FakeVehicle]
    work: Calibrating
    applies: Applies

    async def calibrate(self, order: CalibrationOrder = GYRO, **more: Any) -> Job:
        return await self.desk.calibrate(tuple(self.vehicles), order, **more)

    async def ended(self, job: Job) -> list[Item]:
        await until(lambda: self.engine.get(job.id).state != JobState.RUNNING)
        await self.engine.book.handle(job.id).kept()
        return self.items(job)

    def items(self, job: Job) -> list[Item]:
        return [item_from_row(row) for row in self.engine._store.items(job.id)]


@asynccontextmanager
async def life(
    *names: str, store: SqliteStore | None = None, before: Callable[[JobEngine], None] = lambda _: None
) -> AsyncIterator[Life]:
    vehicles: dict[str, FakeVehicle] = {}
    for name in names:
        vehicles[name] = FakeVehicle.with_floats(OLD)
        vehicles[name].id = name
    registry = FakeRegistry(dict(vehicles))
    store = store or SqliteStore(None)
    engine = JobEngine(store, registry, settings=replace(QUICK, return_limit_s=0.3))
    work = Calibrating({name: make_plan(vehicle) for name, vehicle in vehicles.items()})
    engine._runner.calibrate = work  # type: ignore[method-assign]
    applies = Applies(engine)
    engine.apply = applies  # type: ignore[method-assign, assignment]
    campaigns = running_campaigns(engine, registry, engine._computations)
    before(engine)
    await engine.start()
    try:
        yield Life(engine, CampaignDesk(campaigns, engine._computations), vehicles, work, applies)
    finally:
        await engine.stop()
        store.close()


async def test_plans_wait_in_review_unless_the_campaign_may_write() -> None:
    async with life("a", "b", "c", "d") as at:
        at.vehicles["b"].change_state(armed=True)
        at.vehicles["c"].change_state(silent=True)
        del at.work.plans["d"]
        job = await at.calibrate()
        a, b, c, d = await at.ended(job)
        assert [i.outcome.value for i in (a, b, c, d)] == ["review", "skipped", "skipped", "refused"]
        assert a.text == "A plan of 3 parameters waits in review. Nothing was written."
        assert a.job_id is not None
        assert at.engine.get(a.job_id).state == JobState.REVIEW
        assert at.engine.get(a.job_id).context[BEGUN_BY] == {"id": job.id, "item": 1}
        assert (b.code, c.code) == ("vehicle-armed", "vehicle-silent")
        assert d.text == "It was moved. Leave it at rest."
        assert at.applies.accepts == []
        outcome = at.engine.get(job.id).outcome
        assert isinstance(outcome, Result)
        assert outcome.text == "4 vehicles: 1 review, 1 refused, 2 skipped."


async def test_with_apply_each_plan_is_accepted_once_by_who_began_the_campaign() -> None:
    async with life("a", "b") as at:
        items = await at.ended(await at.calibrate(APPLY))
        assert [(i.outcome.value, i.text) for i in items] == [("done", "written")] * 2
        assert {accept.actor for _, accept in at.applies.accepts} == {"the depot"}
        plans = {i.job_id: at.engine.get(str(i.job_id)).plan for i in items}
        assert {(j, accept.plan_sha256) for j, accept in at.applies.accepts} == {
            (job_id, plan.sha256) for job_id, plan in plans.items() if plan is not None
        }


async def test_a_plan_that_is_blocked_or_needs_a_restart_stays_in_review() -> None:
    async with life("a", "b") as at:
        at.work.plans["a"] = replace(at.work.plans["a"], blockers=("the mounting is not confirmed",))
        at.work.plans["b"] = make_plan(at.vehicles["b"], reboot=True)
        a, b = await at.ended(await at.calibrate(APPLY))
        assert (a.outcome, b.outcome) == (ItemOutcome.REVIEW, ItemOutcome.REVIEW)
        assert "the mounting is not confirmed" in a.text
        assert "restart" in b.text
        assert at.applies.accepts == []
        for item in (a, b):
            await at.engine.cancel(str(item.job_id))
        again = await at.ended(await at.calibrate(replace(APPLY, reboot=True)))
        assert [i.outcome.value for i in again] == ["review", "done"]
        assert at.applies.accepts[0][1].reboot


async def test_a_vehicle_that_is_armed_when_its_plan_is_written_keeps_the_plan() -> None:
    async with life("a") as at:
        at.applies.error = VehicleArmed()
        (item,) = await at.ended(await at.calibrate(APPLY))
        assert item.outcome == ItemOutcome.REVIEW
        assert item.text.startswith("Not written: The vehicle is armed")


async def test_a_write_in_doubt_is_told_and_not_waited_for_for_ever() -> None:
    async with life("a", "b") as at:
        at.applies.to = JobState.IN_DOUBT
        work: Any = at.desk.campaigns.works[CampaignTask.CALIBRATE]
        work.doubt_s = 0.2
        items = await at.ended(await at.calibrate(APPLY))
        assert [i.outcome.value for i in items] == ["in_doubt", "in_doubt"]
        assert "is in doubt" in items[0].text


async def test_a_vehicle_that_waits_for_a_person_holds_no_place() -> None:
    async with life("a", "b", "c") as at:
        at.work.asks = {"a", "b"}
        job = await at.calibrate(at_once=1)
        await until(lambda: at.work.begun == ["a", "b", "c"])
        await until(lambda: at.items(job)[2].outcome == ItemOutcome.REVIEW)
        at.work.held.set()
        assert {i.outcome.value for i in await at.ended(job)} == {"review"}


async def test_cancelling_ends_captures_and_leaves_reviews() -> None:
    async with life("a", "b", "c") as at:
        at.work.asks = {"b"}
        job = await at.calibrate()
        await until(lambda: at.items(job)[2].outcome == ItemOutcome.REVIEW)
        await at.engine.cancel(job.id)
        await until(lambda: not at.engine.tasks.running)
        items = at.items(job)
        assert [i.outcome.value for i in items] == ["review", "cancelled", "review"]
        (ended,) = (j for j in at.engine.list() if j.vehicle_id == "b")
        assert ended.state == JobState.CANCELLED
        assert items[1].text == f"The campaign was cancelled, and job {ended.id} with it. Nothing was written."


@pytest.mark.parametrize(
    ("state", "last_write", "code", "accepted", "outcome"),
    [
        (JobState.REVIEW, None, None, 1, "done"),  # killed between review and accept
        (
            JobState.REVIEW,
            WriteResult.FAILED,
            "vehicle-armed",
            0,
            "review",
        ),  # it was accepted, and could not be written
        (JobState.REVIEW, WriteResult.FAILED, "interrupted", 1, "done"),  # killed between accept and first PARAM_SET
        (JobState.SUCCEEDED, WriteResult.SUCCEEDED, None, 0, "done"),
        (JobState.REVERTED, WriteResult.REVERTED, None, 0, "refused"),
        (JobState.CANCELLED, None, None, 1, "done"),  # a command that stopped it has left nothing: it is begun again
        (JobState.INTERRUPTED, None, None, 1, "done"),
        (None, None, None, 1, "done"),  # killed before its job was begun
    ],
)
async def test_after_a_kill_an_item_goes_on_with_the_job_that_it_had_begun(
    state: JobState | None, last_write: WriteResult | None, code: str | None, accepted: int, outcome: str
) -> None:
    store = SqliteStore(None)
    plan = make_plan(FakeVehicle.with_floats(OLD))
    options = {"task": "calibrate", "at_once": None, "kind": "gyro", "options": {}, "plan_options": {}, "apply": True}
    store.save_job(row_from_job(Job("c1", None, CAMPAIGN, options, JobState.RUNNING, 1.0, 1.0)))
    store.add_items([row_from_item("c1", Item(1, "a", outcome=ItemOutcome.RUNNING, starts=1))])
    if state is not None:
        context = {BEGUN_BY: {"id": "c1", "item": 1}}
        write = None if last_write is None else Attempt(last_write, 2.0)
        said = None if code is None else Unwritten(code, "It could not be written.", "")
        job = Job("j1", "a", "gyro", {}, state, 2.0, 2.0, plan=plan, last_write=write, context=context, outcome=said)
        store.save_job(row_from_job(job))
    async with life("a", store=store) as at:
        (item,) = await at.ended(at.engine.get("c1"))
        assert item.outcome.value == outcome
        assert len(at.applies.accepts) == accepted
        again = state in {None, JobState.CANCELLED, JobState.INTERRUPTED}
        assert at.work.begun == (["a"] if again else [])
        assert (item.job_id == "j1") is not again


async def test_after_a_kill_a_vehicle_has_time_to_be_heard_again() -> None:
    store = SqliteStore(None)
    options = {"task": "calibrate", "at_once": None, "kind": "gyro", "options": {}, "plan_options": {}}
    store.save_job(row_from_job(Job("c1", None, CAMPAIGN, options, JobState.RUNNING, 1.0, 1.0)))
    subjects = {"a": 1, "gone": 1}
    rows = [Item(n, s, outcome=ItemOutcome.RUNNING, starts=k) for n, (s, k) in enumerate(subjects.items(), 1)]
    store.add_items([row_from_item("c1", item) for item in rows])

    def silent(engine: JobEngine) -> None:
        vehicle: Any = engine._vehicles.vehicle("a")
        vehicle.change_state(silent=True)
        asyncio.get_running_loop().call_later(0.05, lambda: vehicle.change_state(silent=False))

    async with life("a", store=store, before=silent) as at:
        a, gone = await at.ended(at.engine.get("c1"))
        assert a.outcome == ItemOutcome.REVIEW
        assert (gone.outcome, gone.code) == (ItemOutcome.SKIPPED, "vehicle-unknown")


async def test_what_makes_no_sense_is_refused_before_anything_begins() -> None:
    async with life("a") as at:
        for order in (
            CalibrationOrder("dance", {}, {}),
            CalibrationOrder("gyro", {"uncertainty": -1.0}, {}),
            CalibrationOrder("gyro", {}, {"keep_gyros": True}),
            CalibrationOrder("gyro", {}, {"only": ["mag0"]}),
            CalibrationOrder("mag", {}, {"confirm_mounting": True}, apply=True),
        ):
            with pytest.raises(InvalidInputError):
                await at.calibrate(order)
        never = CampaignDesk(at.desk.campaigns, at.engine._computations, read_only=True)
        with pytest.raises(Forbidden, match="--read-only"):
            await never.calibrate(tuple(at.vehicles), APPLY)
        with pytest.raises(InvalidInputError, match="no vehicle is selected"):
            await at.desk.preflight([])
        assert at.engine.list() == ()


@pytest.mark.parametrize(
    ("verdict", "outcome"), [("pass", "done"), ("warn", "warned"), ("unknown", "warned"), ("fail", "refused")]
)
def test_a_preflight_is_kept_whole(verdict: str, outcome: str) -> None:
    check = Check(CheckId.GYRO_REST, Verdict(verdict), 0.01, 0.001, 0.5, "deg/s", "reads 0.01 deg/s", "", ("n = 3",))
    vehicle = FakeVehicle.with_floats(OLD)
    found = Preflight("a", vehicle.identity, 5.0, 8.0, Report((check,)), ("slow link",))
    end = of_preflight(found)
    assert (end.outcome.value, end.code) == (outcome, verdict)
    assert end.result is not None
    assert from_json(end.result["preflight"], Preflight) == found
