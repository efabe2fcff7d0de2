from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import pytest

from mavcal.calib.errors import CalibError, FirmwareError, InvalidInputError
from mavcal.calib.procedures.protocol import Prompt, PromptStep
from mavcal.calib.recording import Identity
from mavcal.calib.report import to_json
from mavcal.service.errors import (
    AnswerRefused,
    Forbidden,
    IdempotencyConflict,
    IllegalTransition,
    JobUnknown,
    NotCancellable,
    NotRevertible,
    PhysicalJobRunning,
    PlanBlocked,
    PlanChanged,
    ServiceError,
    VehicleArmed,
    VehicleConflict,
    VehicleSilent,
    VehicleUnknown,
)
from mavcal.service.jobs.core.codec import job_from_row, row_from_job
from mavcal.service.jobs.core.journal import BY_OPERATOR, JournalStep
from mavcal.service.jobs.core.model import Accept, Failure, Job, WriteResult
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.store.rows import SnapshotPurpose
from mavcal.service.store.sql import Store
from tests.stores import new_store
from tests.unit.jobs.computations import FakeComputations
from tests.unit.jobs.conftest import OLD, QUICK, make_plan, until
from tests.unit.jobs.fakes import FakeRegistry, FakeVehicle

CONTEXT = {"identity": to_json(Identity("ardupilot", 2, (4, 7, 0), "00112233", 1, 1))}


@asynccontextmanager
async def running(
    vehicle: FakeVehicle,
    *jobs: Job,
    read_only: bool = False,
    store: Store | None = None,
    computations: FakeComputations | None = None,
    before: Callable[[JobEngine], None] = lambda _: None,
) -> AsyncIterator[JobEngine]:
    store = store or new_store()
    for job in jobs:
        store.save_job(row_from_job(job))
        if job.plan is not None:
            digest = job.plan.snapshot_sha256
            store.add_snapshot(job.id, 0.0, SnapshotPurpose.COMPOSED_ON, digest, vehicle.values())
    engine = JobEngine(store, FakeRegistry({vehicle.id: vehicle}), computations, settings=QUICK, read_only=read_only)
    before(engine)
    await engine.start()
    try:
        yield engine
    finally:
        await engine.stop()
        store.close()


def reviewed(vehicle: FakeVehicle, **changes: Any) -> Job:
    plan = make_plan(vehicle)
    job = Job("j1", vehicle.id, "gyro", {}, JobState.REVIEW, 1.0, 1.0, fingerprint=plan.fingerprint, plan=plan)
    return replace(job, **changes)


def sent_one(store: Store, vehicle: FakeVehicle, job: Job) -> None:
    """The journal of a service that ended behind the first parameter."""
    assert job.plan is not None
    first = job.plan.changes[0]
    body = {name: {"value": value, "kind": "real32"} for name, value in vehicle.values().items()}
    store.save_job(row_from_job(job))
    store.add_snapshot(job.id, 0.0, SnapshotPurpose.BEFORE_WRITE, "0" * 64, body)
    sent = {"name": first.name, "old": first.old, "new": first.new, "kind": "real32", "session": False}
    store.add_journal(job.id, 0.0, JournalStep.ACCEPTED, {})
    store.add_journal(job.id, 0.0, JournalStep.SEND, sent)
    store.add_journal(job.id, 0.0, JournalStep.ECHO, {"name": first.name, "value": first.new})
    vehicle.store(first.name, first.new)


@pytest.fixture
def vehicle() -> FakeVehicle:
    return FakeVehicle.with_floats(OLD)


@pytest.mark.parametrize(
    ("trouble", "error"),
    [
        ({"silent": True}, VehicleSilent),
        ({"armed": True}, VehicleArmed),
        ({"conflict": "two of them"}, VehicleConflict),
    ],
)
async def test_no_job_on_a_vehicle_that_is_not_ready(
    vehicle: FakeVehicle, trouble: dict[str, Any], error: type[ServiceError]
) -> None:
    vehicle.change_state(**trouble)
    async with running(vehicle) as engine:
        with pytest.raises(error):
            await engine.submit(vehicle.id, "gyro")
        assert engine.list() == ()


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (("nobody", "gyro"), VehicleUnknown),
        (("vehicle-1", "dance"), InvalidInputError),
        (("vehicle-1", "gyro", {"uncertainty": -1.0}), InvalidInputError),
        (("vehicle-1", "gyro", {"speed": 1.0}), InvalidInputError),
        (("vehicle-1", "gyro", {}, {"keep_gyros": True}), InvalidInputError),
    ],
)
async def test_what_cannot_be_asked_for(
    vehicle: FakeVehicle, arguments: tuple[Any, ...], error: type[CalibError | ServiceError]
) -> None:
    async with running(vehicle) as engine:
        with pytest.raises(error):
            await engine.submit(*arguments)


async def test_a_foreign_autopilot_is_refused_at_once(vehicle: FakeVehicle) -> None:
    vehicle.identity = Identity("other", 2, (1, 0, 0), "00", 1, 1)
    async with running(vehicle) as engine:
        with pytest.raises(FirmwareError):
            await engine.submit(vehicle.id, "gyro")


