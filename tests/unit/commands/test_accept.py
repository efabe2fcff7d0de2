"""What a running service is asked to write or to take back, and what counts as success."""

from __future__ import annotations

import json
from contextlib import contextmanager

import click
import pytest
from click.testing import CliRunner

from mavcal.client.enums import JobState as ClientState
from mavcal.service.commands import accept, answer, cancel, follow, revert
from mavcal.service.errors import NoVehicle, VehicleUnknown
from mavcal.service.jobs.core.model import Failure
from mavcal.service.jobs.core.states import JobState
from tests.unit.commands.doubles import FakeVehicle, of_service, plain
from tests.unit.commands.test_review import BLOCKED, FULL, PLAN, WROTE


@pytest.fixture
def at(make_service, runs):
    """Puts a service with this job at every address, which others use too; its write comes to `after`."""

    def put(job, after=None, vehicle="v1"):
        service = make_service(job, shared=True)
        service.joined("tcp:v:1", vehicle)
        service.jobs.planned = job
        service.jobs.steps = [] if after is None else [(after, "state", {})]
        runs(service)
        return service.jobs.done

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
    done = at(in_review(context=decided), ended())
    code, _ = invoked(accept.command, "j", "--url", "http://h", "--reboot", "--no-mark-calibrated")
    assert code == 0
    assert done == [
        ("plan_again", "j", {"only": ["gyro0"], "mark_calibrated": False}),
        ("apply", "j", PLAN.sha256, {"reboot": True}),
        ("wait_for_cleanup",),
    ]


def test_a_plan_that_is_blocked_is_not_written(at):
    done = at(in_review(BLOCKED))
    assert invoked(accept.command, "j", "--url", "http://h")[0] == 1
    assert [what for what, *_ in done] == ["plan_again", "wait_for_cleanup"]


def test_json_is_the_job_as_it_ended(at):
    at(in_review(), ended())
    told = json.loads(invoked(accept.command, "j", "--url", "http://h", "--json")[1])
    assert (told["id"], told["state"], told["recovered"]) == ("j", "succeeded", [])


@pytest.mark.parametrize("command", [accept.command, revert.command])
def test_the_vehicle_of_a_service_is_that_of_the_job(at, command):
    at(plain("j", JobState.REVIEW, vehicle_id=None))
    with pytest.raises(NoVehicle):
        invoked(command, "j", "--url", "http://h")
    at(in_review(), vehicle="v9")
    with pytest.raises(VehicleUnknown, match="no vehicle v1"):
        invoked(command, "j", "--url", "http://h")


def test_a_service_takes_a_write_back(at):
    done = at(ended())
    assert invoked(revert.command, "j", "--url", "http://h")[0] == 0
    assert done == [("revert", "j"), ("wait_for_cleanup",)]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "give --connect URL"),
        (("j", "--all"), "name the JOB, or give --all"),
        (("--all", "--url", "http://h"), "what others wrote"),
        (("j",), "give --connect URL of a vehicle, or --url URL"),
        (("j", "--connect", "a", "--connect", "b"), "one vehicle at a time"),
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
async def test_with_all_every_write_of_this_vehicle_is_taken_back_the_newest_first(make_service, screen):
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
    acted = await revert._all_writes(service, service.vehicles["v1"], screen, wait=1.0)
    assert service.jobs.done == [("revert", "newest"), ("revert", "middle"), ("revert", "old")]
    assert acted.good
    assert acted.text.startswith("job newest (gyro) is reverted: It is written. job middle (gyro) is reverted")
    assert [told["state"] for told in acted.document["jobs"]] == ["reverted"] * 3


async def test_a_vehicle_to_which_nothing_was_written_is_no_failure(make_service, screen):
    service = make_service()
    acted = await revert._all_writes(service, FakeVehicle(), screen, wait=1.0)
    assert (acted.good, acted.document, service.jobs.done) == (True, {"jobs": []}, [])


@pytest.mark.usefixtures("at_rest")
async def test_an_older_write_waits_for_a_newer_one_that_is_not_taken_back(make_service, screen, monkeypatch):
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
    acted = await revert._all_writes(service, service.vehicles["v1"], screen, wait=1.0)
    assert service.jobs.done == [("revert", "new")]
    assert not acted.good
    assert acted.text.endswith("job old (gyro) was not tried")


@pytest.mark.parametrize(("job", "code"), [(ended(), 0), (in_review(BLOCKED), 1), (ended(state=JobState.REVERTED), 1)])
def test_following_ends_as_the_job_does(monkeypatch, job, code):
    async def followed(_client, job_id, _screen):
        assert job_id == "j"
        return of_service(job)

    monkeypatch.setattr(follow, "followed", followed)
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
