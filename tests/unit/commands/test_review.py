from __future__ import annotations

import asyncio
import json
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest

from mavcal.calib.firmware.options import to_confirm
from mavcal.calib.firmware.plan import Change, LeftOut, Loss, ParameterKind, WritePlan
from mavcal.calib.recording import Sensor
from mavcal.service.commands import door, keyboard, review
from mavcal.service.commands.headless import Begun, answering
from mavcal.service.commands.keyboard import Keyboard
from mavcal.service.commands.review import JobWish, exit_code, good, run_job, show_end, show_plan, taken_back, writable
from mavcal.service.commands.whom import Whom
from mavcal.service.errors import AnswerRefused, PhysicalJobRunning
from mavcal.service.jobs.core.model import Attempt, Failure, Result, WriteResult
from mavcal.service.jobs.core.proof import ProofLevel, Unproved
from mavcal.service.jobs.core.states import JobState
from tests.unit.api.samples import FINGERPRINT
from tests.unit.commands.doubles import FakeVehicle, of_service, plain

WHOM = Whom(("tcp:v:1",))
CHANGE = Change("CAL_GYRO0_XOFF", None, 0.25, ParameterKind.REAL32, "offset", sd=0.0125, unit="rad/s")
PLAN = WritePlan(FINGERPRINT, "0" * 64, (CHANGE,))
EMPTY = WritePlan(FINGERPRINT, "0" * 64, ())
TO_CONFIRM = f"The compass is mounted otherwise. {to_confirm('confirm_mounting')}"
ASKING = replace(PLAN, blockers=(TO_CONFIRM,))
BLOCKED = replace(PLAN, blockers=("The offset is too large.",))
LEFT = (LeftOut(Sensor.GYRO, 1, "it does not stream"),)
WROTE = Attempt(WriteResult.SUCCEEDED, 1.0)
FULL, HALF = Result("It is written.", ProofLevel.FULL), Result("It is written.", ProofLevel.PARTIAL)


def wished(write, **more):
    return JobWish(write, **more)


def review_of(plan, **more):
    return plain("j", JobState.REVIEW, plan=plan, **more)


def succeeded(**more):
    return plain("j", JobState.SUCCEEDED, **more)


@pytest.mark.parametrize(
    ("job", "write", "require_proof", "reached"),
    [
        (review_of(PLAN), False, False, True),
        (review_of(BLOCKED), False, False, False),
        (review_of(PLAN), True, False, False),  # it was to be written
        (plain("j", JobState.FAILED), False, False, False),
        (succeeded(plan=EMPTY), False, False, True),  # nothing had to be changed
        (succeeded(plan=PLAN, outcome=HALF), True, False, True),
        (succeeded(plan=PLAN, outcome=HALF), True, True, False),
        (succeeded(plan=PLAN, outcome=FULL), True, True, True),
        (succeeded(plan=EMPTY, outcome=HALF), True, True, True),
        (succeeded(plan=None, outcome=HALF), True, True, False),
        (plain("j", JobState.REVERTED, plan=PLAN, outcome=FULL), True, False, False),
    ],
)
def test_a_job_is_good_if_it_reached_what_was_asked_for(job, write, require_proof, reached):
    assert good(of_service(job), write, require_proof) is reached


def test_only_a_reverted_job_is_taken_back():
    assert [state for state in JobState if taken_back(of_service(plain("j", state)))] == [JobState.REVERTED]


def test_a_plan_shows_what_is_written_and_what_cannot_be_held(screen):
    loss = Loss(Sensor.MAG, 1, "rotation", 2.5, "deg", "The compass cannot be turned.")
    old = replace(CHANGE, name="CAL_MAG0_ROT", old=4, new=6, kind=ParameterKind.INT32, sd=None, unit="")
    show_plan(told(replace(PLAN, changes=(CHANGE, old), losses=(loss,), blockers=("It is armed.",))), screen)
    blocked, unlisted, changed, lost = screen.lines
    assert "not be" in blocked
    assert blocked.endswith(" armed.")
    assert unlisted.split() == ["CAL_GYRO0_XOFF", "-", "->", "0.25", "+-", "0.013", "rad/s"]
    assert changed.split() == ["CAL_MAG0_ROT", "4", "->", "6"]
    assert loss.text in lost
    assert "(2.5 deg)" in lost


