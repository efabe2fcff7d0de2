"""Jobs of uploads: begun, waited for, cancelled, begun again, forgotten."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.procedures.protocol import Progress
from mavcal.service.errors import (
    ChildEnded,
    ChildrenBusy,
    DocumentUnknown,
    GapsBusy,
    JobCancelled,
    JobUnknown,
    NotRevertible,
    NoVehicle,
    RecordingUnknown,
)
from mavcal.service.jobs import uploads
from mavcal.service.jobs.core.admission import require_vehicle
from mavcal.service.jobs.core.codec import job_from_row
from mavcal.service.jobs.core.model import Failure, Job, Result
from mavcal.service.jobs.core.proof import ProofLevel
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.jobs.uploads import FIT, GAP, MOST_DIAGNOSES, MOST_STARTS, uploads_of
from mavcal.service.progress_line import ProgressLine, format_line
from tests.unit.jobs.computations import DIAGNOSED, FakeComputations
from tests.unit.jobs.conftest import OLD, until
from tests.unit.jobs.fakes import FakeVehicle
from tests.unit.jobs.test_engine import running
from tests.unit.jobs.test_engine_asks import gyro_fit
from tests.unit.jobs.test_engine_life import kept, started

FITS_AT_ONCE = JobSettings().fits_at_once

OF_A = {"recording": "a", "method": "gyro-rest", "options": {}}
GAP_OF_A = {"real": "a", "sim": None, "nominal": []}


@pytest.fixture
def vehicle() -> FakeVehicle:
    return FakeVehicle.with_floats(OLD)


def held() -> FakeComputations:
    """Computations that do not end by themselves."""
    work = FakeComputations((gyro_fit(),))
    work.go.clear()
    return work


def states(engine: JobEngine, *jobs: Job) -> list[JobState]:
    return [engine.get(job.id).state for job in jobs]


async def test_a_fit_of_an_upload_is_a_job_with_results_and_without_a_vehicle(vehicle: FakeVehicle) -> None:
    refused = gyro_fit(FitStatus.REFUSED, 1, message="it was moved", warnings=("too warm",))
    work = FakeComputations((gyro_fit(), refused))
    async with running(vehicle, computations=work) as engine:
        job = await engine.computing.fit("a", "gyro-rest", {})
        assert (job.kind, job.vehicle_id, job.state, job.options) == (FIT, None, JobState.QUEUED, OF_A)
        await until(lambda: engine.get(job.id).state == JobState.SUCCEEDED)
        ended = engine.get(job.id)
        assert ended.results == work.fits
        assert ended.warnings == ("it was moved", "too warm")
        assert isinstance(ended.outcome, Result)
        assert ended.outcome.text == "gyro-rest fitted 1 of 2 sensors."
        assert ended.outcome.proof is ProofLevel.NONE
        await engine.book.handle(job.id).kept()
        row = engine._store.job(job.id)
        assert row is not None
        again = job_from_row(row)
        assert (again.vehicle_id, again.state, len(again.results)) == (None, JobState.SUCCEEDED, 2)
        with pytest.raises(NotRevertible):
            await engine.revert(job.id)
        told = [(e.kind, e.data.get("state")) for e in engine._store.events(job.id)]
        assert [state for kind, state in told if kind == "state"] == ["queued", "fitting", "succeeded"]


async def test_a_diagnosis_leaves_its_documents(vehicle: FakeVehicle) -> None:
    async with running(vehicle, computations=FakeComputations()) as engine:
        job = await engine.computing.diagnose("a", "b", ("a",))
        assert job.options == {"real": "a", "sim": "b", "nominal": ["a"]}
        await until(lambda: engine.get(job.id).state == JobState.SUCCEEDED)
        ended = engine.get(job.id)
        assert isinstance(ended.outcome, Result)
        assert ended.outcome.text == DIAGNOSED.summary
        assert await engine.document(job.id, "report.json") == DIAGNOSED.documents[0]
        assert ended.context["documents"] == ["report.json"]
        with pytest.raises(DocumentUnknown, match="no document"):
            await engine.document(job.id, "report.html")
        with pytest.raises(JobUnknown):
            await engine.document("j9", "report.json")


async def test_what_cannot_begin_leaves_no_job(vehicle: FakeVehicle) -> None:
    async with running(vehicle, computations=FakeComputations()) as engine:
        with pytest.raises(RecordingUnknown):
            await engine.computing.fit("z", "gyro-rest", {})
        with pytest.raises(InvalidInputError):
            await engine.computing.fit("a", "no-method", {})
        with pytest.raises(InvalidInputError, match="give a finite number"):
            await engine.computing.fit("a", "gyro-rest", {"window": float("inf")})
        for real, sim, nominal in (("z", None, ()), ("a", "z", ()), ("a", None, ("a", "z"))):
            with pytest.raises(RecordingUnknown):
                await engine.computing.diagnose(real, sim, nominal)
        assert engine.list() == ()


async def test_an_engine_without_uploads_computes_nothing(vehicle: FakeVehicle) -> None:
    async with running(vehicle) as engine:
        with pytest.raises(RecordingUnknown, match="not kept here"):
            await engine.computing.fit("a", "gyro-rest", {})
        with pytest.raises(RecordingUnknown):
            await engine.computing.diagnose("a", None, ())
        with pytest.raises(RecordingUnknown):
            await engine.adopt(vehicle.id, "a", "gyro-rest", {})


@pytest.mark.parametrize(
    ("refusal", "code"),
    [(InvalidInputError("two samples only"), "calibration-error"), (ChildEnded("it took too long"), ChildEnded.code)],
)
async def test_what_a_computation_refuses_is_the_cause_of_the_end(
    vehicle: FakeVehicle, refusal: Exception, code: str
) -> None:
    async with running(vehicle, computations=FakeComputations(refusal=refusal)) as engine:
        with pytest.raises(type(refusal)):
            await engine.computing.fitted("a", "gyro-rest", {})
        (job,) = engine.list()
        assert job.state == JobState.FAILED
        assert isinstance(job.outcome, Failure)
        assert (job.outcome.code, job.outcome.cause.rstrip(".")) == (code, str(refusal).rstrip("."))


async def test_a_defect_reaches_whoever_waits_and_ends_the_job(vehicle: FakeVehicle) -> None:
    async with running(vehicle, computations=FakeComputations(refusal=ZeroDivisionError())) as engine:
        with pytest.raises(ZeroDivisionError):
            await engine.computing.fitted("a", "gyro-rest", {})
        await until(lambda: engine.list()[0].state == JobState.FAILED)


async def test_a_fit_that_is_waited_for_is_cancelled_when_nobody_waits_any_more(vehicle: FakeVehicle) -> None:
    work = held()
    async with running(vehicle, computations=work) as engine:
        waiting = asyncio.ensure_future(engine.computing.fitted("a", "gyro-rest", {}))
        await until(lambda: work.begun == 1)
        waiting.cancel()
        await until(lambda: engine.list()[0].state == JobState.CANCELLED)
        await until(lambda: work.ended == 1)
        with pytest.raises(asyncio.CancelledError):
            await waiting


@pytest.mark.parametrize("begins", [True, False])
async def test_a_cancelled_job_is_told_to_whoever_waits(vehicle: FakeVehicle, begins: bool) -> None:
    work = held()
    work.begins = begins  # or it waits for a child still
    async with running(vehicle, computations=work) as engine:
        waiting = asyncio.ensure_future(engine.computing.fitted("a", "gyro-rest", {}))
        await until(lambda: work.begun == 1)
        (job,) = engine.list()
        assert job.state == (JobState.FITTING if begins else JobState.QUEUED)
        await engine.cancel(job.id)
        with pytest.raises(JobCancelled, match="was cancelled"):
            await waiting
        assert (states(engine, job), work.ended) == ([JobState.CANCELLED], 1)


async def test_diagnoses_run_one_after_the_other_and_keep_no_fit_waiting(vehicle: FakeVehicle) -> None:
    work = held()
    async with running(vehicle, computations=work) as engine:
        one, two = [await engine.computing.diagnose("a", None, ()) for _ in range(2)]
        fit = await engine.computing.fit("a", "gyro-rest", {})
        await until(lambda: work.begun == 2)
        assert states(engine, one, two, fit) == [JobState.FITTING, JobState.QUEUED, JobState.FITTING]
        assert engine.get(fit.id).progress == Progress(0.0, 2.0, "steps", "reading")
        assert engine.get(two.id).progress is None
        await engine.cancel(one.id)
        await until(lambda: work.begun == 3)
        assert states(engine, one, two) == [JobState.CANCELLED, JobState.FITTING]


async def test_too_many_diagnoses_are_refused(vehicle: FakeVehicle) -> None:
    work = held()
    async with running(vehicle, computations=work) as engine:
        for _ in range(MOST_DIAGNOSES):
            await engine.computing.diagnose("a", None, ())
        with pytest.raises(GapsBusy, match=f"^{MOST_DIAGNOSES} diagnoses"):
            await engine.computing.diagnose("a", None, ())
        await engine.cancel(engine.list()[0].id)
        await engine.computing.diagnose("a", None, ())


async def test_fits_wait_for_their_turn_and_too_many_are_refused(
    vehicle: FakeVehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(uploads, "MOST_FITS", FITS_AT_ONCE + 2)
    work = held()
    async with running(vehicle, computations=work) as engine:
        jobs = [await engine.computing.fit("a", "gyro-rest", {}) for _ in range(FITS_AT_ONCE + 2)]
        await until(lambda: work.begun == FITS_AT_ONCE)
        assert states(engine, *jobs) == [JobState.FITTING] * FITS_AT_ONCE + [JobState.QUEUED] * 2
        with pytest.raises(ChildrenBusy, match=f"^{FITS_AT_ONCE + 2} fits"):
            await engine.computing.fit("a", "gyro-rest", {})
        await engine.cancel(jobs[-1].id)
        work.go.set()
        await until(lambda: states(engine, *jobs[:-1]) == [JobState.SUCCEEDED] * (FITS_AT_ONCE + 1))
        assert work.begun == FITS_AT_ONCE + 1


@pytest.mark.long
@pytest.mark.parametrize(("kind", "options"), [(FIT, OF_A), (GAP, GAP_OF_A)])
@pytest.mark.parametrize("state", [JobState.QUEUED, JobState.FITTING])
async def test_what_a_stopped_service_left_begins_again(
    vehicle: FakeVehicle, kind: str, options: dict[str, Any], state: JobState
) -> None:
    left = Job("j1", None, kind, options, state, 1.0, 1.0, context={"starts": MOST_STARTS - 1})
    work = held()
    async with started(kept(vehicle, left), vehicle, computations=work) as engine:
        await until(lambda: work.begun == 1)
        assert engine.get("j1").context["starts"] == MOST_STARTS
        work.go.set()
        await until(lambda: engine.get("j1").state == JobState.SUCCEEDED)


async def test_a_job_that_may_have_stopped_the_service_is_not_begun_for_ever(vehicle: FakeVehicle) -> None:
    left = Job("j1", None, GAP, GAP_OF_A, JobState.FITTING, 1.0, 1.0, context={"starts": MOST_STARTS})
    work = FakeComputations()
    async with started(kept(vehicle, left), vehicle, computations=work) as engine:
        job = engine.get("j1")
        assert (job.state, work.begun) == (JobState.FAILED, 0)
        assert isinstance(job.outcome, Failure)
        assert job.outcome.cause == "The service was stopped 3 times while this job ran."


@pytest.mark.parametrize("state", [JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELLED])
async def test_what_has_ended_is_not_begun_again(vehicle: FakeVehicle, state: JobState) -> None:
    work = FakeComputations()
    left = Job("j1", None, GAP, GAP_OF_A, state, 1.0, 1.0)
    async with started(kept(vehicle, left), vehicle, computations=work) as engine:
        await asyncio.sleep(0)
        assert (states(engine, left), work.begun) == ([state], 0)


async def test_the_oldest_fits_are_forgotten_and_nothing_else(
    vehicle: FakeVehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(uploads, "MOST_FITS_KEPT", 2)
    async with running(vehicle, computations=FakeComputations()) as engine:
        diagnosis = await engine.computing.diagnose("a", None, ())
        await until(lambda: engine.get(diagnosis.id).state == JobState.SUCCEEDED)
        fits = [(await engine.computing.fitted("a", "gyro-rest", {})).id for _ in range(4)]
        assert [job.id for job in engine.list()] == [diagnosis.id, *fits[2:]]
        await engine._store.do(lambda: None)
        assert [row.id for row in engine._store.jobs()] == [diagnosis.id, *fits[2:]]
        assert engine._store.events(fits[0]) == ()


async def test_a_job_without_a_vehicle_is_not_written(vehicle: FakeVehicle) -> None:
    async with running(vehicle, computations=held()) as engine:
        job = await engine.computing.fit("a", "gyro-rest", {})
        with pytest.raises(NoVehicle, match="it only computes"):
            require_vehicle(job)


def test_an_upload_stays_as_long_as_something_rests_on_it() -> None:
    def of(kind: str, options: dict[str, Any], state: JobState) -> set[str]:
        return uploads_of(Job("j", None, kind, options, state, 0.0, 0.0))

    assert of(GAP, {"real": "a", "sim": None, "nominal": ["b"]}, JobState.SUCCEEDED) == {"a", "b"}
    assert of(GAP, {"real": "a", "sim": "c", "nominal": []}, JobState.QUEUED) == {"a", "c"}
    assert of(FIT, OF_A, JobState.QUEUED) == {"a"}
    assert of(FIT, OF_A, JobState.SUCCEEDED) == set()
    assert of("recording", OF_A, JobState.REVIEW) == {"a"}
    assert of("gyro", {}, JobState.REVIEW) == set()


async def test_a_diagnosis_says_how_far_it_is_and_how_long_it_will_take(vehicle: FakeVehicle) -> None:
    lines = ("reading", format_line(ProgressLine("selecting effects", 0.25, 90.0)))
    work = FakeComputations(lines=lines)
    work.go.clear()
    async with running(vehicle, computations=work) as engine:
        job = await engine.computing.diagnose("a", None, ())
        await until(lambda: engine.get(job.id).progress is not None)
        assert engine.get(job.id).progress == Progress(25.0, 100.0, "%", "selecting effects", 90.0)
        work.go.set()
        await until(lambda: engine.get(job.id).state == JobState.SUCCEEDED)
        assert engine.get(job.id).progress is None


async def test_the_limit_of_a_diagnosis_goes_with_it_also_into_the_store(vehicle: FakeVehicle) -> None:
    work = FakeComputations()
    async with running(vehicle, computations=work) as engine:
        jobs = [await engine.computing.diagnose("a", None, (), limit) for limit in (20.0, None)]
        await until(lambda: all(engine.get(job.id).state == JobState.SUCCEEDED for job in jobs))
        assert work.limits == [20.0, None]
        assert jobs[0].options["limit_s"] == 20.0
        assert "limit_s" not in jobs[1].options
