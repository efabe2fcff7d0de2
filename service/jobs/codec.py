"""A job as JSON and back, exactly; the parts that ``calib`` knows go through :mod:`calib.report`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from cattrs import Converter
from cattrs.gen import make_dict_unstructure_fn

from mavcal.calib import report
from mavcal.calib.converter import lenient, read
from mavcal.calib.procedures.protocol import Progress, Prompt
from mavcal.service.jobs.model import Failure, Job, Outcome, Result, Unwritten
from mavcal.service.jobs.proof import ProofLevel
from mavcal.service.store.rows import JobRow

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
