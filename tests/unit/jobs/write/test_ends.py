from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from mavcal.calib.errors import CalibError
from mavcal.calib.procedures.protocol import Prompt, PromptStep
from mavcal.service.errors import WriteFailed
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.jobs.core.model import Accept, Failure, Holds, Result, Standing, Unwritten, WriteResult
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.core.tasks import note_defect
from mavcal.service.jobs.write.guard import RESTARTED, WriteGuard
from mavcal.service.jobs.write.outcome import (
    RESOLVE,
    WriteOutcome,
    cause_of,
    conclude,
    nothing_sent,
    put_in_doubt,
    record_of,
    settle_lost_write,
    withdraw_certainty,
)
from mavcal.service.store.rows import EventRow
from tests.unit.jobs.conftest import Bench, MakeBench

X = "INS_GYROFFS_X"


def events(bench: Bench, kind: str) -> list[EventRow]:
    return [row for row in bench.store.events("j1") if row.kind == kind]


def rows(bench: Bench, step: JournalStep) -> list[Any]:
    return [row.data for row in bench.store.journal("j1") if row.step == step]


def failure(bench: Bench) -> Failure:
    assert isinstance(bench.handle.job.outcome, Failure)
    return bench.handle.job.outcome


async def one_sent(bench: Bench) -> None:
    """One parameter was sent and confirmed."""
    await bench.handle.record(JournalStep.ACCEPTED)
    await bench.handle.record(JournalStep.SEND, name=X, old=0.0, new=0.5, kind="real32", session=False)
    await bench.handle.record(JournalStep.ECHO, name=X, value=0.5)


def standing(bench: Bench) -> Standing:
    (only,) = bench.handle.job.standing
    return only


@pytest.fixture
def bench(make_bench: MakeBench) -> Bench:
    made = make_bench()
    made.handle.job = replace(made.handle.job, accept=Accept("x"), prompt=Prompt(PromptStep.BUSY, "Wait."))
    return made


# --- the end


@pytest.mark.parametrize(
    ("account", "result", "cause", "remedy", "accepted"),
    [
        (nothing_sent("disk-full", "no room", "Make room."), WriteResult.FAILED, "no room.", "Make room.", False),
        (WriteOutcome(JobState.IN_DOUBT, Failure("c", "why", "do"), (), 2), WriteResult.IN_DOUBT, "why.", "Do.", True),
    ],
)
async def test_an_attempt_that_ends_is_a_field_and_an_event_and_a_state(
    bench: Bench, account: WriteOutcome, result: WriteResult, cause: str, remedy: str, accepted: bool
) -> None:
    conclude(bench.handle, account)
    await bench.handle.kept()
    job = bench.handle.job
    assert (job.state, job.outcome, job.standing) == (account.state, account.outcome, account.standing)
    assert job.prompt is None
    assert (job.accept is not None) is accepted  # a job in review is accepted again
    attempt = job.last_write
    assert attempt is not None
    assert (attempt.result, attempt.cause, attempt.remedy, attempt.sent) == (result, cause, remedy, account.sent)
    await bench.store.do(lambda: None)
    (event,) = events(bench, "write")
    assert event.data["result"] == result.value
    assert (event.data["cause"], event.data["remedy"]) == (cause, remedy)


async def test_a_success_has_its_text_as_the_cause_and_needs_no_remedy(bench: Bench) -> None:
    bench.handle.job = replace(bench.handle.job, state=JobState.VERIFYING)
    conclude(bench.handle, WriteOutcome(JobState.SUCCEEDED, Result("All is well."), (), 3))
    attempt = bench.handle.job.last_write
    assert attempt is not None
    assert (attempt.result, attempt.cause, attempt.remedy) == (WriteResult.SUCCEEDED, "All is well.", "")


# --- stopped


@pytest.mark.parametrize(
    ("change", "certain", "holds", "note", "restarted", "silent"),
    [
        ({"armed": True}, True, Holds.NEW, "", False, False),
        ({"silent": True}, False, Holds.UNKNOWN, "before the vehicle fell silent", False, True),
        ({"reboots": 1}, False, Holds.UNKNOWN, "before the vehicle restarted", True, False),
        ({"peer": ("10.0.0.9", 1)}, False, Holds.UNKNOWN, "possibly said by another vehicle", False, False),
    ],
)
async def test_a_stop_says_what_was_sent_and_how_far_that_is_certain(
    bench: Bench, change: dict[str, Any], certain: bool, holds: Holds, note: str, restarted: bool, silent: bool
) -> None:
    await one_sent(bench)
    guard = WriteGuard(bench.vehicle, 0.001)
    bench.vehicle.change_state(**change)
    await put_in_doubt(bench.handle, "it was enough", {X: 0.5}, guard)
    assert bench.state == JobState.IN_DOUBT
    assert standing(bench) == Standing(X, 0.0, 0.5, 0.5, certain, note, holds)
    assert failure(bench) == Failure("in-doubt", "it was enough", RESOLVE)
    (row,) = rows(bench, JournalStep.STOPPED)
    assert row == {"reason": "it was enough", "restarted": restarted, "silent": silent, "interrupted": False}


async def test_an_interrupted_service_is_certain_of_nothing(bench: Bench) -> None:
    await one_sent(bench)
    await put_in_doubt(bench.handle, "interrupted", {}, None)
    (row,) = rows(bench, JournalStep.STOPPED)
    assert (row["restarted"], row["silent"], row["interrupted"]) == (False, False, True)
    assert standing(bench).note == "before the service was interrupted"
    assert not standing(bench).certain


