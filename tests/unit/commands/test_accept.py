"""What a running service is asked to write or to take back, and what counts as success."""

from __future__ import annotations

import json
from contextlib import asynccontextmanager, contextmanager
from dataclasses import replace

import click
import pytest
from click.testing import CliRunner

from mavcal.client.enums import JobState as ClientState
from mavcal.service.commands import accept, answer, cancel, follow, revert
from mavcal.service.commands.review import JobWish
from mavcal.service.jobs.core.model import Failure, Result
from mavcal.service.jobs.core.states import JobState
from tests.unit.commands.doubles import FakeVehicle, of_service, plain
from tests.unit.commands.test_review import BLOCKED, EMPTY, FULL, HALF, PLAN, WROTE

WISH = JobWish("", write=True)


class Service:
    """A client of a service that notes what it is asked; `job` is what it tells."""

    def __init__(self, job, after=None):
        self.job, self.after = job, after
        self.asked = []

    async def get_job(self, _job_id):
        return of_service(self.job)

    async def renew_plan(self, _job_id, *, plan_options):
        self.asked.append(("plan", plan_options.model_dump(exclude_unset=True)))
        return of_service(self.job).plan

    async def apply_plan(self, _job_id, *, plan_sha256, reboot):
        self.asked.append(("apply", plan_sha256, reboot))
        self.job = self.after

    async def revert_job(self, _job_id):
        self.asked.append(("revert",))
        self.job = self.after


@pytest.fixture
def at(monkeypatch):
    """Puts such a service at every address."""

    def put(service):
        @asynccontextmanager
        async def opened(url, key_file):
            service.asked.append((url, key_file))
            yield service

        for module in (accept, revert, follow):
            monkeypatch.setattr(module, "async_service_at", opened)
        return service

    return put


def invoked(command, *arguments):
    result = CliRunner().invoke(command, arguments, standalone_mode=False)
    if result.exception is not None:
        raise result.exception
    return result.return_value, result.stdout


def ended(outcome=FULL, plan=PLAN, state=JobState.SUCCEEDED):
    return plain("j", state, outcome=outcome, plan=plan)


def in_review(plan=PLAN, **more):
    return plain("j", JobState.REVIEW, plan=plan, **more)


def test_the_plan_is_made_again_with_old_and_new_decisions_and_what_was_shown_is_written(at):
    decided = {"plan_options": {"only": ["gyro0"], "mark_calibrated": True}}
    service = at(Service(in_review(context=decided), ended()))
    code, _ = invoked(accept.command, "j", "--url", "http://h", "--reboot", "--no-mark-calibrated")
    assert code == 0
    assert service.asked[1:] == [
        ("plan", {"only": ["gyro0"], "mark_calibrated": False}),
        ("apply", PLAN.sha256, True),
    ]


@pytest.mark.parametrize(("plan", "code"), [(BLOCKED, 1), (EMPTY, 1)])
def test_a_plan_that_is_blocked_or_empty_is_not_written(at, plan, code):
    service = at(Service(in_review(plan)))
    assert invoked(accept.command, "j", "--url", "http://h")[0] == code
    assert [what for what, *_ in service.asked[1:]] == ["plan"]


def test_json_is_the_job_as_it_ended(at):
    at(Service(in_review(), ended()))
    told = json.loads(invoked(accept.command, "j", "--url", "http://h", "--json")[1])
    assert (told["id"], told["state"]) == ("j", "succeeded")


@pytest.mark.parametrize(
    ("job", "require_proof", "good"),
    [
        (ended(), True, True),
        (ended(HALF), False, True),
        (ended(HALF), True, False),
        (ended(HALF, EMPTY), True, True),
        (ended(HALF, None), True, False),
        (ended(Failure("x", "It moved", "hold it"), state=JobState.FAILED), False, False),
        (in_review(), False, False),
    ],
)
def test_a_write_of_a_service_is_good_as_one_from_here(job, require_proof, good):
    assert accept._good(of_service(job), replace(WISH, require_proof=require_proof)) is good


@pytest.mark.parametrize("arguments", [(), ("--url", "http://h", "--connect", "tcp:v:1")])
def test_either_a_vehicle_or_a_service_is_named(arguments):
    with pytest.raises(click.UsageError, match="give --connect to write from here, or --url"):
        invoked(accept.command, "j", *arguments)


