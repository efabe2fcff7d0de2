"""A job as JSON and back, exactly; the parts that ``calib`` knows go through :mod:`calib.report`."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mavcal.calib.firmware.plan import Fingerprint
from mavcal.calib.procedures.protocol import Progress, Prompt
from mavcal.calib.report import (
    fit_from_json,
    fit_to_json,
    plan_from_json,
    plan_to_json,
    step_from_json,
    step_to_json,
    verification_from_json,
    verification_to_json,
)
from mavcal.service.jobs.model import (
    Accept,
    Attempt,
    Failure,
    Holds,
    Job,
    Outcome,
    Result,
    Span,
    Standing,
    WriteResult,
)
from mavcal.service.jobs.proof import ProofLevel, Unproved
from mavcal.service.jobs.states import JobState
from mavcal.service.store.rows import JobRow

Json = dict[str, Any]


def row_from_job(job: Job) -> JobRow:
    """The job as the store keeps it."""
    body: Json = {
        "options": dict(job.options),
        "fingerprint": None if job.fingerprint is None else dataclasses.asdict(job.fingerprint),
        "progress": None if job.progress is None else step_to_json(job.progress),
        "prompt": None if job.prompt is None else step_to_json(job.prompt),
        "outcome": outcome_to_json(job.outcome),
        "results": [fit_to_json(fit) for fit in job.results],
        "plan": None if job.plan is None else plan_to_json(job.plan),
        "accept": None if job.accept is None else dataclasses.asdict(job.accept),
        "verification": None if job.verification is None else verification_to_json(job.verification),
        "segments": [{**dataclasses.asdict(s), "path": str(s.path)} for s in job.segments],
        "standing": [dataclasses.asdict(s) for s in job.standing],
        "last_write": attempt_to_json(job.last_write),
        "warnings": list(job.warnings),
        "context": dict(job.context),
    }
    return JobRow(job.id, job.vehicle_id, job.kind, job.state.value, job.created_at, job.updated_at, body)


def job_from_row(row: JobRow) -> Job:
    """The job that :func:`row_from_job` made `row` of."""
    body = row.body
    progress, prompt = _step(body["progress"]), _step(body["prompt"])
    return Job(
        id=row.id,
        vehicle_id=row.vehicle_id,
        kind=row.kind,
        options=body["options"],
        state=JobState(row.state),
        created_at=row.created_at,
        updated_at=row.updated_at,
        fingerprint=None if body["fingerprint"] is None else fingerprint_from_json(body["fingerprint"]),
        progress=progress if isinstance(progress, Progress) else None,
        prompt=prompt if isinstance(prompt, Prompt) else None,
        outcome=_outcome(body["outcome"]),
        results=tuple(fit_from_json(fit) for fit in body["results"]),
        plan=None if body["plan"] is None else plan_from_json(body["plan"]),
        accept=None if body["accept"] is None else Accept(**body["accept"]),
        verification=None if body["verification"] is None else verification_from_json(body["verification"]),
        segments=tuple(Span(**{**s, "path": Path(s["path"])}) for s in body["segments"]),
        standing=tuple(Standing(**{**s, "holds": Holds(s.get("holds", "unknown"))}) for s in body["standing"]),
        last_write=_attempt(body.get("last_write")),
        warnings=tuple(body["warnings"]),
        context=body["context"],
    )


def outcome_to_json(outcome: Outcome | None) -> Json | None:
    """``{"kind": "result" | "failure", "proof": …}``; None while the job goes on."""
    if outcome is None:
        return None
    if isinstance(outcome, Result):
        return {"kind": "result", **dataclasses.asdict(outcome)}
    nothing = {"proof": ProofLevel.NONE, "proof_reason": outcome.cause, "unproved": ()}
    return {"kind": "failure", **dataclasses.asdict(outcome), **nothing}


def _outcome(data: Mapping[str, Any] | None) -> Outcome | None:
    if data is None:
        return None
    if data["kind"] == "failure":
        return Failure(data["code"], data["cause"], data["remedy"])
    unproved = tuple(Unproved(**u) for u in data.get("unproved", ()))
    return Result(data["text"], ProofLevel(data.get("proof", "none")), data.get("proof_reason", ""), unproved)


def attempt_to_json(attempt: Attempt | None) -> Json | None:
    """As plain data; None: nothing was written yet."""
    return None if attempt is None else dataclasses.asdict(attempt)


def _attempt(data: Mapping[str, Any] | None) -> Attempt | None:
    return None if data is None else Attempt(**{**data, "result": WriteResult(data["result"])})


def fingerprint_from_json(data: Mapping[str, Any]) -> Fingerprint:
    """The inverse of ``dataclasses.asdict``."""
    ids = tuple((str(name), int(value)) for name, value in data["device_ids"])
    return Fingerprint(data["autopilot"], data["uid"], data["firmware"], ids)


def _step(data: Mapping[str, Any] | None) -> object:
    return None if data is None else step_from_json(data)
