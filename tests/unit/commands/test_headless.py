from __future__ import annotations

import asyncio
import time

import pytest

from mavcal.service.commands import headless
from mavcal.service.commands.headless import (
    Begun,
    begun_by,
    follow,
    heard,
    is_of,
    jobs_of,
    leave_job,
    left_over,
    recovered,
    recovery_document,
    show_event,
)
from mavcal.service.errors import VehicleSilent
from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.jobs.core.model import Failure, Result
from mavcal.service.jobs.core.states import JobState
from tests.unit.commands.doubles import STEP_S, FakeVehicle, of_service, plain

URL = "udpin:0.0.0.0:14550"
DONE = Result("It is written.")
SENT = {"name": "INS_GYROFFS_X", "old": 0.0, "new": 0.5, "kind": "real32", "session": False}


def sent(service, job_id):
    """The journal of a job that has sent one parameter."""
    service.store.add_journal(job_id, 0.0, JournalStep.SEND.value, SENT)


async def test_the_vehicle_of_this_link_is_heard_and_no_other(make_service, screen):
    service = make_service()
    service.joined("tcp:elsewhere:1", "v2")
    service.joined(URL, "v1")
    vehicle = await heard(service, URL, 1.0, screen)
    assert vehicle.id == "v1"
    assert service.opened == [URL]
    assert screen.lines == []


@pytest.mark.parametrize(("reason", "said"), [("", "within 0 s: check"), ("refused", "within 0 s (refused): check")])
async def test_a_silent_link_is_named_with_its_reason(make_service, screen, reason, said):
    service = make_service()
    service.joined(URL).reason = reason
    with pytest.raises(VehicleSilent, match=URL) as raised:
        await heard(service, URL, 0.0, screen)
    assert said in str(raised.value)


async def test_a_vehicle_that_has_not_said_who_it_is_is_waited_for(make_service, screen):
    service = make_service()
    service.joined(URL, "v1")
    service.vehicles["v1"].firmware = ""
    with pytest.raises(VehicleSilent):
        await heard(service, URL, 0.0, screen)


async def test_what_is_waited_for_is_said_once_for_every_reason(make_service, screen, monkeypatch):
    monkeypatch.setattr(headless, "QUIET_S", 0.0)
    service = make_service()
    link = service.joined(URL)

    async def wait(_client, _link):
        for link.reason in ("", "refused", ""):
            for _ in range(4):
                await asyncio.sleep(0)
        return [FakeVehicle()]

    monkeypatch.setattr(headless, "on_link", wait)
    await heard(service, URL, 30.0, screen)
    assert all(" 30 s" in line and URL in line for line in screen.lines)
    assert ["(refused)" in line for line in screen.lines] == [False, True]


@pytest.mark.parametrize("end", [JobState.SUCCEEDED, JobState.FAILED, JobState.REVIEW])
async def test_a_job_is_followed_until_nothing_goes_on_by_itself(make_service, screen, end):
    job, other = plain("j", JobState.RUNNING), plain("k", JobState.RUNNING)
    service = make_service(job, other)
    service.jobs.steps = [
        (job, "prompt", {"text": "Turn it."}),
        (other, "prompt", {"text": "not of this job"}),
        (plain("k", JobState.FAILED), "state", {}),
        (job, "progress", {"current": 1.0, "target": 4.0}),
        (job, "prompt", {}),
        (job, "warning", {"text": "It is warm."}),
        (plain("j", end), "state", {}),
        (job, "prompt", {"text": "too late"}),
    ]
    assert (await follow(service, "j", screen)).state == end
    assert screen.lines == ["  > Turn it.", "    note: It is warm."]
    assert screen.shares == [0.25]


async def test_a_job_that_stays_in_doubt_is_left_after_a_while(make_service, screen):
    doubt = plain("j", JobState.IN_DOUBT)
    service = make_service(plain("j", JobState.APPLYING))
    sent(service, "j")
    service.jobs.steps = [(doubt, "state", {})]
    assert (await follow(service, "j", screen, doubt_s=0.0)).state == doubt.state
    assert screen.lines[0] == "job j (gyro) is in doubt"
    assert screen.lines[1].startswith("INS_GYROFFS_X: 0 before, 0.5 intended")


async def test_a_job_that_is_in_doubt_from_the_beginning_is_left_after_a_while_too(make_service, screen):
    doubt = plain("j", JobState.IN_DOUBT)
    assert (await follow(make_service(doubt), "j", screen, doubt_s=0.0)).state == doubt.state