async def test_one_physical_job_a_vehicle_and_any_number_of_vehicles(vehicle: FakeVehicle) -> None:
    other = FakeVehicle.with_floats(OLD, id="vehicle-2")
    store = new_store()
    engine = JobEngine(store, FakeRegistry({vehicle.id: vehicle, other.id: other}), settings=QUICK)
    await engine.start()
    first = await engine.submit(vehicle.id, "gyro")
    with pytest.raises(PhysicalJobRunning, match=first.id):
        await engine.submit(vehicle.id, "accel")
    await engine.submit(other.id, "gyro")
    await engine.cancel(first.id)
    await engine.submit(vehicle.id, "accel")
    await engine.stop()
    store.close()


async def test_a_vehicle_in_doubt_is_closed(vehicle: FakeVehicle) -> None:
    vehicle.change_state(armed=True)  # nothing can be resolved while it is
    store = new_store()
    job = reviewed(vehicle, state=JobState.APPLYING)
    sent_one(store, vehicle, job)
    async with running(vehicle, job, store=store) as engine:
        await until(lambda: engine.get("j1").state == JobState.IN_DOUBT)
        known = engine.get("j1").standing
        assert [(s.name, s.old, s.new, s.value, s.certain) for s in known] == [
            ("INS_GYROFFS_X", 0.0, known[0].new, known[0].new, False)  # the last value heard, and not certain
        ]
        assert "before the service was interrupted" in known[0].note
        vehicle.state = replace(vehicle.state, armed=False, obstacles=("not known to be on the ground",))
        with pytest.raises(PhysicalJobRunning, match="closed for new jobs"):
            await engine.submit(vehicle.id, "gyro")
        with pytest.raises(NotCancellable):
            await engine.cancel("j1")
        vehicle.state = replace(vehicle.state, obstacles=())
        await until(lambda: engine.get("j1").state == JobState.REVERTED)
        outcome = engine.get("j1").outcome
        assert isinstance(outcome, Failure)
        assert outcome.cause == "the service was interrupted while it wrote."


async def test_a_crash_before_the_first_parameter_leaves_no_doubt(vehicle: FakeVehicle) -> None:
    vehicle.change_state(silent=True)  # not even its vehicle is needed
    async with running(vehicle, reviewed(vehicle, state=JobState.APPLYING)) as engine:
        await until(lambda: engine.get("j1").state == JobState.REVIEW)
        job = engine.get("j1")
        assert job.last_write is not None
        assert (job.last_write.result, job.last_write.sent) == ("failed", 0)


async def test_cancel_and_answer_and_unknown_jobs(vehicle: FakeVehicle) -> None:
    async with running(vehicle, reviewed(vehicle)) as engine:
        with pytest.raises(JobUnknown):
            engine.get("nothing")
        with pytest.raises(AnswerRefused, match="no answer now"):
            await engine.answer("j1", "finish")
        assert (await engine.cancel("j1")).state == JobState.CANCELLED
        with pytest.raises(NotCancellable):
            await engine.cancel("j1")
        with pytest.raises(NotRevertible):
            await engine.revert("j1")
        with pytest.raises(IllegalTransition):
            await engine.refit("j1")


async def test_what_keeps_a_plan_from_being_written(vehicle: FakeVehicle) -> None:
    job = reviewed(vehicle)
    assert job.plan is not None
    blocked = replace(job, id="j2", plan=replace(job.plan, blockers=("the offset is 9 m/s2",)))
    empty = replace(job, id="j3", plan=replace(job.plan, changes=()))
    async with running(vehicle, job, blocked, empty) as engine:
        with pytest.raises(PlanChanged):
            await engine.apply("j1", Accept("0" * 64))
        for other, text in ((blocked, "9 m/s2"), (empty, "nothing to write")):
            assert other.plan is not None
            with pytest.raises(PlanBlocked, match=text):
                await engine.apply(other.id, Accept(other.plan.sha256))
        vehicle.store("INS_GYR_ID", 5.0)
        with pytest.raises(PlanChanged, match="INS_GYR_ID was 1000 and is 5"):
            await engine.apply("j1", Accept(job.plan.sha256))
        assert engine.get("j1").state == JobState.REVIEW
        assert vehicle.sets == []


async def test_a_read_only_service_never_writes(vehicle: FakeVehicle) -> None:
    job = reviewed(vehicle)
    assert job.plan is not None
    async with running(vehicle, job, replace(job, id="j2", state=JobState.SUCCEEDED), read_only=True) as engine:
        with pytest.raises(Forbidden):
            await engine.apply("j1", Accept(job.plan.sha256))
        with pytest.raises(Forbidden):
            await engine.revert("j2")


async def test_an_idempotency_key_writes_once(vehicle: FakeVehicle) -> None:
    job = reviewed(vehicle)
    assert job.plan is not None
    store = new_store()
    async with running(vehicle, job, store=store) as engine:
        accept = Accept(job.plan.sha256)
        assert (await engine.apply("j1", accept, "key")).state == JobState.APPLYING
        assert (await engine.apply("j1", accept, "key")).id == "j1"
        with pytest.raises(IdempotencyConflict):
            await engine.apply("j1", replace(accept, reboot=True), "key")
        with pytest.raises(IllegalTransition):
            await engine.apply("j1", accept, "another key")
        assert [row.step for row in store.journal("j1")].count(JournalStep.ACCEPTED) == 1
        assert [row.action for row in store.audit()] == ["apply"]