def test_what_a_person_can_confirm_is_no_end(screen):
    show_plan(told(ASKING), screen)
    assert "confirmed:" in screen.lines[0]
    assert screen.lines[0].endswith(TO_CONFIRM)


def test_the_end_of_a_write_says_what_is_not_proved(screen):
    outcome = replace(HALF, unproved=(Unproved("CAL_GYRO0_XOFF", "consistent", "turn it"),))
    show_end(of_service(succeeded(outcome=outcome)), screen, written=True)
    end, proof, unproved = screen.lines
    assert end == f"succeeded: {outcome.text}"
    assert proof.split() == ["proof:", "partial"]
    assert "CAL_GYRO0_XOFF" in unproved
    assert unproved.endswith("turn it")


def test_the_end_of_a_write_names_the_job_that_can_be_taken_back_and_what_is_left_out(screen):
    plan = replace(PLAN, left_out=(LeftOut(Sensor.GYRO, 1, "it is frozen"),))
    missed = (LeftOut(Sensor.GYRO, 2, "it does not stream"), LeftOut(Sensor.MAG, 2, "it is frozen"))
    show_end(of_service(succeeded(plan=plan, missed=missed, outcome=FULL, last_write=WROTE)), screen, written=True)
    frozen, silent, helper, back = screen.lines[2:6]
    assert frozen.startswith("left out: ")
    assert "gyro 2:" in frozen
    assert silent.startswith("left out: ")
    assert "gyro 3:" in silent
    assert not helper.startswith("left out")
    assert "compass 3:" in helper
    assert "revert j`" in back


@pytest.mark.parametrize(
    ("job", "wish", "code"),
    [
        (succeeded(plan=PLAN, outcome=FULL), wished(write=True, require_proof=True), 0),
        (succeeded(plan=PLAN, outcome=HALF), wished(write=True), 0),
        (succeeded(plan=PLAN, outcome=HALF), wished(write=True, require_proof=True), 3),
        (succeeded(plan=PLAN, outcome=Result("x")), wished(write=True, require_proof=True), 1),
        (succeeded(plan=PLAN, missed=LEFT, outcome=FULL), wished(write=True), 3),
        (review_of(replace(PLAN, left_out=LEFT)), wished(write=False), 3),
        (review_of(replace(BLOCKED, left_out=LEFT)), wished(write=False), 1),
        (plain("j", JobState.REVERTED, plan=PLAN, missed=LEFT, outcome=FULL), wished(write=True), 1),
        (plain("j", JobState.REVERTED, plan=PLAN, missed=LEFT), wished(write=True, revert=True), 0),
    ],
)
def test_what_is_done_in_part_has_an_exit_code_of_its_own(job, wish, code):
    assert exit_code(of_service(job), wish) == code


def test_the_end_of_a_job_that_wrote_nothing_speaks_of_no_proof(screen):
    show_end(of_service(succeeded(outcome=HALF)), screen, written=False)
    assert screen.lines == [f"succeeded: {HALF.text}"]


def test_the_end_of_a_failure_is_cause_and_remedy(screen):
    show_end(of_service(plain("j", JobState.FAILED, outcome=Failure("x", "It moved", "hold it"))), screen, written=True)
    (line,) = screen.lines
    assert line.startswith("failed: ")
    assert "It moved." in line
    assert line.endswith("Hold it.")