async def test_a_job_that_leaves_the_doubt_is_waited_for(make_service, screen):
    service = make_service(plain("j", JobState.IN_DOUBT))
    going_on = plain("j", JobState.VERIFYING)
    service.jobs.steps = [
        (going_on, "state", {}),
        (going_on, "", {}),
        (plain("j", JobState.SUCCEEDED), "state", {}),
    ]
    assert (await follow(service, "j", screen, doubt_s=0.0)).state == JobState.SUCCEEDED


async def test_what_happened_before_is_not_shown(make_service, screen):
    job = plain("j", JobState.VERIFYING)
    service = make_service(job)
    service.jobs.steps = [
        (job, "prompt", {"text": "Turn it."}),
        (job, "warning", {"text": "It is warm."}),
        (plain("j", JobState.SUCCEEDED), "state", {}),
    ]
    assert (await follow(service, "j", screen, since=time.time() + 1.5 * STEP_S)).state == JobState.SUCCEEDED
    assert screen.lines == ["    note: It is warm."]


def test_an_event_that_nobody_reads_shows_nothing(screen):
    show_event("state", {"state": "running"}, screen)
    assert (screen.lines, screen.shares) == ([], [])


async def test_what_earlier_runs_left_on_this_vehicle_is_cancelled_or_followed(make_service, screen):
    capture = plain("a", JobState.RUNNING)
    write = plain("b", JobState.IN_DOUBT)
    foreign = plain("c", JobState.IN_DOUBT, vehicle_id="v2")
    service = make_service(capture, write, foreign, plain("d", JobState.FAILED), plain("e", JobState.REVIEW))
    service.joined(URL, "v1", "v2")
    sent(service, "b")
    left = await service.list_unfinished()
    assert [found.job.id for found in left] == ["a", "b", "c"]
    service.jobs.steps = [(plain("b", JobState.REVERTED, outcome=DONE), "state", {})]
    told = await recovered(service, service.vehicles["v1"], left, screen)
    assert [(found.job.id, found.job.state) for found in told] == [
        ("a", JobState.CANCELLED),
        ("b", JobState.REVERTED),
    ]
    assert service.jobs.done == [("cancel", "a")]
    assert screen.lines == [
        "job a (gyro) was interrupted before it wrote anything: it is cancelled",
        "    job a (gyro) is cancelled",
        "job b (gyro) was interrupted while it wrote INS_GYROFFS_X: it is finished or taken back first",
        "    job b (gyro) is reverted. It is written.",
    ]


async def test_the_recovery_begins_with_the_events_after_the_start(make_service, screen, monkeypatch):
    service = make_service(plain("b", JobState.IN_DOUBT, updated_at=17.0))  # before its last prompt
    service.joined(URL, "v1")
    heard_after = []

    async def followed(_client, _job_id, _screen, since, **_):
        heard_after.append(since)

    monkeypatch.setattr(headless, "follow", followed)
    [left] = await service.list_unfinished()
    await recovered(service, service.vehicles["v1"], [left.model_copy(update={"at": 18.0})], screen)
    assert heard_after == [18.0]


async def test_a_job_is_of_the_vehicle_that_the_service_has_under_its_id(make_service):
    service = make_service()
    service.joined(URL, "v1")
    vehicle = service.vehicles["v1"]
    service.vehicles["its-old-name"] = vehicle
    assert await is_of(service, of_service(plain("j", JobState.REVIEW)), vehicle)
    assert await is_of(service, of_service(plain("j", JobState.REVIEW, vehicle_id="its-old-name")), vehicle)
    assert not await is_of(service, of_service(plain("j", JobState.REVIEW)), FakeVehicle("v2"))
    assert not await is_of(service, of_service(plain("j", JobState.REVIEW, vehicle_id="gone")), vehicle)
    assert not await is_of(service, of_service(plain("j", JobState.REVIEW, vehicle_id=None)), vehicle)


async def test_jobs_are_listed_a_page_at_a_time(make_service, monkeypatch):
    monkeypatch.setattr(headless, "PAGE", 2)
    service, asked = make_service(), []

    async def page(*, limit, after, **wanted):
        asked.append((limit, after, wanted))
        return [of_service(plain(name, JobState.FAILED)) for name in {None: "ab", "b": "c"}[after]]

    service.list_jobs = page
    assert [job.id for job in await jobs_of(service, kind="gyro")] == ["a", "b", "c"]
    assert asked == [(2, None, {"kind": "gyro"}), (2, "b", {"kind": "gyro"})]


