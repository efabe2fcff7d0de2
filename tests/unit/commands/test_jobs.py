from __future__ import annotations

import json
import re
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from mavcal.client.models import JobSummary
from mavcal.service.cli import cli
from mavcal.service.commands.jobs import table
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import JobRow


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    store = SqliteStore(tmp_path)
    gap = {"options": {"real": "0123456789abcdef"}, "outcome": {"kind": "result", "text": "The gap is explained."}}
    moved = {"kind": "failure", "code": "moved", "cause": "The vehicle was moved.", "remedy": "Leave it alone."}
    failed = {"options": {}, "outcome": moved}
    store.save_job(JobRow("j1", "v1", "gyro", "failed", 60.0, 61.0, failed))
    store.save_job(JobRow("j2", None, "gap", "succeeded", 120.0, 121.0, gap))
    store.save_job(JobRow("j3", "v1", "gyro", "review", 180.0, 181.0, {"options": {}, "outcome": None}))
    store.close()
    return tmp_path


def shown(folder: Path, *arguments: str) -> str:
    result = CliRunner().invoke(cli, ["jobs", "--data-dir", str(folder), *arguments], standalone_mode=False)
    assert result.exception is None, result.exception
    return result.output


def test_jobs_of_every_kind_are_listed_newest_first(folder: Path) -> None:
    lines = [re.split(r" {2,}", line.strip()) for line in shown(folder).splitlines()]
    assert [line[:3] for line in lines[1:]] == [
        ["j3", "gyro", "review"],
        ["j2", "gap", "succeeded"],
        ["j1", "gyro", "failed"],
    ]
    assert [line[3].split()[-1] for line in lines[1:]] == ["v1", "01234567", "v1"]
    assert [line[4].split()[-1] for line in lines[1:]] == ["00:03", "00:02", "00:01"]
    assert [len(line) for line in lines] == [6, 5, 6, 6]  # one that waits in review has no outcome
    assert lines[2][5].endswith("explained.")
    assert lines[3][5].endswith("moved.")


def test_kind_state_and_number_choose(folder: Path) -> None:
    def ids(*arguments: str) -> list[str]:
        return [job["id"] for job in json.loads(shown(folder, "--json", *arguments))["jobs"]]

    assert ids("--kind", "gyro") == ["j3", "j1"]
    assert ids("--state", "failed") == ["j1"]
    assert ids("--limit", "2") == ["j3", "j2"]
    assert json.loads(shown(folder, "--json", "--limit", "1"))["next"] == "j3"
    assert "there are older jobs: --after j3 lists them" in shown(folder, "--limit", "1")
    assert ids("--limit", "2", "--after", "j3") == ["j2", "j1"]
    assert "older" not in shown(folder, "--limit", "2", "--after", "j3")
    assert shown(folder, "--kind", "none").startswith("job  kind")


def test_a_job_is_told_as_over_http(folder: Path) -> None:
    (job,) = json.loads(shown(folder, "--json", "--kind", "gap"))["jobs"]
    assert set(job) == set(JobSummary.model_fields)
    assert job["options"] == {"real": "0123456789abcdef"}


def test_a_job_whose_record_is_damaged_is_listed_all_the_same(folder: Path) -> None:
    store = SqliteStore(folder)
    store.save_job(JobRow("j4", "v1", "gyro", "failed", 240.0, 241.0, {"outcome": {"kind": "failure"}}))
    store.close()
    assert shown(folder, "--limit", "1").splitlines()[1].split() == [
        "j4",
        "gyro",
        "failed",
        "v1",
        "1970-01-01",
        "00:04",
    ]


def test_a_state_that_there_is_not_is_wrong_use(folder: Path) -> None:
    result = CliRunner().invoke(cli, ["jobs", "--data-dir", str(folder), "--state", "done"], standalone_mode=False)
    assert isinstance(result.exception, click.UsageError)


def test_a_table_of_nothing_is_its_head() -> None:
    assert [line.split() for line in table([("a", "b")])] == [["a", "b"]]
