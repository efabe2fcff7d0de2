"""What every command ends with: one sentence, a code for programs, an exit code."""

from __future__ import annotations

import json

import click
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.client.enums import JobState as ClientState
from mavcal.service import cli
from mavcal.service.cli import COMMANDS, main
from mavcal.service.commands import audit, jobs
from mavcal.service.commands.calibrate import KINDS
from mavcal.service.commands.output import AnsweredNo
from mavcal.service.errors import DataDirLocked, JobUnknown, LinkDown, VehicleSilent
from mavcal.service.jobs.core.states import JobState
from tests.unit.commands.doubles import of_service, plain


@pytest.fixture
def ended(monkeypatch, capsys):
    """Runs a command that ends so: exit code, stdout and stderr."""
    monkeypatch.setattr(cli, "follow", lambda: None)

    def run(outcome, *more):
        @click.command()
        @click.option("--json", is_flag=True)
        def command(**_):
            if isinstance(outcome, BaseException):
                raise outcome
            return outcome

        monkeypatch.setattr(audit, "command", command)
        with pytest.raises(SystemExit) as raised:
            main(["audit", *more])
        said = capsys.readouterr()
        return raised.value.code, said.out, said.err

    return run


@pytest.mark.parametrize(
    ("outcome", "code"),
    [
        (0, 0),
        (1, 1),
        (3, 3),
        (143, 143),
        (None, 0),
        (VehicleSilent("nobody"), 1),  # the vehicle's answer is no
        (JobUnknown("there is none"), 1),
        (LinkDown("it is down"), 1),
        (DataDirLocked("it is owned"), 2),
        (InvalidInputError("no gyro"), 2),
        (click.UsageError("give one"), 2),
        (click.ClickException("cannot be written"), 2),
        (AnsweredNo("job-unknown", "there is none"), 1),
        (AnsweredNo("not-allowed", "you may not", 2), 2),
        (click.Abort(), 130),
        (KeyboardInterrupt(), 130),
        (BrokenPipeError(), 0),
    ],
)
def test_the_exit_code_says_how_it_ended(ended, outcome, code):
    assert ended(outcome)[0] == code


@pytest.mark.parametrize(
    ("outcome", "code", "detail"),
    [
        (VehicleSilent("nobody"), "vehicle-silent", "nobody"),
        (InvalidInputError("no gyro"), "InvalidInputError", "no gyro"),
        (click.UsageError("give one"), "usage", "give one"),
        (AnsweredNo("job-unknown", "there is none"), "job-unknown", "there is none"),
    ],
)
def test_an_error_is_a_sentence_and_with_json_an_object_as_well(ended, outcome, code, detail):
    assert ended(outcome)[1:] == ("", f"mavcal: {detail}\n")
    _, out, err = ended(outcome, "--json")
    assert json.loads(out) == {"error": {"code": code, "detail": detail}}
    assert err == f"mavcal: {detail}\n"


def test_an_unexpected_error_is_not_hidden(monkeypatch):
    monkeypatch.setattr(cli, "follow", lambda: None)
    monkeypatch.setattr(cli.cli, "main", lambda **_: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        main([])


def test_the_table_of_commands_is_the_help_and_each_can_be_loaded(capsys, monkeypatch):
    monkeypatch.setattr(cli, "follow", lambda: None)
    with pytest.raises(SystemExit) as raised:
        main(["--help"])
    assert raised.value.code == 0
    said = capsys.readouterr().out
    assert all(f"  {name}" in said for name in COMMANDS)
    with pytest.raises(SystemExit) as raised:
        main(["no-such"])
    assert raised.value.code == 2
    assert "No such command 'no-such'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["no-such"], "mavcal: No such command 'no-such': see `mavcal --help`\n"),
        (["fit", "no-such"], "mavcal: No such command 'no-such': see `mavcal fit --help`\n"),
        (["inspect"], "mavcal: Missing argument 'FILE...': see `mavcal inspect --help`\n"),
        (["gap"], "mavcal: Missing option '--real': see `mavcal gap --help`\n"),
        (["calibrate"], f"mavcal: Missing argument 'KIND'. Choose from: {', '.join(KINDS)}\n"),
    ],
)
def test_a_wrong_use_is_one_line_that_says_where_to_look(capsys, monkeypatch, arguments, said):
    monkeypatch.setattr(cli, "follow", lambda: None)
    with pytest.raises(SystemExit) as raised:
        main(arguments)
    assert raised.value.code == 2
    assert capsys.readouterr().err == said


class Listing:
    """A client of a service with so many jobs, newest first."""

    def __init__(self, count):
        self.jobs = [of_service(plain(f"j{k}", JobState.FAILED)) for k in range(count)]
        self.asked = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def list_jobs(self, *, kind, state, order, limit, after):
        self.asked.append((kind, state, order, limit, after))
        begin = 0 if after is None else [job.id for job in self.jobs].index(after) + 1
        return self.jobs[begin : begin + limit]


@pytest.mark.parametrize(("count", "limit", "following"), [(5, 2, "j1"), (2, 2, None), (1, 2, None), (0, 2, None)])
def test_jobs_of_a_service_are_listed_a_page_at_a_time(monkeypatch, capsys, count, limit, following):
    client = Listing(count)
    monkeypatch.setattr(jobs, "service_at", lambda url, key: client)
    options = {"data_dir": None, "url": "http://h", "key_file": None, "kind": "gyro", "after": None}
    assert jobs.command.callback(**options, state="failed", limit=limit, as_json=True) == 0
    told = json.loads(capsys.readouterr().out)
    assert [job["id"] for job in told["jobs"]] == [f"j{k}" for k in range(min(count, limit))]
    assert told["next"] == following
    assert client.asked[0] == ("gyro", ClientState.FAILED, "newest", limit, None)
    assert jobs.command.callback(**options, state=None, limit=limit, as_json=False) == 0
    assert ("--after j1" in capsys.readouterr().out) is (following is not None)


@pytest.mark.parametrize(
    ("job", "about"),
    [
        ({"options": {"task": "preflight"}, "vehicle_id": None}, "preflight"),
        ({"options": {"recording": "0123456789ab"}, "vehicle_id": None}, "recording 01234567"),
        ({"options": {"real": "abcdefghijkl"}, "vehicle_id": None}, "recording abcdefgh"),
        ({"options": {"recording": "0123456789ab"}, "vehicle_id": "v1"}, "v1"),
    ],
)
def test_a_job_is_of_its_vehicle_or_of_what_it_is_about(job, about):
    assert jobs._about(job) == about
