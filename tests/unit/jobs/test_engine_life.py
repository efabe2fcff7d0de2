"""A service starts, takes its jobs up where they were left, and stops."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import pytest

from mavcal.service.errors import JobUnknown
from mavcal.service.jobs.core.codec import row_from_job
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.jobs.core.model import FROM_RECORDING, Accept, Failure, Job
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.store.rows import SnapshotPurpose
from mavcal.service.store.sql import Store
from tests.stores import new_store
from tests.unit.jobs.computations import FakeComputations
from tests.unit.jobs.conftest import OLD, QUICK, until
from tests.unit.jobs.fakes import FakeRegistry, FakeVehicle
from tests.unit.jobs.test_engine import CONTEXT, reviewed, sent_one


class Idle:
    """Stands for the work of a job: notes who began, and never ends by itself."""

    def __init__(self) -> None:
        self.begun: list[str] = []

    async def __call__(self, handle: JobHandle, *_more: Any) -> None:
        self.begun.append(handle.id)
        await asyncio.sleep(3600.0)


@pytest.fixture
def vehicle() -> FakeVehicle:
    return FakeVehicle.with_floats(OLD)


def kept(vehicle: FakeVehicle, *jobs: Job) -> Store:
    store = new_store()
    for job in jobs:
        store.save_job(row_from_job(job))
        if job.plan is not None:
            digest = job.plan.snapshot_sha256
            store.add_snapshot(job.id, 0.0, SnapshotPurpose.COMPOSED_ON, digest, vehicle.values())
    return store


Prepare = Callable[[JobEngine], None]


@asynccontextmanager
async def started(
    store: Store,
    vehicle: FakeVehicle,
    prepare: Prepare = lambda _: None,
    settings: JobSettings = QUICK,
    computations: FakeComputations | None = None,
) -> AsyncIterator[JobEngine]:
    engine = JobEngine(store, FakeRegistry({vehicle.id: vehicle}), computations, settings=settings)
    prepare(engine)
    await engine.start()
    try:
        yield engine
    finally:
        await engine.stop()
        store.close()


def bare(state: JobState, **changes: Any) -> Job:
    return replace(Job("j1", "vehicle-1", "gyro", {}, state, 1.0, 1.0, context=CONTEXT), **changes)


@pytest.mark.parametrize("state", [JobState.QUEUED, JobState.RUNNING, JobState.WAITING_FOR_OPERATOR])
async def test_a_capture_that_was_interrupted_goes_on(vehicle: FakeVehicle, state: JobState) -> None:
    capturing, fitting = Idle(), Idle()

    def prepare(engine: JobEngine) -> None:
        engine._runner.calibrate = capturing  # type: ignore[method-assign]
        engine._runner.fit = fitting  # type: ignore[method-assign]

    async with started(kept(vehicle, bare(state)), vehicle, prepare) as engine:
        await until(lambda: capturing.begun == ["j1"])
        assert engine.get("j1").state == state
        assert fitting.begun == []


async def test_a_fit_that_was_interrupted_is_made_again(vehicle: FakeVehicle) -> None:
    capturing, fitting = Idle(), Idle()

    def prepare(engine: JobEngine) -> None:
        engine._runner.calibrate = capturing  # type: ignore[method-assign]
        engine._runner.fit = fitting  # type: ignore[method-assign]

    async with started(kept(vehicle, bare(JobState.FITTING)), vehicle, prepare):
        await until(lambda: fitting.begun == ["j1"])
        assert capturing.begun == []


async def test_the_fit_of_an_uploaded_recording_is_made_again(vehicle: FakeVehicle) -> None:
    options = {"recording": "a", "method": "gyro-rest", "options": {}}
    job = bare(JobState.FITTING, kind=FROM_RECORDING, options=options)
    work = FakeComputations()
    async with started(kept(vehicle, job), vehicle, computations=work) as engine:
        await until(lambda: engine.get("j1").state == JobState.FAILED)
        assert work.ended == 1
        outcome = engine.get("j1").outcome
        assert isinstance(outcome, Failure)
        assert outcome.code == "other-vehicle"


@pytest.mark.parametrize("state", [JobState.REVIEW, JobState.FAILED, JobState.SUCCEEDED, JobState.CANCELLED])
async def test_rates_that_a_job_has_left_changed_are_put_back_at_the_start(
    vehicle: FakeVehicle, state: JobState
) -> None:
    store = kept(vehicle, bare(state))
    store.add_journal("j1", 0.0, JournalStep.STREAMS, {"intervals": {"27": 4000}})
    async with started(store, vehicle, settings=replace(QUICK, review_s=0.01)) as engine:
        await until(lambda: vehicle.message_intervals == {27: 4000})
        await engine.wait_for_cleanup()
        assert store.journal("j1")[-1].step == JournalStep.STREAMS_RESTORED
        assert engine.get("j1").state == state


async def test_writes_come_first_and_the_others_when_they_have_ended(vehicle: FakeVehicle) -> None:
    vehicle.change_state(armed=True)  # keeps the write in doubt
    write = reviewed(vehicle, state=JobState.APPLYING)
    store = kept(vehicle, write, bare(JobState.RUNNING, id="j2", vehicle_id="other"))
    sent_one(store, vehicle, write)
    capturing = Idle()

    def prepare(engine: JobEngine) -> None:
        engine._runner.calibrate = capturing  # type: ignore[method-assign]

    async with started(store, vehicle, prepare, replace(QUICK, recovery_alone_s=60.0)) as engine:
        await until(lambda: engine.get("j1").state == JobState.IN_DOUBT)
        await asyncio.sleep(0.01)
        assert capturing.begun == []
        assert set(engine.tasks.running) == {"j1"}
        vehicle.change_state(armed=False)
        await until(lambda: capturing.begun == ["j2"])
        assert engine.get("j1").state == JobState.REVERTED


async def test_a_write_that_stays_in_doubt_does_not_keep_the_others_for_ever(vehicle: FakeVehicle) -> None:
    vehicle.change_state(armed=True)
    write = reviewed(vehicle, state=JobState.APPLYING)
    store = kept(vehicle, write, bare(JobState.RUNNING, id="j2", vehicle_id="other"))
    sent_one(store, vehicle, write)
    capturing = Idle()

    def prepare(engine: JobEngine) -> None:
        engine._runner.calibrate = capturing  # type: ignore[method-assign]

    async with started(store, vehicle, prepare, replace(QUICK, recovery_alone_s=0.02)) as engine:
        await until(lambda: capturing.begun == ["j2"])
        await until(lambda: engine.get("j1").state == JobState.IN_DOUBT)


async def test_rates_of_an_earlier_job_are_returned_after_the_recovery_on_its_vehicle(vehicle: FakeVehicle) -> None:
    vehicle.change_state(armed=True)
    write = reviewed(vehicle, state=JobState.APPLYING)
    owing = bare(JobState.FAILED, id="j0", vehicle_id=write.vehicle_id)
    store = kept(vehicle, owing, write)
    sent_one(store, vehicle, write)
    store.add_journal("j0", 0.0, JournalStep.STREAMS, {"intervals": {"27": 4000}})
    async with started(store, vehicle, settings=replace(QUICK, recovery_alone_s=0.01)) as engine:
        await until(lambda: engine.get("j1").state == JobState.IN_DOUBT)
        await until(lambda: bool(engine._rates.tasks))
        await asyncio.sleep(0.02)
        assert vehicle.message_intervals == {}
        vehicle.change_state(armed=False)
        await until(lambda: vehicle.message_intervals == {27: 4000})
        assert engine.get("j1").state == JobState.REVERTED


async def test_a_job_that_cannot_be_taken_up_does_not_strand_the_next_one(vehicle: FakeVehicle) -> None:
    first, second = bare(JobState.RUNNING), bare(JobState.RUNNING, id="j2", created_at=2.0)
    capturing = Idle()

    def prepare(engine: JobEngine) -> None:
        engine._runner.calibrate = capturing  # type: ignore[method-assign]
        resume = engine._resume

        def broken(handle: JobHandle) -> None:
            if handle.id == "j1":
                raise RuntimeError("of any kind")
            resume(handle)

        engine._resume = broken  # type: ignore[method-assign]

    async with started(kept(vehicle, first, second), vehicle, prepare) as engine:
        await until(lambda: capturing.begun == ["j2"])
        assert [job.id for job in engine.list()] == ["j1", "j2"]


async def test_a_write_without_a_plan_stays_in_doubt_and_has_no_task(vehicle: FakeVehicle) -> None:
    async with started(kept(vehicle, bare(JobState.IN_DOUBT)), vehicle) as engine:
        assert engine.tasks.running == {}
        assert engine.get("j1").state == JobState.IN_DOUBT


async def test_a_stopped_service_leaves_its_jobs_as_they_are(vehicle: FakeVehicle) -> None:
    store = kept(vehicle, bare(JobState.RUNNING))
    store.add_journal("j1", 0.0, JournalStep.STREAMS, {"intervals": {"27": 4000}})
    capturing = Idle()
    engine = JobEngine(store, FakeRegistry({vehicle.id: vehicle}), settings=QUICK)
    engine._runner.calibrate = capturing  # type: ignore[method-assign]
    await engine.start()
    await until(lambda: capturing.begun == ["j1"])
    (task,) = engine.tasks.running.values()
    await engine.stop()
    assert task.cancelled()
    assert engine.get("j1").state == JobState.RUNNING
    assert engine._rates.tasks == set()
    assert vehicle.message_intervals == {}
    with pytest.raises(RuntimeError):
        engine._pool.submit(print)
    store.close()


async def test_a_service_that_stops_while_writes_are_alone_takes_nothing_else_up(vehicle: FakeVehicle) -> None:
    vehicle.change_state(armed=True)
    write = reviewed(vehicle, state=JobState.APPLYING)
    store = kept(vehicle, write, bare(JobState.RUNNING, id="j2", vehicle_id="other"))
    sent_one(store, vehicle, write)
    engine = JobEngine(store, FakeRegistry({vehicle.id: vehicle}), settings=QUICK)
    capturing = Idle()
    engine._runner.calibrate = capturing  # type: ignore[method-assign]
    await engine.start()
    (following,) = engine.tasks.resuming
    await until(lambda: engine.get("j1").state == JobState.IN_DOUBT)
    await engine.stop()
    assert following.cancelled()
    assert capturing.begun == []
    store.close()


async def test_progress_of_a_job_that_is_over_is_dropped_but_for_the_last(vehicle: FakeVehicle) -> None:
    store = kept(vehicle, bare(JobState.QUEUED))
    for k in range(5):
        store.add_event("j1", 0.0, "progress", {"current": k})

    async def at_once(handle: JobHandle) -> None:
        handle.move(JobState.FAILED)

    def prepare(engine: JobEngine) -> None:
        engine._runner.calibrate = at_once  # type: ignore[method-assign]

    async with started(store, vehicle, prepare) as engine:
        await until(lambda: not engine.tasks.running)
        await engine.book.handle("j1").kept()
        left = [event.data for event in store.events("j1") if event.kind == "progress"]
        assert left == [{"current": 4}]


async def test_an_accepted_write_begins_with_an_attempt_that_runs(vehicle: FakeVehicle) -> None:
    job = reviewed(vehicle, outcome=Failure("x", "y", "z"))
    assert job.plan is not None
    store = kept(vehicle, job)
    applying = Idle()

    def prepare(engine: JobEngine) -> None:
        engine._write = applying  # type: ignore[method-assign]
        engine._wall = engine._acceptance._wall = lambda: 77.0

    async with started(store, vehicle, prepare) as engine:
        accept = Accept(job.plan.sha256, reboot=True, actor="a person")
        now = await engine.apply("j1", accept, "key")
        assert (now.state, now.accept, now.outcome) == (JobState.APPLYING, accept, None)
        assert now.last_write is not None
        assert (now.last_write.result, now.last_write.at, now.last_write.sent) == ("running", 77.0, 0)
        (step,) = store.journal("j1")
        assert step.step == JournalStep.ACCEPTED
        assert step.data == {"plan_sha256": job.plan.sha256, "actor": "a person", "reboot": True}
        (said,) = store.audit()
        assert (said.at, said.actor, said.action, said.subject) == (77.0, "a person", "apply", "j1")
        assert said.detail == {"plan_sha256": job.plan.sha256, "confirmed": []}
        await until(lambda: applying.begun == ["j1"])
        assert engine._acceptance._claims == set()


async def test_what_was_confirmed_for_a_plan_is_in_the_audit(vehicle: FakeVehicle) -> None:
    job = reviewed(vehicle, context={"plan_options": {"confirm_mounting": True}})
    assert job.plan is not None
    store = kept(vehicle, job)
    async with started(store, vehicle) as engine:
        await engine.apply("j1", Accept(job.plan.sha256))
        (said,) = store.audit()
        assert said.detail["confirmed"] == ["confirm_mounting"]


async def test_who_takes_a_write_back_is_in_the_audit(vehicle: FakeVehicle) -> None:
    plan = reviewed(vehicle).plan
    assert plan is not None
    done = reviewed(vehicle, state=JobState.SUCCEEDED, accept=Accept(plan.sha256))
    store = kept(vehicle, done)
    sent_one(store, vehicle, done)
    async with started(store, vehicle) as engine:
        engine.book.handle("j1").job = replace(engine.get("j1"), prompt=None)
        await engine.revert("j1", "a person")
        (said,) = store.audit()
        assert (said.actor, said.action, said.subject, said.detail) == ("a person", "revert", "j1", {})
        await until(lambda: engine.get("j1").state == JobState.REVERTED)
        assert vehicle.values() == FakeVehicle.with_floats(OLD).values()


async def test_a_job_that_is_not_on_the_disk_does_not_exist(
    vehicle: FakeVehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def full(_handle: JobHandle) -> None:
        raise OSError("the disk is full")

    async with started(kept(vehicle), vehicle) as engine:
        monkeypatch.setattr(JobHandle, "kept", full)
        with pytest.raises(OSError, match="full"):
            await engine.submit(vehicle.id, "gyro")
        assert engine.list() == ()
        assert engine.tasks.running == {}
        with pytest.raises(JobUnknown):
            engine.get("j1")
