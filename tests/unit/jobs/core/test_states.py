from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.service.errors import IllegalTransition
from mavcal.service.jobs.core.model import Job, advance
from mavcal.service.jobs.core.states import CANCELLABLE, ENDED, PHYSICAL, TRANSITIONS, WRITING, JobState


def job(state: JobState = JobState.QUEUED) -> Job:
    return Job("j", "v", "gyro", {}, state, 0.0, 0.0)


def test_every_state_of_the_design_is_there_and_no_other() -> None:
    stated = (
        "queued running waiting_for_operator fitting review applying waiting_for_reboot verifying succeeded "
        "rolling_back reverted in_doubt failed cancelled interrupted"
    )
    assert {s.value for s in JobState} == set(stated.split())
    assert set(TRANSITIONS) == set(JobState)


@given(st.lists(st.sampled_from(JobState), max_size=30))
def test_no_illegal_transition_is_reachable(wishes: list[JobState]) -> None:
    now = job()
    for at, wish in enumerate(wishes):
        before = now
        try:
            now = advance(now, wish, float(at))
        except IllegalTransition:
            assert wish not in TRANSITIONS[before.state]
            assert now is before
        else:
            assert wish in TRANSITIONS[before.state]
            assert now.state == wish
            # What was written can only end by way of the vehicle: verified, or taken back.
            if before.state in WRITING:
                assert now.state in WRITING | {JobState.SUCCEEDED, JobState.REVERTED, JobState.REVIEW}


def test_a_job_that_may_have_written_cannot_be_cancelled_or_fail() -> None:
    for state in WRITING:
        assert not TRANSITIONS[state] & {JobState.FAILED, JobState.CANCELLED, JobState.INTERRUPTED}
    assert not CANCELLABLE & WRITING
    assert not PHYSICAL & ENDED


def test_an_end_is_an_end() -> None:
    for state in ENDED - {JobState.SUCCEEDED, JobState.INTERRUPTED}:
        assert not TRANSITIONS[state]
    with pytest.raises(IllegalTransition, match="failed"):
        advance(job(JobState.FAILED), JobState.RUNNING, 1.0)


def test_time_does_not_go_back() -> None:
    later = advance(job(), JobState.RUNNING, 10.0)
    assert advance(later, JobState.FITTING, 5.0).updated_at == 10.0