async def test_a_write_waits_until_the_vehicle_may_be_written_to(make_service, monkeypatch):
    looked = []

    async def sleep(seconds):
        looked.append(seconds)

    monkeypatch.setattr(review.asyncio, "sleep", sleep)
    service = make_service()
    vehicle = service.vehicles["v1"] = FakeVehicle(refusals=3)
    await writable(service, vehicle, 30.0)
    assert len(looked) == 3


async def test_a_write_does_not_wait_for_ever(make_service):
    service = make_service()
    vehicle = service.vehicles["v1"] = FakeVehicle(refusals=1_000_000)
    await writable(service, vehicle, 0.0)


class Typist:
    """A keyboard with somebody at it who types these lines when asked."""

    def __init__(self, monkeypatch, *lines, there=True):
        self.lines = list(lines)
        self.answer = None

        @asynccontextmanager
        async def opened(answer):
            self.answer = answer
            typed = Keyboard(there=there)
            typed.asked = self.asked
            yield typed

        monkeypatch.setattr(keyboard, "keyboard", opened)

    async def asked(self):
        return self.lines.pop(0)


@pytest.fixture
def run(make_service, screen, monkeypatch):
    """Runs a job of a vehicle that is there, as `wish` says; the steps happen once it is followed."""

    async def of(job, wish, *steps, planned=None):
        service = make_service(job)
        service.joined("tcp:v:1", "v1")
        service.jobs.steps, service.jobs.planned = list(steps), planned
        vehicle = service.vehicles["v1"]

        async def begin(_client, _vehicle):
            return Begun(of_service(job))

        ended = await review._Run(service, vehicle, wish, screen).of(begin, ())
        return ended, service.jobs.done[:-1]  # the last thing is always to wait for the old rates

    return of


def told(plan):
    """The plan as a client gets it."""
    return of_service(review_of(plan)).plan


def written(plan=PLAN):
    return succeeded(plan=plan, outcome=FULL), "state", {}


async def test_without_apply_the_plan_is_shown_and_kept(run, screen, monkeypatch):
    Typist(monkeypatch)
    job, done = await run(plain("j", JobState.RUNNING), wished(write=False), (review_of(PLAN), "state", {}))
    assert (job.state, done) == (JobState.REVIEW, [])
    assert screen.lines[-1].endswith("`mavcal accept j` writes it")


async def test_with_apply_the_plan_that_was_shown_is_written(run, monkeypatch):
    Typist(monkeypatch)
    job, done = await run(review_of(PLAN), wished(write=True, reboot=True), written())
    assert job.state == JobState.SUCCEEDED
    assert done == [("apply", "j", PLAN.sha256, {"reboot": True})]


async def test_a_blocked_plan_is_not_written(run, monkeypatch):
    Typist(monkeypatch)
    job, done = await run(review_of(BLOCKED), wished(write=True))
    assert (job.state, done) == (JobState.REVIEW, [])


async def test_a_job_without_a_plan_is_not_written(run, monkeypatch):
    Typist(monkeypatch)
    failed = plain("j", JobState.FAILED, outcome=Failure("x", "It moved", "hold it"))
    _, done = await run(plain("j", JobState.RUNNING), wished(write=True), (failed, "state", {}))
    assert done == []


@pytest.mark.parametrize("line", ["yes", "Y"])
async def test_a_person_confirms_and_the_plan_is_made_again(run, monkeypatch, line):
    Typist(monkeypatch, line)
    job = review_of(ASKING, context={"plan_options": {"only": ["mag0"]}})
    _, done = await run(job, wished(write=True), written(), planned=review_of(PLAN))
    assert done == [
        ("plan_again", "j", {"only": ["mag0"], "confirm_mounting": True}),
        ("apply", "j", PLAN.sha256, {"reboot": False}),
    ]


async def test_a_plan_that_stays_blocked_after_the_confirmation_is_not_written(run, monkeypatch):
    Typist(monkeypatch, "yes")
    _, done = await run(review_of(ASKING), wished(write=True), planned=review_of(BLOCKED))
    assert [what for what, *_ in done] == ["plan_again"]