async def test_the_first_reason_stays(bench: Bench) -> None:
    await one_sent(bench)
    await bench.handle.record(JournalStep.STOPPED, reason="the vehicle is armed")
    await put_in_doubt(bench.handle, "its consequence", {}, None)
    assert failure(bench).cause == "the vehicle is armed."
    await put_in_doubt(bench.handle, "a third one", {}, None)  # it is in doubt already: nothing more to say
    assert len(rows(bench, JournalStep.STOPPED)) == 2
    await bench.store.do(lambda: None)
    assert len(events(bench, "write")) == 1


class Damaged(JobHandle):
    """Its journal cannot be read."""

    def write_record(self) -> Any:
        raise ValueError("damaged")


async def test_without_a_journal_all_of_the_plan_may_have_been_sent(bench: Bench) -> None:
    bench.handle.__class__ = Damaged
    assert record_of(bench.handle) is None
    await settle_lost_write(bench.handle, "broken")
    assert bench.state == JobState.IN_DOUBT
    assert failure(bench).cause == "broken."
    note = "the journal cannot be read: whether it was sent is not known"
    assert bench.handle.job.standing == tuple(
        Standing(c.name, c.old, c.new, None, certain=False, note=note) for c in bench.plan.changes
    )
    bench.handle.job = replace(bench.handle.job, state=JobState.APPLYING, plan=None)
    await settle_lost_write(bench.handle, "broken")
    assert bench.handle.job.standing == ()


# --- later news


async def test_a_restart_afterwards_takes_the_certainty_away_once(bench: Bench) -> None:
    await one_sent(bench)
    guard = WriteGuard(bench.vehicle, 0.001)
    bench.vehicle.change_state(armed=True)
    await put_in_doubt(bench.handle, "the vehicle is armed", {X: 0.5}, guard)
    await withdraw_certainty(bench.handle, guard)
    assert standing(bench).certain  # nothing speaks against it
    bench.vehicle.change_state(armed=False, reboots=1)
    for _ in range(2):
        await withdraw_certainty(bench.handle, guard)
        assert standing(bench) == Standing(
            X, 0.0, 0.5, 0.5, certain=False, note="before the vehicle restarted", holds=Holds.UNKNOWN
        )
        assert failure(bench) == Failure("in-doubt", "the vehicle is armed", RESOLVE)
    assert rows(bench, JournalStep.STOPPED)[1:] == [{"reason": RESTARTED, "restarted": True}]
    await bench.store.do(lambda: None)
    (event,) = events(bench, "standing")
    assert event.data == {"note": "before the vehicle restarted"}


async def test_a_silence_afterwards_is_no_restart(bench: Bench) -> None:
    await one_sent(bench)
    guard = WriteGuard(bench.vehicle, 0.001)
    await put_in_doubt(bench.handle, "enough", {X: 0.5}, guard)
    bench.handle.job = replace(bench.handle.job, standing=(replace(standing(bench), note="said before"),))
    bench.vehicle.change_state(silent=True)
    await withdraw_certainty(bench.handle, guard)
    assert (standing(bench).certain, standing(bench).note) == (False, "said before")
    assert len(rows(bench, JournalStep.STOPPED)) == 1


async def test_what_was_uncertain_keeps_its_note(bench: Bench) -> None:
    await one_sent(bench)
    guard = WriteGuard(bench.vehicle, 0.001)
    await put_in_doubt(bench.handle, "interrupted", {}, None)
    bench.vehicle.change_state(silent=True)
    await withdraw_certainty(bench.handle, guard)
    assert standing(bench).note == "before the service was interrupted"
    await bench.store.do(lambda: None)
    assert events(bench, "standing") == []


# --- defects


async def test_a_write_without_a_task_that_has_sent_nothing_goes_back_to_review(bench: Bench) -> None:
    await bench.handle.record(JournalStep.ACCEPTED)
    await settle_lost_write(bench.handle, "interrupted by a defect")
    assert bench.state == JobState.REVIEW
    remedy = "Nothing was written. Apply the plan again."
    assert failure(bench) == Unwritten("interrupted", "interrupted by a defect", remedy)


@pytest.mark.parametrize("state", [JobState.APPLYING, JobState.ROLLING_BACK])
async def test_a_write_without_a_task_that_may_have_sent_something_is_in_doubt(bench: Bench, state: JobState) -> None:
    if state == JobState.APPLYING:
        await one_sent(bench)
    bench.handle.job = replace(bench.handle.job, state=state)
    await settle_lost_write(bench.handle, "lost")
    assert bench.state == JobState.IN_DOUBT


def test_what_was_not_foreseen_is_named_and_nothing_else_of_it() -> None:
    assert cause_of(WriteFailed("it did not hold")) == "it did not hold"
    assert cause_of(CalibError("no fit")) == "no fit"
    told = cause_of(ZeroDivisionError("secret"))
    assert told == "a defect of the program stopped the write (ZeroDivisionError); its log says more"


@pytest.mark.parametrize("state", list(JobState))
async def test_a_defect_ends_a_job_that_has_written_nothing_and_no_other(bench: Bench, state: JobState) -> None:
    bench.handle.job = before = replace(bench.handle.job, state=state)
    note_defect(bench.handle, KeyError("x"))
    ends = {JobState.QUEUED, JobState.RUNNING, JobState.WAITING_FOR_OPERATOR, JobState.FITTING}
    if state not in ends:
        assert bench.handle.job == before
        return
    assert (bench.state, bench.handle.job.prompt) == (JobState.FAILED, None)
    cause = "a defect of the program ended the job (KeyError)"
    assert failure(bench) == Failure("internal-error", cause, "Its log says more. What was recorded is kept.")