@pytest.mark.parametrize(("state", "code"), [(JobState.REVERTED, 0), (JobState.IN_DOUBT, 1)])
def test_a_service_takes_a_write_back(at, monkeypatch, state, code):
    service = at(Service(ended(), plain("j", state, outcome=Result("It is back."))))

    async def rested(client, job_id, _screen, since):
        assert since == 0.0
        return await client.get_job(job_id)

    monkeypatch.setattr(revert, "followed", rested)
    assert invoked(revert.command, "j", "--url", "http://h")[0] == code
    assert service.asked[1:] == [("revert",)]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "name the JOB, or give --all"),
        (("j", "--all"), "name the JOB, or give --all"),
        (("--all", "--url", "http://h"), "not of a --url"),
        (("j",), "give --connect to write from here"),
        (("j", "--connect", "a", "--connect", "b"), "give one --connect URL"),
    ],
)
def test_what_is_taken_back_is_said_exactly(arguments, said):
    with pytest.raises(click.UsageError, match=said):
        invoked(revert.command, *arguments)


@pytest.fixture
def at_rest(monkeypatch):
    async def at_once(client, job_id):
        return await client.get_job(job_id)

    monkeypatch.setattr("mavcal.service.commands.hands_free.wait_for_job", at_once)


@pytest.mark.usefixtures("at_rest")
async def test_with_all_every_write_of_this_vehicle_is_taken_back_the_newest_first(make_service):
    wrote = {"last_write": WROTE, "outcome": FULL}
    service = make_service(
        plain("old", JobState.SUCCEEDED, **{**wrote, "updated_at": 1.0}),
        plain("newest", JobState.SUCCEEDED, **{**wrote, "updated_at": 5.0}),
        plain("middle", JobState.SUCCEEDED, **{**wrote, "updated_at": 3.0}),
        plain("foreign", JobState.SUCCEEDED, **{**wrote, "updated_at": 9.0, "vehicle_id": "v2"}),
        plain("unwritten", JobState.SUCCEEDED, updated_at=8.0),
        plain("gone", JobState.REVERTED, **{**wrote, "updated_at": 7.0}),
    )
    service.joined("tcp:v:1", "v1", "v2")
    acted = await revert._all_writes(service, service.vehicles["v1"], 1.0)
    assert service.jobs.done == [("revert", "newest"), ("revert", "middle"), ("revert", "old")]
    assert acted.good
    assert acted.text.startswith("job newest (gyro) is reverted: It is written. job middle (gyro) is reverted")
    assert [told["state"] for told in acted.document["jobs"]] == ["reverted"] * 3


async def test_a_vehicle_to_which_nothing_was_written_is_no_failure(make_service):
    service = make_service()
    acted = await revert._all_writes(service, FakeVehicle(), 1.0)
    assert (acted.good, acted.document, service.jobs.done) == (True, {"jobs": []}, [])


@pytest.mark.usefixtures("at_rest")
async def test_an_older_write_waits_for_a_newer_one_that_is_not_taken_back(make_service, monkeypatch):
    wrote = {"last_write": WROTE, "outcome": FULL}
    service = make_service(
        plain("old", JobState.SUCCEEDED, **{**wrote, "updated_at": 1.0}),
        plain("new", JobState.SUCCEEDED, **{**wrote, "updated_at": 5.0}),
    )
    service.joined("tcp:v:1", "v1")

    async def stuck(_jobs, job_id):
        failure = Failure("in-doubt", "It fell silent", "Switch it on")
        return of_service(plain(job_id, JobState.IN_DOUBT, outcome=failure))

    monkeypatch.setattr("mavcal.service.commands.hands_free.wait_for_job", stuck)
    acted = await revert._all_writes(service, service.vehicles["v1"], 1.0)
    assert service.jobs.done == [("revert", "new")]
    assert not acted.good
    assert acted.text.endswith("job old (gyro) was not tried")


@pytest.mark.parametrize(("job", "code"), [(ended(), 0), (in_review(BLOCKED), 1), (ended(state=JobState.REVERTED), 1)])
def test_following_ends_as_the_job_does(at, job, code):
    at(Service(job))
    assert invoked(follow.command, "j", "--url", "http://h")[0] == code
    told = json.loads(invoked(follow.command, "j", "--url", "http://h", "--json")[1])
    assert told["state"] == job.state.value


@pytest.mark.parametrize("module", [answer, cancel])
def test_an_answer_and_a_cancellation_are_handed_on(monkeypatch, module):
    class Client:
        def answer_job(self, job_id, *, value):
            assert (job_id, value) == ("j", "finish")
            return of_service(ended())

        def cancel_job(self, job_id):
            assert job_id == "j"
            return of_service(plain("j", JobState.CANCELLED))

    @contextmanager
    def opened(_url, _key_file):
        yield Client()

    monkeypatch.setattr(module, "service_at", opened)
    arguments = ("j", "finish") if module is answer else ("j",)
    assert invoked(module.command, *arguments) == (0, "")
    state = json.loads(invoked(module.command, *arguments, "--json")[1])["state"]
    assert state == (ClientState.SUCCEEDED if module is answer else ClientState.CANCELLED)