@pytest.mark.parametrize(("line", "there"), [("no", True), ("", True), ("yes", False)])
async def test_nothing_is_written_that_nobody_confirms(run, monkeypatch, line, there):
    typist = Typist(monkeypatch, line, there=there)
    _, done = await run(review_of(ASKING), wished(write=True))
    assert done == []
    assert typist.lines == ([] if there else [line])  # a script is not asked


async def test_nobody_is_asked_to_confirm_what_is_not_to_be_written(run, monkeypatch):
    typist = Typist(monkeypatch, "yes")
    await run(review_of(ASKING), wished(write=False))
    assert typist.lines == ["yes"]


async def test_a_line_answers_the_job_and_a_refusal_is_shown(make_service, screen):
    service = make_service()
    answer = answering(service, "j", screen)
    await answer("finish")
    service.jobs.refusal = AnswerRefused("type a number")
    await answer("finish")
    assert service.jobs.done == [("answer", "j", "finish")]
    assert screen.lines == ["    type a number"]


async def test_the_job_is_told_as_json_with_what_was_recovered(run, monkeypatch, capsys):
    Typist(monkeypatch)
    await run(review_of(PLAN), wished(write=False, as_json=True))
    told = json.loads(capsys.readouterr().out)
    assert (told["id"], told["state"], told["recovered"]) == ("j", "review", [])


async def test_a_run_that_is_stopped_puts_its_job_down(run, screen, monkeypatch):
    Typist(monkeypatch)
    running = asyncio.ensure_future(run(plain("j", JobState.RUNNING), wished(write=False)))
    for _ in range(5):
        await asyncio.sleep(0)
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    assert screen.lines == ["stopped: job j (gyro) was cancelled, nothing was written"]


async def test_nothing_new_begins_while_an_earlier_job_is_in_doubt(make_service):
    service = make_service(plain("a", JobState.IN_DOUBT), plain("b", JobState.REVERTED))
    doubt, ended = [await service.get_unfinished(name) for name in ("a", "b")]
    review._require_resolved([ended])
    with pytest.raises(PhysicalJobRunning, match=r"job a \(gyro\) is in doubt.*Nothing new is begun"):
        review._require_resolved([ended, doubt])


@pytest.mark.parametrize(
    ("came", "wish", "code"),
    [
        (succeeded(plan=PLAN, outcome=FULL), wished(write=True, require_proof=True), 0),
        (succeeded(plan=PLAN, outcome=HALF), wished(write=True, require_proof=True), 3),
        (plain("j", JobState.REVERTED), wished(write=True, revert=True), 0),
        (succeeded(plan=PLAN, outcome=FULL), wished(write=True, revert=True), 1),
        (130, wished(write=True), 130),
    ],
)
def test_the_exit_code_is_that_of_what_was_asked_for(monkeypatch, came, wish, code):
    monkeypatch.setattr(door, "through_door", lambda *_: came if isinstance(came, int) else of_service(came))
    assert run_job(WHOM, None, wish) == code


async def test_a_job_begins_once_the_vehicle_is_heard_and_nothing_is_in_doubt(make_service, screen, monkeypatch):
    Typist(monkeypatch)
    service = make_service(plain("old", JobState.QUEUED))
    service.joined("tcp:v:1", "v1")

    async def begin(_service, vehicle):
        assert (vehicle.id, service.jobs.done) == ("v1", [("cancel", "old")])
        service.jobs.jobs["j"] = review_of(PLAN)
        return Begun(await service.get_job("j"))

    job = await review._job(service, whom=WHOM, begin=begin, wish=wished(write=False), screen=screen)
    assert (job.id, job.state) == ("j", JobState.REVIEW)
    assert screen.lines[0] == "px4 1.17.0 as v1"


async def test_a_job_that_waits_in_review_without_a_plan_is_left(run, monkeypatch):
    Typist(monkeypatch)
    _, done = await run(plain("j", JobState.REVIEW), wished(write=True))
    assert done == []
