from __future__ import annotations

from contextlib import asynccontextmanager
from types import SimpleNamespace

import click
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.client import ApiProblem, UnexpectedAnswer, Unreachable
from mavcal.client.enums import JobState as ClientState
from mavcal.client.events import StateData, StateEvent
from mavcal.service.commands import keyboard, remote
from mavcal.service.commands.follow import came_well, followed, show_came_of
from mavcal.service.commands.headless import rests
from mavcal.service.commands.output import AnsweredNo
from mavcal.service.commands.remote import service_at
from mavcal.service.errors import AnswerRefused
from mavcal.service.jobs.core.model import Failure, Result
from mavcal.service.jobs.core.states import ENDED, JobState
from tests.unit.api.samples import PLAN
from tests.unit.commands.doubles import of_service, plain
from tests.unit.commands.test_review import BLOCKED

RUNNING = plain("j", JobState.RUNNING)
SUCCEEDED = plain("j", JobState.SUCCEEDED, outcome=Result("It is written."))


def problem(status, **more):
    return ApiProblem(status, {"code": "x-happened", "detail": "It is so.", **more})


@pytest.mark.parametrize("url", ["http://127.0.0.1:8765", "https://host/prefix", "http://[::1]:80"])
def test_an_address_of_a_service_is_taken(url):
    with service_at(url, None) as client:
        assert client is not None


@pytest.mark.parametrize(
    "url", ["", "127.0.0.1:8765", "udpin:0.0.0.0:14550", "ftp://host", "http://", "http://host:0", "http://[::1"]
)
def test_what_is_no_address_is_wrong_use(url):
    with pytest.raises(click.UsageError, match="no address of a service"), service_at(url, None):
        pass


def test_the_key_is_the_one_word_of_its_file(tmp_path):
    file = tmp_path / "key"
    file.write_text(" secret \n")
    assert remote.key_in(file) == "secret"
    assert remote.key_in(None) is None


@pytest.mark.parametrize("content", [b"", b"two words", b"one\ntwo\n", "schl\u00fcssel".encode()])
def test_a_file_that_holds_no_key_is_wrong_use(tmp_path, content):
    file = tmp_path / "key"
    file.write_bytes(content)
    with pytest.raises(click.UsageError, match="--key-file"):
        remote.key_in(file)


def test_a_file_that_is_gone_is_wrong_use(tmp_path):
    with pytest.raises(click.UsageError, match="cannot be read"):
        remote.key_in(tmp_path / "gone")


@pytest.mark.parametrize(
    ("error", "code", "exit_code"),
    [
        (problem(409), "x-happened", 1),
        (problem(404), "x-happened", 1),
        (problem(503), "x-happened", 1),
        *((problem(status), "x-happened", 2) for status in (401, 403, 422, 429)),
        (problem(500, code=""), "problem", 1),
        (Unreachable("refused"), "unreachable", 1),
        (UnexpectedAnswer("not JSON"), "unexpected-answer", 2),
    ],
)
def test_what_a_service_refuses_has_a_code_and_an_exit_code(error, code, exit_code):
    with pytest.raises(AnsweredNo) as raised, service_at("http://h", None):
        raise error
    assert (raised.value.code, raised.value.ends_with) == (code, exit_code)


def test_a_problem_is_told_by_its_detail_and_without_one_by_its_title():
    with pytest.raises(AnsweredNo, match=r"^It is so\.$"), service_at("http://h", None):
        raise problem(409)
    with pytest.raises(AnsweredNo, match="409: Conflict"), service_at("http://h", None):
        raise problem(409, detail="", title="Conflict")


def test_an_error_of_ours_goes_through():
    with pytest.raises(ZeroDivisionError), service_at("http://h", None):
        raise ZeroDivisionError


@given(st.sampled_from(JobState))
def test_a_job_rests_when_it_has_ended_or_waits_in_review(state):
    assert rests(of_service(plain("j", state))) == (state in ENDED | {JobState.REVIEW})


