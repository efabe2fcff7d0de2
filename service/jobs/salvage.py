"""Reads jobs from the store, even from damaged rows: no row stops the start, and no write stays half done."""

from __future__ import annotations

from typing import Any

import structlog

from mavcal.calib.firmware.plan import WritePlan
from mavcal.calib.report import from_json
from mavcal.service.jobs.account import as_heard
from mavcal.service.jobs.codec import job_from_row
from mavcal.service.jobs.journal import JournalStep, fold
from mavcal.service.jobs.model import Failure, Job, Standing
from mavcal.service.jobs.states import ENDED, WRITING, JobState
from mavcal.service.store.protocol import JobStore
from mavcal.service.store.rows import JobRow

log = structlog.get_logger(__name__)

CODE = "job-unreadable"


def job_of(row: JobRow, store: JobStore) -> Job:
    """The job of a row; where its body cannot be read, what the rest of the store still says of it.

    A job that was writing keeps its plan, which the journal names: the write can be finished or taken back. Without a
    plan it is in doubt for good. Any other unreadable job has failed, or stays ended as it was.
    """
    try:
        return job_from_row(row)
    except Exception as error:
        log.error("a job cannot be read", job=row.id, state=row.state, exc_info=error)
    state = JobState(row.state) if row.state in set(JobState) else JobState.FAILED
    if state not in WRITING:
        state = state if state in ENDED else JobState.FAILED
        text = "The record of this job is damaged."
        return _bare(row, state, outcome=Failure(CODE, text, "Start the job again if its result is needed."))
    plan = _accepted_plan(row.id, store)
    if plan is not None:
        return _bare(row, state, plan=plan, fingerprint=plan.fingerprint)
    text = "The record of this job is damaged, and it was writing: nobody knows what the vehicle holds."
    remedy = "Compare the vehicle's calibration parameters with a backup. Then use another data directory."
    known = _sent(row.id, store)
    return _bare(row, JobState.IN_DOUBT, outcome=Failure(CODE, text, remedy), standing=known)


def _sent(job_id: str, store: JobStore) -> tuple[Standing, ...]:
    """Every parameter that the journal says was sent, or may have been, if the store can still read it."""
    try:
        return as_heard(fold(store.journal(job_id)), {}, "before the service was interrupted")
    except Exception as error:
        log.error("the journal of a damaged job cannot be read", job=job_id, exc_info=error)
        return ()


def _bare(row: JobRow, state: JobState, **known: Any) -> Job:
    return Job(row.id, row.vehicle_id, row.kind, {}, state, row.created_at, row.updated_at, **known)


def _accepted_plan(job_id: str, store: JobStore) -> WritePlan | None:
    """The plan of the newest accept, if the store can still read it."""
    try:
        accepted = [r.data["plan_sha256"] for r in store.journal(job_id) if r.step == JournalStep.ACCEPTED]
        body = store.plan(job_id, accepted[-1]) if accepted else None
        return None if body is None else from_json(body, WritePlan)
    except Exception as error:
        log.error("the plan of a damaged job cannot be read", job=job_id, exc_info=error)
        return None