async def test_a_key_whose_apply_sent_nothing_writes_the_next_time(vehicle: FakeVehicle) -> None:
    """Pages and scripts name an accept by job and plan: the same key must not answer from memory for ever."""
    job = reviewed(vehicle)
    assert job.plan is not None
    accept = Accept(job.plan.sha256)
    async with running(vehicle, job) as engine:
        for tried in (accept, replace(accept, reboot=True)):  # and it is free for another request of this job
            await engine.apply("j1", tried, "key")
            vehicle.change_state(armed=True)
            await until(lambda: engine.get("j1").state == JobState.REVIEW)
            assert vehicle.sets == []
            vehicle.change_state(armed=False)
        began = (await engine.apply("j1", accept, "key")).last_write
        assert began is not None
        assert began.result == WriteResult.RUNNING
        assert (await engine.apply("j1", accept, "key")).last_write == began  # now it stands for this attempt


async def test_events_are_replayed_and_then_live(vehicle: FakeVehicle) -> None:
    async with running(vehicle, reviewed(vehicle)) as engine:
        job = await engine.submit(vehicle.id, "gyro")
        seen: list[tuple[int, str]] = []

        async def watch(after: int) -> None:
            async for event in engine.subscribe(job.id, after):
                seen.append((event.sequence, event.kind))

        watching = asyncio.create_task(watch(0))
        await until(lambda: bool(seen))
        assert seen[0] == (1, "state")
        await engine.cancel(job.id)
        await until(lambda: len(seen) >= 2)
        assert [sequence for sequence, _ in seen] == list(range(1, len(seen) + 1))
        watching.cancel()
        with pytest.raises(JobUnknown):
            engine.subscribe("nothing")


def test_a_job_survives_the_store_exactly(vehicle: FakeVehicle) -> None:
    job = reviewed(
        vehicle, accept=Accept("0" * 64, reboot=True), warnings=("a", "b"), context={"answers": [[1.5, "x"]]}
    )
    assert job_from_row(row_from_job(job)) == job


async def test_an_accept_that_cannot_be_is_refused_before_the_vehicle_is_asked(vehicle: FakeVehicle) -> None:
    asked: list[str] = []
    read = vehicle.read_parameter

    async def counted(name: str) -> Any:
        asked.append(name)
        return await read(name)

    vehicle.read_parameter = counted  # type: ignore[method-assign]
    async with running(vehicle, reviewed(vehicle)) as engine:
        with pytest.raises(PlanChanged):
            await engine.apply("j1", Accept("0" * 64))
        assert asked == []


async def test_an_answer_that_the_prompt_takes_reaches_the_job_and_another_does_not(vehicle: FakeVehicle) -> None:
    async with running(vehicle, reviewed(vehicle)) as engine:
        handle = engine.book.handle("j1")
        with pytest.raises(AnswerRefused, match="it asks for no answer now"):
            await engine.answer("j1", "finish")
        handle.prompt(Prompt(PromptStep.PROVE, "Hold it.", answers=("finish",)))
        with pytest.raises(AnswerRefused, match="does not take 'begin': it accepts"):
            await engine.answer("j1", "begin")
        assert handle.answers.empty()
        await engine.answer("j1", "finish")
        assert handle.answers.get_nowait() == "finish"


async def test_who_takes_a_write_back_is_on_the_disk_before_it_begins(vehicle: FakeVehicle) -> None:
    done = reviewed(vehicle, state=JobState.SUCCEEDED, accept=Accept(make_plan(vehicle).sha256))
    store = new_store()
    async with running(vehicle, done, store=store) as engine:
        sent_one(store, vehicle, done)
        assert (await engine.revert("j1", "a person")).state == JobState.ROLLING_BACK
        (row,) = [row for row in store.journal("j1") if row.step == JournalStep.ROLL_BACK]
        assert row.data["because"] == BY_OPERATOR
        await until(lambda: engine.get("j1").state == JobState.REVERTED)


async def test_what_an_interrupted_job_recorded_can_be_fitted(vehicle: FakeVehicle) -> None:
    async with running(vehicle, reviewed(vehicle, state=JobState.INTERRUPTED, context=CONTEXT)) as engine:
        assert (await engine.refit("j1")).state == JobState.FITTING
        with pytest.raises(JobUnknown):
            await engine.refit("j2")


async def test_a_plan_is_not_made_again_on_a_vehicle_that_is_not_ready(vehicle: FakeVehicle) -> None:
    async with running(vehicle, reviewed(vehicle)) as engine:
        vehicle.change_state(armed=True)
        with pytest.raises(VehicleArmed):
            await engine.plan_again("j1")
        vehicle.change_state(armed=False)
        with pytest.raises(JobUnknown):
            await engine.plan_again("j2")