@pytest.mark.parametrize(
    ("job", "well"),
    [
        (SUCCEEDED, True),
        (plain("j", JobState.REVIEW, plan=PLAN), False),  # it is blocked
        (plain("j", JobState.REVIEW, plan=BLOCKED), False),
        (plain("j", JobState.REVIEW, plan=None), False),
        (plain("j", JobState.REVERTED, outcome=Result("It is back.")), False),
        (plain("j", JobState.FAILED, outcome=Failure("x", "It moved", "hold it")), False),
    ],
)
def test_a_job_came_well_that_succeeded(job, well):
    assert came_well(of_service(job)) is well


def test_a_plan_that_may_be_written_came_well_unless_a_write_of_it_failed():
    plan = of_service(plain("j", JobState.REVIEW, plan=PLAN)).plan.model_copy(update={"blockers": []})
    job = of_service(plain("j", JobState.REVIEW)).model_copy(update={"plan": plan})
    assert came_well(job)
    failed = of_service(plain("j", JobState.FAILED, outcome=Failure("x", "It moved", "hold it")))
    assert not came_well(job.model_copy(update={"outcome": failed.outcome}))
    assert not came_well(job.model_copy(update={"state": ClientState.FAILED}))


@pytest.mark.parametrize(
    ("job", "said"),
    [
        (SUCCEEDED, "succeeded: It is written."),
        (plain("j", JobState.FAILED, outcome=Failure("x", "It moved", "hold it")), "failed: It moved. Hold it."),
        (plain("j", JobState.REVIEW, plan=PLAN), "review: its plan waits: `mavcal accept j` writes it"),
        (plain("j", JobState.CANCELLED), "cancelled"),
    ],
)
def test_where_a_job_stands_is_one_line(screen, job, said):
    show_came_of(of_service(job), screen)
    assert screen.lines == [said]


class Service:
    """A client whose service tells of a job: `jobs` one after the other, whenever it is asked for."""

    def __init__(self, *jobs, events=()):
        self.jobs, self.events = list(jobs), list(events)
        self.followed = 0
        self.answers = []

    async def get_job(self, _job_id):
        return of_service(self.jobs.pop(0) if len(self.jobs) > 1 else self.jobs[0])

    async def follow_job(self, _job_id):
        for event in self.events:
            self.followed += 1
            yield SimpleNamespace(data=event)


def state_event(at, state):
    return StateEvent.model_construct(kind="state", at=at, data=StateData.model_construct(state=ClientState(state)))


def event(at, kind, **data):
    return SimpleNamespace(at=at, kind=kind, data=SimpleNamespace(model_dump=lambda mode: data))


async def test_a_job_that_rests_already_is_not_followed(screen):
    client = Service(SUCCEEDED, events=[state_event(1.0, "running")])
    assert (await followed(client, "j", screen)).state == "succeeded"
    assert (client.followed, screen.lines) == (0, [])


async def test_a_job_is_followed_until_it_rests(screen):
    events = [
        event(1.0, "prompt", text="Turn it."),
        state_event(2.0, "fitting"),
        state_event(3.0, "succeeded"),
        event(4.0, "prompt", text="too late"),
    ]
    client = Service(RUNNING, RUNNING, SUCCEEDED, events=events)
    assert (await followed(client, "j", screen)).state == "succeeded"
    assert client.followed == 3
    assert screen.lines == ["  > Turn it.", "    fitting", "    succeeded"]


async def test_a_typed_line_answers_the_job_and_a_refusal_is_shown(screen, monkeypatch):
    taken = []

    class Answering(Service):
        async def answer_job(self, job_id, *, value):
            taken.append((job_id, value))
            if value == "seven":
                raise AnswerRefused("It is so.")

    @asynccontextmanager
    async def typing(answer):
        await answer("seven")
        await answer("7")
        yield

    monkeypatch.setattr(keyboard, "keyboard", typing)
    await followed(Answering(RUNNING, events=[]), "j", screen)
    assert taken == [("j", "seven"), ("j", "7")]
    assert screen.lines == ["    It is so."]
