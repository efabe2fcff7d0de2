"""Jobs as versions before this one stored them: they are read, and written again the same."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from mavcal.service.jobs.core.codec import job_from_row, row_from_job
from mavcal.service.jobs.core.model import Failure, Result, WriteResult
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store.rows import JobRow

STORED = sorted((Path(__file__).parent / "stored").glob("*.json"))


def stored(name: str) -> JobRow:
    (path,) = (path for path in STORED if path.stem == name)
    return JobRow(**json.loads(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize("path", STORED, ids=lambda path: path.stem)
def test_a_stored_job_is_written_again_to_the_byte(path: Path) -> None:
    row = JobRow(**json.loads(path.read_text(encoding="utf-8")))
    again = row_from_job(job_from_row(row))
    assert json.dumps(vars(again), allow_nan=False) == json.dumps(vars(row))


def test_a_prompt_of_before_it_said_what_stays_open_is_read() -> None:
    row = stored("every-field")
    added = ("taken", "tilts", "unfinished", "silence")
    body = {**row.body, "prompt": {key: value for key, value in row.body["prompt"].items() if key not in added}}
    assert row_from_job(job_from_row(replace(row, body=body))) == row


def test_a_job_that_was_written_has_its_plan_and_its_proof() -> None:
    job = job_from_row(stored("written"))
    assert job.state is JobState.SUCCEEDED
    assert job.plan is not None
    assert job.accept is not None
    assert job.plan.sha256 == job.accept.plan_sha256
    assert job.verification is not None
    assert isinstance(job.outcome, Result)
    assert job.last_write is not None
    assert job.last_write.result is WriteResult.SUCCEEDED
    assert [fit.instance for fit in job.results] == [0, 1, 2]
    assert job.results[0].covariance.shape == (12, 12)


def test_a_job_with_every_field_has_them_all() -> None:
    job = job_from_row(stored("every-field"))
    assert isinstance(job.outcome, Failure)
    assert job.prompt is not None
    assert job.prompt.number is not None
    assert job.standing[0].certain
    assert job.segments[0].path == Path("a.tlog")
