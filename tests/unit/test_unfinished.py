"""The sentences about a job that a crash interrupted: before it is taken up, and once it has ended or is in doubt."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mavcal.calib.firmware.plan import ParameterKind
from mavcal.calib.procedures.protocol import Prompt, PromptStep
from mavcal.service.jobs.core.codec import row_from_job
from mavcal.service.jobs.core.journal import JournalStep, Sent
from mavcal.service.jobs.core.model import Failure, Holds, Job, Result, Standing
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store import SqliteStore
from mavcal.service.unfinished import Unfinished, beginning, ending, left_over

JOB = Job("j1", "v", "gyro", {}, JobState.IN_DOUBT, 0.0, 0.0)
SENT = Sent("FLAG", 1, 0, ParameterKind.INT32, session=True, confirmed=1)


def test_what_is_going_to_happen() -> None:
    harmless = beginning(Unfinished(replace(JOB, state=JobState.RUNNING), (), (), 0.0))
    unsent = beginning(Unfinished(JOB, (), (), 0.0))
    sent = beginning(Unfinished(JOB, (SENT, replace(SENT, name="X")), (), 0.0))
    assert all("j1 (gyro)" in said for said in (harmless, unsent, sent))
    assert ["cancelled" in said for said in (harmless, unsent, sent)] == [True, False, False]
    assert ["taken back" in said for said in (harmless, unsent, sent)] == [False, True, True]
    assert ["FLAG, X" in said for said in (harmless, unsent, sent)] == [False, False, True]


@pytest.mark.parametrize(
    ("standing", "says"),
    [
        (Standing("X", 1.0, 2.5, None, certain=False), ("1 before", "2.5 intended", "not heard")),
        (Standing("X", None, 2.5, 2.5, certain=True), ("unknown before", "2.5 intended", " 2.5 (certain)")),
        (
            Standing("X", 1.0, 2.5, 3.0, certain=False, note="it restarted", holds=Holds.OTHER),
            ("1 before", "2.5 intended", " 3 (it", "(it restarted)"),
        ),
        (Standing("X", 1.0, 2.5, 3.0, certain=False), ("1 before", "2.5 intended", " 3 (uncertain)")),
    ],
)
def test_doubt_names_each_parameter(standing: Standing, says: tuple[str, ...]) -> None:
    job, parameter = ending(Unfinished(JOB, (SENT,), (standing,), 0.0))
    assert "j1 (gyro)" in job
    assert job.endswith("in doubt")
    assert parameter.startswith("X:")
    assert all(token in parameter for token in says)


def test_why_it_is_in_doubt_is_the_prompt_or_else_the_outcome() -> None:
    failed = replace(JOB, outcome=Failure("silent", "no heartbeat", "Wait."))
    (said,) = ending(Unfinished(failed, (), (), 0.0))
    assert said.endswith(": No heartbeat. Wait.")
    (said,) = ending(Unfinished(replace(failed, prompt=Prompt(PromptStep.REBOOT, "Restart it.")), (), (), 0.0))
    assert said.endswith(": Restart it.")
    assert "heartbeat" not in said


def test_how_it_ended_and_what_is_back() -> None:
    reverted = replace(JOB, state=JobState.REVERTED, outcome=Failure("taken-back", "went back", "try again"))
    sent = (
        SENT,
        replace(SENT, name="OTHER", confirmed=5),
        replace(SENT, name="UNHEARD", confirmed=None),
        replace(SENT, name="KEPT", session=False),
    )
    job, flag, other = ending(Unfinished(reverted, sent, (), 0.0))
    assert "reverted" in job
    assert job.endswith(" Try again.")
    assert flag.startswith("FLAG ")
    assert flag.endswith(" 1")
    assert "OTHER holds" in other
    assert "5;" in other
    assert other.endswith(" 1")
    fine = replace(JOB, state=JobState.SUCCEEDED, outcome=Result("All written.", proof_reason=""))
    (said,) = ending(Unfinished(fine, (), (), 0.0))
    assert "succeeded" in said
    assert said.endswith(" All written.")
    (said,) = ending(Unfinished(replace(JOB, state=JobState.REVIEW, outcome=None), (), (), 0.0))
    assert said.endswith("in review")


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
