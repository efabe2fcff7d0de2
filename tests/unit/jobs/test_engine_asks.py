"""What is asked of the engine: what a job then is, and what two requests at once come to."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.in_force.origin import Origin
from mavcal.calib.firmware.plan import Agreement
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.procedures.protocol import Prompt, PromptStep
from mavcal.calib.recording import Identity, Sensor
from mavcal.calib.report import from_json, to_json
from mavcal.calib.triad import TriadModel
from mavcal.service.errors import (
    Forbidden,
    IllegalTransition,
    JobUnknown,
    NotRevertible,
    OtherVehicle,
    PhysicalJobRunning,
    RecordingUnknown,
    VehicleArmed,
)
from mavcal.service.jobs import engine as engine_module
from mavcal.service.jobs.calibrate import without_capture as adoption
from mavcal.service.jobs.calibrate.planning import Planned
from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.jobs.core.model import FROM_RECORDING, Accept, Failure, Result, cancelled
from mavcal.service.jobs.core.states import WRITING, JobState
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.store.rows import SnapshotPurpose
from tests.unit.jobs.computations import FakeComputations
from tests.unit.jobs.conftest import OLD, make_plan, until
from tests.unit.jobs.fakes import FakeVehicle
from tests.unit.jobs.test_engine import CONTEXT, reviewed, running
from tests.unit.jobs.test_engine_life import Idle, bare, kept, started

UNKNOWN = Identity("ardupilot", 2, None, None, 1, 1)
KNOWN = Identity("ardupilot", 2, (4, 7, 0), "00112233", 1, 1)


class Asked(FakeVehicle):
    """A vehicle that counts how often it was asked who it is, and takes note only then."""

    asked = 0

    async def identify(self) -> Identity:
        self.asked += 1
        await asyncio.sleep(0)
        self.identity = KNOWN
        return KNOWN


@pytest.fixture
def vehicle() -> FakeVehicle:
    return FakeVehicle.with_floats(OLD)


@pytest.mark.parametrize(("identity", "times"), [(UNKNOWN, 1), (KNOWN, 0)])
async def test_a_vehicle_whose_firmware_is_not_known_is_asked_before_its_job_begins(
    identity: Identity, times: int
) -> None:
    vehicle = Asked.with_floats(OLD, identity=identity)
    assert isinstance(vehicle, Asked)
    idle = Idle()
    async with started(kept(vehicle), vehicle) as engine:
        engine._runner.calibrate = idle  # type: ignore[method-assign]
        job = await engine.submit(vehicle.id, "gyro")
        assert vehicle.asked == times
        await until(lambda: idle.begun == [job.id])


async def test_only_one_of_two_jobs_begins_while_the_vehicle_is_asked_who_it_is() -> None:
    vehicle = Asked.with_floats(OLD, identity=UNKNOWN)
    async with started(kept(vehicle), vehicle) as engine:
        engine._runner.calibrate = Idle()  # type: ignore[method-assign]
        both = await asyncio.gather(
            engine.submit(vehicle.id, "gyro"), engine.submit(vehicle.id, "accel"), return_exceptions=True
        )
        assert [isinstance(one, PhysicalJobRunning) for one in both] == [False, True]
        assert len(engine.list()) == 1


async def test_a_job_keeps_what_was_asked_for(vehicle: FakeVehicle) -> None:
    async with started(kept(vehicle), vehicle) as engine:
        engine._wall = engine.book._wall = lambda: 55.0
        engine._runner.calibrate = Idle()  # type: ignore[method-assign]
        job = await engine.submit(vehicle.id, "gyro", {"uncertainty": 0.01}, {"only": ["gyro0"]})
        assert (job.vehicle_id, job.kind, job.state) == (vehicle.id, "gyro", JobState.QUEUED)
        assert job.options["uncertainty"] == 0.01
        assert job.context == {"plan_options": {"only": ["gyro0"]}}
        assert (job.created_at, job.updated_at) == (55.0, 55.0)
        assert len(job.id) == 12
        row = engine._store.job(job.id)
        assert row is not None
        assert row.state == "queued"
        (event,) = [e for e in engine._store.events(job.id) if e.kind == "state"]
        assert event.data == {"state": "queued", "outcome": None}


async def test_a_plan_for_sensors_of_another_kind_is_refused_before_the_job_begins(vehicle: FakeVehicle) -> None:
    async with started(kept(vehicle), vehicle) as engine:
        with pytest.raises(InvalidInputError, match="does not calibrate mag0"):
            await engine.submit(vehicle.id, "gyro", {}, {"only": ["mag0"]})
        assert engine.list() == ()


async def test_a_cancelled_job_asks_for_nothing_and_has_no_task(vehicle: FakeVehicle) -> None:
    idle = Idle()

    def prepare(engine: JobEngine) -> None:
        engine._runner.calibrate = idle  # type: ignore[method-assign]

    async with started(kept(vehicle, bare(JobState.QUEUED)), vehicle, prepare) as engine:
        await until(lambda: idle.begun == ["j1"])
        engine.book.handle("j1").prompt(Prompt(PromptStep.TURN, "Turn it."))
        job = await engine.cancel("j1")
        assert (job.state, job.prompt) == (JobState.CANCELLED, None)
        assert job.outcome == cancelled(bare(JobState.QUEUED))
        await until(lambda: engine.tasks.running == {})


@pytest.mark.parametrize("state", sorted(set(JobState) - {JobState.INTERRUPTED} - WRITING))
async def test_only_an_interrupted_job_is_fitted_again(vehicle: FakeVehicle, state: JobState) -> None:
    async with started(kept(vehicle), vehicle) as engine:
        engine.book._hold(bare(state))
        with pytest.raises(IllegalTransition, match="only an interrupted job"):
            await engine.refit("j1")
        assert engine.tasks.running == {}
        assert engine.get("j1").state == state


async def test_a_job_that_is_fitted_again_has_no_outcome_and_is_fitted(vehicle: FakeVehicle) -> None:
    job = bare(JobState.INTERRUPTED, outcome=Failure("a", "b", "c"))
    fitting = Idle()
    async with started(kept(vehicle, job), vehicle) as engine:
        engine._runner.fit = fitting  # type: ignore[method-assign]
        assert (await engine.refit("j1")).outcome is None
        await until(lambda: fitting.begun == ["j1"])


async def test_every_request_is_answered_with_the_job_as_it_is_then(vehicle: FakeVehicle) -> None:
    jobs = (
        bare(JobState.WAITING_FOR_OPERATOR, id="asked"),
        bare(JobState.RUNNING, id="stopped"),
        bare(JobState.INTERRUPTED, id="fitted"),
    )

    def prepare(engine: JobEngine) -> None:
        engine._runner.calibrate = engine._runner.fit = Idle()  # type: ignore[method-assign]

    async with started(kept(vehicle, *jobs), vehicle, prepare) as engine:
        engine.book.handle("asked").prompt(Prompt(PromptStep.TURN, "Turn it.", answers=("finish",)))
        for told, job_id in (
            (await engine.answer("asked", "finish"), "asked"),
            (await engine.cancel("stopped"), "stopped"),
            (await engine.refit("fitted"), "fitted"),
        ):
            assert told is engine.get(job_id)
        assert engine.book.handle("asked").answers.get_nowait() == "finish"


# --- writing


async def test_two_accepts_at_once_are_one_write(vehicle: FakeVehicle) -> None:
    job = reviewed(vehicle)
    assert job.plan is not None
    accept = Accept(job.plan.sha256)
    async with started(kept(vehicle, job), vehicle) as engine:
        engine._write = Idle()  # type: ignore[method-assign]
        both = await asyncio.gather(engine.apply("j1", accept), engine.apply("j1", accept), return_exceptions=True)
        assert sorted(type(one).__name__ for one in both) == ["IllegalTransition", "Job"]
        assert [row.step for row in engine._store.journal("j1")].count(JournalStep.ACCEPTED) == 1
        assert len(engine._store.audit()) == 1


async def test_two_reverts_at_once_are_one(vehicle: FakeVehicle) -> None:
    plan = reviewed(vehicle).plan
    assert plan is not None
    done = reviewed(vehicle, state=JobState.SUCCEEDED, accept=Accept(plan.sha256))
    async with started(kept(vehicle, done), vehicle) as engine:
        both = await asyncio.gather(engine.revert("j1"), engine.revert("j1"), return_exceptions=True)
        (refused,) = [one for one in both if isinstance(one, Exception)]
        assert isinstance(refused, IllegalTransition)
        assert "being accepted or taken back already" in str(refused)


@pytest.mark.parametrize("trouble", ["running", "armed"])
async def test_a_write_neither_begins_nor_is_taken_back_where_it_may_not(vehicle: FakeVehicle, trouble: str) -> None:
    job = reviewed(vehicle)
    assert job.plan is not None
    done = replace(job, id="j2", state=JobState.SUCCEEDED, accept=Accept(job.plan.sha256))
    others = [bare(JobState.RUNNING, id="j3")] if trouble == "running" else []
    error: type[Exception] = PhysicalJobRunning if others else VehicleArmed
    async with running(vehicle, job, done) as engine:
        for other in others:
            engine.book._hold(other)
        if trouble == "armed":
            vehicle.change_state(armed=True)
        with pytest.raises(error):
            await engine.apply("j1", Accept(job.plan.sha256))
        with pytest.raises(error):
            await engine.revert("j2")
        assert engine._store.audit() == ()
        assert (engine.get("j1").state, engine.get("j2").state) == (JobState.REVIEW, JobState.SUCCEEDED)


@pytest.mark.parametrize(
    ("request_", "moment", "steps"),
    [
        ("apply", "checked", []),
        ("apply", "audited", [JournalStep.ACCEPTED]),
        ("revert", "audited", [JournalStep.ROLL_BACK]),
    ],
)
async def test_another_job_that_begins_meanwhile_has_the_vehicle(
    vehicle: FakeVehicle, monkeypatch: pytest.MonkeyPatch, request_: str, moment: str, steps: list[JournalStep]
) -> None:
    """Reading the vehicle and waiting for the disk take their time: who is there first is asked again after each."""
    job = reviewed(vehicle)
    assert job.plan is not None
    accept = Accept(job.plan.sha256)
    state = JobState.REVIEW
    if request_ == "revert":
        state = JobState.SUCCEEDED
        job = replace(job, state=state, accept=accept)
    async with running(vehicle, job) as engine:
        audit = engine._acceptance.note

        async def checked(*_: Any) -> None:
            if moment == "checked":
                engine.book._hold(bare(JobState.RUNNING, id="j3"))

        async def audited(*told: Any) -> None:
            await audit(*told)
            if moment == "audited":
                engine.book._hold(bare(JobState.RUNNING, id="j3"))

        monkeypatch.setattr(engine_module, "check_plan", checked)
        engine._acceptance.note = audited  # type: ignore[method-assign]
        with pytest.raises(PhysicalJobRunning, match="j3"):
            await (engine.apply("j1", accept) if request_ == "apply" else engine.revert("j1"))
        assert engine.get("j1").state == state
        assert [row.step for row in engine._store.journal("j1")] == steps
        assert len(engine._store.audit()) == len(steps)
        assert engine.tasks.running == {}


async def test_what_wrote_nothing_cannot_be_taken_back(vehicle: FakeVehicle) -> None:
    async with running(vehicle, reviewed(vehicle, state=JobState.SUCCEEDED)) as engine:
        with pytest.raises(NotRevertible, match="found nothing to write"):
            await engine.revert("j1")


async def test_a_read_only_service_says_why_it_writes_nothing(vehicle: FakeVehicle) -> None:
    job = reviewed(vehicle)
    assert job.plan is not None
    async with running(vehicle, job, read_only=True) as engine:
        with pytest.raises(Forbidden, match="export the plan instead"):
            await engine.apply("j1", Accept(job.plan.sha256))
        assert engine._store.audit() == ()
        with pytest.raises(JobUnknown, match="there is no job j9"):
            await engine.apply("j9", Accept(job.plan.sha256))


# --- a recording's job


async def test_a_recording_of_another_vehicle_fails_its_job_and_says_what_to_do(vehicle: FakeVehicle) -> None:
    async with running(vehicle, computations=FakeComputations()) as engine:
        job = await engine.adopt(vehicle.id, "a", "gyro-rest", {"window": 3})
        assert (job.kind, job.state) == (FROM_RECORDING, JobState.FITTING)
        assert job.options == {"recording": "a", "method": "gyro-rest", "options": {"window": 3}}
        await until(lambda: engine.get(job.id).state == JobState.FAILED)
        outcome = engine.get(job.id).outcome
        assert isinstance(outcome, Failure)
        assert outcome.code == OtherVehicle("").code
        assert outcome.remedy == "Remove the cause and ask for the job again; the recording is kept."


def gyro_fit(status: FitStatus = FitStatus.OK, instance: int = 0, **changes: Any) -> FitResult:
    covariance = np.zeros((12, 12))
    covariance[:3, :3] = 1e-10 * np.eye(3)
    model = TriadModel(offset=np.array([0.05, 0.0, 0.0]))
    fit = FitResult("gyro-rest", Sensor.GYRO, instance, status, "", model, covariance, "rad/s", 500, 500, 1e-3, 1.0)
    return replace(fit, **changes)


OURS = Origin("ardupilot", "00112233", (("gyro", 0, 1000),), {})


async def test_a_recording_becomes_a_plan_to_look_at_with_all_that_its_fits_say(vehicle: FakeVehicle) -> None:
    refused = gyro_fit(FitStatus.REFUSED, 1, message="it was moved", warnings=("too warm",))
    results = (gyro_fit(message="fine", warnings=("too short", "too warm")), refused)
    async with running(vehicle, computations=FakeComputations(results, OURS)) as engine:
        job = await engine.adopt(vehicle.id, "a", "gyro-rest", {}, {"keep_gyro_at_boot": True})
        await until(lambda: engine.get(job.id).state != JobState.FITTING)
        ended = engine.get(job.id)
        assert (ended.state, ended.outcome) == (JobState.REVIEW, None)
        assert ended.results == results
        assert ended.warnings == ("it was moved", "too short", "too warm")
        assert ended.plan is not None
        assert [change.name for change in ended.plan.changes] == ["INS_GYROFFS_X", "INS_GYROFFS_Y"]
        assert ended.fingerprint == ended.plan.fingerprint
        assert ended.context["plan_options"] == {"keep_gyro_at_boot": True}
        assert ended.context["origin"] == to_json(OURS)
        assert from_json(ended.context["identity"], Identity) == vehicle.identity
        assert engine._store.plan(job.id, ended.plan.sha256) is not None
        kept_on = engine._store.snapshot(job.id, SnapshotPurpose.COMPOSED_ON)
        assert kept_on is not None
        assert kept_on.sha256 == ended.plan.snapshot_sha256


async def test_a_recording_that_agrees_with_what_is_in_force_ends_with_nothing_to_write(
    vehicle: FakeVehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = replace(make_plan(vehicle), changes=(), agreements=(Agreement(Sensor.GYRO, 0, 0.4, "gyro 1 agrees"),))
    monkeypatch.setattr(adoption, "make_plan", lambda *_, **__: Planned(plan, vehicle.values()))
    async with running(vehicle, computations=FakeComputations((gyro_fit(),), OURS)) as engine:
        job = await engine.adopt(vehicle.id, "a", "gyro-rest", {})
        await until(lambda: engine.get(job.id).state != JobState.FITTING)
        ended = engine.get(job.id)
        assert ended.state == JobState.SUCCEEDED
        assert isinstance(ended.outcome, Result)
        assert ended.outcome.text == "Nothing to write: gyro 1 agrees."


async def test_a_recording_is_not_adopted_where_a_job_could_not_begin(vehicle: FakeVehicle) -> None:
    async with running(vehicle, computations=FakeComputations()) as engine:
        with pytest.raises(InvalidInputError):
            await engine.adopt(vehicle.id, "a", "gyro-rest", {}, {"keep_gyros": True})
        with pytest.raises(InvalidInputError):
            await engine.adopt(vehicle.id, "a", "no-method", {})
        with pytest.raises(InvalidInputError, match="the option window is nan"):
            await engine.adopt(vehicle.id, "a", "gyro-rest", {"window": float("nan")})
        with pytest.raises(RecordingUnknown):
            await engine.adopt(vehicle.id, "z", "gyro-rest", {})
        vehicle.change_state(armed=True)
        with pytest.raises(VehicleArmed):
            await engine.adopt(vehicle.id, "a", "gyro-rest", {})
        engine.book._hold(bare(JobState.RUNNING))
        with pytest.raises(PhysicalJobRunning):
            await engine.adopt(vehicle.id, "a", "gyro-rest", {})


async def test_a_vehicle_that_is_armed_meanwhile_is_not_planned_for(vehicle: FakeVehicle) -> None:
    work = FakeComputations((gyro_fit(),), OURS)
    work.go.clear()
    async with running(vehicle, computations=work) as engine:
        job = await engine.adopt(vehicle.id, "a", "gyro-rest", {})
        vehicle.change_state(armed=True)
        work.go.set()
        await until(lambda: engine.get(job.id).state == JobState.FAILED)
        outcome = engine.get(job.id).outcome
        assert isinstance(outcome, Failure)
        assert outcome.code == VehicleArmed("").code


# --- planning again


async def test_a_plan_made_again_replaces_the_old_one_and_is_kept(vehicle: FakeVehicle) -> None:
    job = reviewed(vehicle, context={**CONTEXT, "plan_options": {}}, outcome=Failure("a", "b", "c"))
    assert job.plan is not None
    async with running(vehicle, job) as engine:
        again = await engine.plan_again("j1", {"keep_gyro_at_boot": True})
        assert again.plan is not None
        assert again.plan.sha256 != job.plan.sha256
        assert (again.state, again.outcome) == (JobState.REVIEW, None)
        assert again.fingerprint == again.plan.fingerprint
        assert again.context["plan_options"] == {"keep_gyro_at_boot": True}
        assert from_json(again.context["identity"], Identity) == vehicle.identity
        assert engine._store.plan("j1", again.plan.sha256) is not None
        same = await engine.plan_again("j1")
        assert same.context["plan_options"] == {"keep_gyro_at_boot": True}
        await engine.book.handle("j1").kept()
        told = [e.data for e in engine._store.events("j1") if e.kind == "plan"]
        assert told[0] == {"sha256": again.plan.sha256}


async def test_only_a_job_in_review_is_planned_again(vehicle: FakeVehicle) -> None:
    async with running(vehicle, reviewed(vehicle, state=JobState.FAILED)) as engine:
        with pytest.raises(IllegalTransition, match="only a job in review"):
            await engine.plan_again("j1")


async def test_a_job_that_is_cancelled_while_it_is_planned_again_keeps_its_plan(vehicle: FakeVehicle) -> None:
    job = reviewed(vehicle, context={**CONTEXT, "plan_options": {}})
    async with running(vehicle, job) as engine:
        planning = asyncio.ensure_future(engine.plan_again("j1", {"keep_gyro_at_boot": True}))
        await asyncio.sleep(0)
        await engine.cancel("j1")
        with pytest.raises(IllegalTransition, match="cancelled"):
            await planning
        assert engine.get("j1").plan == job.plan
