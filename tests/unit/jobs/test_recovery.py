"""The sentences about a job that a crash interrupted: before it is taken up, and once it has ended or is in doubt."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mavcal.calib.firmware.plan import ParameterKind
from mavcal.calib.procedures.protocol import Prompt, PromptStep
from mavcal.service.jobs.codec import row_from_job
from mavcal.service.jobs.journal import JournalStep, Sent
from mavcal.service.jobs.model import Failure, Holds, Job, Result, Standing
from mavcal.service.jobs.recovery import Unfinished, beginning, ending, left_over
from mavcal.service.jobs.states import JobState
from mavcal.service.store import SqliteStore

JOB = Job("j1", "v", "gyro", {}, JobState.IN_DOUBT, 0.0, 0.0)
SENT = Sent("FLAG", 1, 0, ParameterKind.INT32, session=True, confirmed=1)


def test_what_is_going_to_happen() -> None:
    assert beginning(Unfinished(replace(JOB, state=JobState.RUNNING), (), ())) == (
        "job j1 (gyro) was interrupted before it wrote anything: it is cancelled"
    )
    assert "interrupted before the first parameter was sent: it is finished or taken back" in beginning(
        Unfinished(JOB, (), ())
    )
    assert "interrupted while it wrote FLAG, X: " in beginning(Unfinished(JOB, (SENT, replace(SENT, name="X")), ()))


@pytest.mark.parametrize(
    ("standing", "says"),
    [
        (Standing("X", 1.0, 2.5, None, certain=False), "X: 1 before, 2.5 intended, not heard since"),
        (Standing("X", None, 2.5, 2.5, certain=True), "X: unknown before, 2.5 intended, last heard as 2.5 (certain)"),
        (
            Standing("X", 1.0, 2.5, 3.0, certain=False, note="before it restarted", holds=Holds.OTHER),
            "X: 1 before, 2.5 intended, last heard as 3 (before it restarted)",
        ),
        (Standing("X", 1.0, 2.5, 3.0, certain=False), "X: 1 before, 2.5 intended, last heard as 3 (uncertain)"),
    ],
)
def test_doubt_names_each_parameter(standing: Standing, says: str) -> None:
    assert ending(Unfinished(JOB, (SENT,), (standing,))) == ("job j1 (gyro) is in doubt", says)


def test_why_it_is_in_doubt_is_the_prompt_or_else_the_outcome() -> None:
    failed = replace(JOB, outcome=Failure("silent", "it fell silent", "Switch it on."))
    assert ending(Unfinished(failed, (), ()))[0] == "job j1 (gyro) is in doubt: It fell silent. Switch it on."
    asked = replace(failed, prompt=Prompt(PromptStep.REBOOT, "Restart it."))
    assert ending(Unfinished(asked, (), ()))[0] == "job j1 (gyro) is in doubt: Restart it."


def test_how_it_ended_and_what_is_back() -> None:
    reverted = replace(JOB, state=JobState.REVERTED, outcome=Failure("taken-back", "it was taken back", "try again"))
    sent = (
        SENT,
        replace(SENT, name="OTHER", confirmed=5),
        replace(SENT, name="UNHEARD", confirmed=None),
        replace(SENT, name="KEPT", session=False),
    )
    assert ending(Unfinished(reverted, sent, ())) == (
        "job j1 (gyro) is reverted. It was taken back. Try again.",
        "FLAG is back at 1",
        "OTHER holds 5; before the job it was 1",
    )
    fine = replace(JOB, state=JobState.SUCCEEDED, outcome=Result("All is written.", proof_reason=""))
    assert ending(Unfinished(fine, (), ())) == ("job j1 (gyro) is succeeded. All is written.",)
    again = replace(JOB, state=JobState.REVIEW, outcome=None)
    assert ending(Unfinished(again, (), ())) == ("job j1 (gyro) is in review",)


def test_only_jobs_that_claim_a_vehicle_are_left_over_with_what_their_journal_says() -> None:
    store = SqliteStore(None)
    jobs = [replace(JOB, state=JobState.APPLYING), replace(JOB, id="j2", state=JobState.SUCCEEDED)]
    for job in jobs:
        store.save_job(row_from_job(job))
    sent = {"name": "X", "old": 1.0, "new": 2.0, "kind": "real32", "session": False}
    store.add_journal("j1", 0.0, JournalStep.ACCEPTED, {})
    store.add_journal("j1", 0.0, JournalStep.SEND, sent)
    (found,) = left_over(store, jobs)
    assert (found.job.id, found.names, found.writing, found.ended) == ("j1", "X", True, False)
    (standing,) = found.standing
    assert (standing.name, standing.old, standing.new, standing.certain) == ("X", 1.0, 2.0, False)
    store.close()
