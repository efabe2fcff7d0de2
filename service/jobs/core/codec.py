"""Converts a job to JSON and back without loss, and reads what is left of damaged rows."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import structlog
from cattrs import Converter
from cattrs.gen import make_dict_unstructure_fn

from mavcal.calib import report
from mavcal.calib.converter import lenient, read
from mavcal.calib.firmware.plan import WritePlan
from mavcal.calib.procedures.protocol import Progress, Prompt
from mavcal.service.jobs.core.journal import JournalStep, as_heard, fold
from mavcal.service.jobs.core.model import Failure, Job, Outcome, Result, Standing, Unwritten
from mavcal.service.jobs.core.proof import ProofLevel
from mavcal.service.jobs.core.states import ENDED, WRITING, JobState
from mavcal.service.store.rows import JobRow
from mavcal.service.store.sql import Store

log = structlog.get_logger(__name__)

Json = dict[str, Any]
T = TypeVar("T")
_COLUMNS = tuple(f.name for f in dataclasses.fields(JobRow) if f.name != "body")
"""Fields of a job that the store can search."""


def to_json(value: Any) -> Any:
    """As :func:`calib.report.to_json`; an outcome has its ``kind``: result, failure or write_failed."""
    return _CONVERTER.unstructure(value)


def from_json(data: Any, kind: type[T]) -> T:
    """As :func:`calib.report.from_json`."""
    return read(_CONVERTER, data, kind)


FAILURES: Mapping[str, type[Failure]] = {"failure": Failure, "write_failed": Unwritten}


def row_from_job(job: Job) -> JobRow:
    """The job as the store keeps it."""
    body = to_json(job)
    if not job.missed:
        del body["missed"]  # as jobs of before there were any
    return JobRow(**{name: body.pop(name) for name in _COLUMNS}, body=body)


def job_from_row(row: JobRow) -> Job:
    """The job that :func:`row_from_job` made `row` of. Raises InvalidInputError."""
    return from_json({**row.body, **{name: getattr(row, name) for name in _COLUMNS}}, Job)


def _made() -> Converter:
    made = report.CONVERTER.copy()
    write_result = make_dict_unstructure_fn(Result, made)
    made.register_unstructure_hook(Result, lambda outcome: {"kind": "result", **write_result(outcome)})
    for name, failed in FAILURES.items():
        _register_failure(made, name, failed)
    result = lenient(made, Result)
    failures = {name: (lenient(made, failed), failed) for name, failed in FAILURES.items()}

    def outcome(data: Json | None, _: Any) -> Outcome | None:
        if data is None:
            return None
        if data["kind"] not in failures:
            return result(data, Result)
        failure, failed = failures[data["kind"]]
        return failure(data, failed)

    made.register_structure_hook(Outcome | None, outcome)
    for kind, name in ((Progress, "progress"), (Prompt, "prompt")):
        made.register_structure_hook(kind | None, _only(made, kind, name))
    made.register_structure_hook(Job, lenient(made, Job))
    return made


def _register_failure(made: Converter, name: str, kind: type[Failure]) -> None:
    written = make_dict_unstructure_fn(kind, made)

    def write(outcome: Failure) -> Json:
        nothing = {"proof": ProofLevel.NONE.value, "proof_reason": outcome.cause, "unproved": []}
        return {"kind": name, **written(outcome), **nothing}

    made.register_unstructure_hook(kind, write)


def _only(made: Converter, kind: type, name: str) -> Callable[[Any, Any], Any]:
    """Reads a step of this kind; any other is none."""
    return lambda data, _: made.structure(data, kind) if data and data["type"] == name else None


_CONVERTER = _made()
CODE = "job-unreadable"


def job_of(row: JobRow, store: Store) -> Job:
    """The job of a row; if the body cannot be read, what the journal and the plan say of it.

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


def _sent(job_id: str, store: Store) -> tuple[Standing, ...]:
    """Every parameter that the journal says was sent, or may have been, if the store can still read it."""
    try:
        return as_heard(fold(store.journal(job_id)), {}, "before the service was interrupted")
    except Exception as error:
        log.error("the journal of a damaged job cannot be read", job=job_id, exc_info=error)
        return ()


def _bare(row: JobRow, state: JobState, **known: Any) -> Job:
    return Job(row.id, row.vehicle_id, row.kind, {}, state, row.created_at, row.updated_at, **known)


def _accepted_plan(job_id: str, store: Store) -> WritePlan | None:
    """The plan of the newest accept, if the store can still read it."""
    try:
        accepted = [r.data["plan_sha256"] for r in store.journal(job_id) if r.step == JournalStep.ACCEPTED]
        body = store.plan(job_id, accepted[-1]) if accepted else None
        return None if body is None else from_json(body, WritePlan)
    except Exception as error:
        log.error("the plan of a damaged job cannot be read", job=job_id, exc_info=error)
        return None