async def test_a_recovered_job_is_told_with_its_parameters(make_service):
    failure = Failure("in-doubt", "It fell silent", "switch it on")
    service = make_service(plain("j", JobState.IN_DOUBT, outcome=failure))
    sent(service, "j")
    told = recovery_document(await service.get_unfinished("j"))
    assert {name: told[name] for name in ("id", "kind", "vehicle_id", "state")} == {
        "id": "j",
        "kind": "gyro",
        "vehicle_id": "v1",
        "state": "in_doubt",
    }
    assert told["outcome"]["code"] == "in-doubt"
    assert [(p["name"], p["old"], p["new"]) for p in told["parameters"]] == [("INS_GYROFFS_X", 0.0, 0.5)]


@pytest.mark.parametrize("state", [JobState.QUEUED, JobState.WAITING_FOR_OPERATOR, JobState.FITTING])
async def test_a_stopped_run_cancels_what_has_written_nothing(make_service, screen, state):
    service = make_service(plain("j", state))
    await leave_job(service, screen, Begun(await service.get_job("j")))
    assert service.jobs.done == [("cancel", "j"), ("wait_for_cleanup",)]
    assert screen.lines == ["stopped: job j (gyro) was cancelled, nothing was written"]


async def test_a_stopped_run_leaves_a_plan_in_review(make_service, screen):
    service = make_service(plain("j", JobState.REVIEW))
    await leave_job(service, screen, Begun(await service.get_job("j")))
    assert service.jobs.done == [("wait_for_cleanup",)]
    assert screen.lines == ["stopped: job j (gyro) is review"]


@pytest.mark.parametrize(("wrote", "said"), [(True, "INS_GYROFFS_X may hold new values"), (False, "nothing was sent")])
async def test_a_stopped_run_says_what_a_write_leaves_behind(make_service, screen, wrote, said):
    service = make_service(plain("j", JobState.VERIFYING))
    if wrote:
        sent(service, "j")
    await leave_job(service, screen, Begun(await service.get_job("j")))
    assert service.jobs.done == [("wait_for_cleanup",)]
    assert screen.lines[0].startswith(f"stopped while job j (gyro) is verifying: {said}")
    assert screen.lines[1].startswith("`mavcal recover` finishes it")


async def test_a_shared_service_goes_on_with_a_write(make_service, screen):
    service = make_service(plain("j", JobState.VERIFYING), shared=True)
    await leave_job(service, screen, Begun(await service.get_job("j")))
    assert screen.lines[1] == "The service goes on with it: `mavcal follow j` shows what comes of it."


async def test_a_job_that_somebody_else_has_begun_is_never_cancelled(make_service, screen):
    service = make_service(plain("j", JobState.RUNNING), shared=True)
    await leave_job(service, screen, Begun(await service.get_job("j"), ours=False))
    assert service.jobs.done == [("wait_for_cleanup",)]
    assert screen.lines == ["stopped: job j (gyro) is running"]


async def test_of_a_shared_service_only_writes_that_are_in_doubt_now_are_left(make_service):
    service = make_service(
        *(plain(state.value, state) for state in (JobState.RUNNING, JobState.VERIFYING, JobState.REVERTED)), shared=True
    )
    begun = await service.list_unfinished()
    assert [found.job.id for found in begun] == ["running", "verifying"]
    service.jobs.jobs["doubt"] = plain("doubt", JobState.IN_DOUBT)  # of the run that goes on
    assert [found.job.id for found in await left_over(service)] == ["verifying", "doubt"]


async def test_a_run_that_is_stopped_while_its_job_is_made_leaves_none(make_service):
    service, left, made = make_service(plain("j", JobState.QUEUED)), [], asyncio.Event()

    async def begin():
        await made.wait()
        return Begun(await service.get_job("j"))

    async def leave(begun):
        left.append(begun.job.id)

    async def run():
        async with begun_by(begin(), leave):
            raise AssertionError

    running = asyncio.ensure_future(run())
    await asyncio.sleep(0)
    running.cancel()
    await asyncio.sleep(0)
    made.set()
    with pytest.raises(asyncio.CancelledError):
        await running
    assert left == ["j"]
