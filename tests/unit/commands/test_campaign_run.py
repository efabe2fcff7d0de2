from __future__ import annotations

import asyncio

import click
import pytest

from mavcal.client.models import ItemModel
from mavcal.service.api.views import item_model
from mavcal.service.campaigns.campaigns import CAMPAIGN
from mavcal.service.campaigns.items import Item, ItemOutcome
from mavcal.service.commands import campaign_items, campaign_run
from mavcal.service.commands.campaign_output import OutputOptions
from mavcal.service.commands.campaign_run import resumed
from mavcal.service.commands.headless import Begun
from mavcal.service.commands.whom import Whom
from mavcal.service.errors import EndpointError, JobUnknown
from mavcal.service.jobs.core.states import JobState
from tests.unit.commands.doubles import of_service, plain

A, B = "udpin:0.0.0.0:14550", "tcp:b:5760"


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Links are not listened to for further vehicles."""
    monkeypatch.setattr(campaign_run, "GATHER_S", 0.0)


async def heard(service, screen, *urls, ids=()):
    return await campaign_run._heard(service, Whom(urls, ids=ids, wait_s=0.0), screen)


async def test_every_vehicle_of_the_links_is_gone_through_and_no_other(make_service, screen):
    service = make_service()
    service.joined(A, "v1", "v2")
    service.joined("tcp:remembered:1", "v9")
    service.joined(B, "v3")
    assert await heard(service, screen, A, B, A) == ["v1", "v2", "v3"]
    assert service.opened == [A, B]


async def test_a_silent_endpoint_is_an_item_by_itself(make_service, screen):
    service = make_service()
    service.joined(A, "v1")
    service.joined(B)
    assert await heard(service, screen, B, A) == ["v1", B]
    [said] = screen.lines
    assert f"no vehicle was heard on {B}" in said


async def test_named_vehicles_alone(make_service, screen):
    service = make_service()
    service.joined(A, "v1", "v2")
    assert await heard(service, screen, A, ids=("v2",)) == ["v2"]


@pytest.mark.parametrize(("there", "said"), [(("v1", "v2"), "there are v1, v2"), ((), "there are none")])
async def test_a_named_vehicle_that_was_not_heard_is_wrong_use(make_service, screen, there, said):
    service = make_service()
    service.joined(A, *there)
    with pytest.raises(click.UsageError, match=f"no vehicle v7 was heard: {said}"):
        await heard(service, screen, A, ids=("v7", *there))


async def test_an_endpoint_that_is_none_ends_the_command(make_service, screen):
    service = make_service()

    async def refused(url):
        raise EndpointError(f"{url} is no endpoint")

    service.open = refused
    with pytest.raises(EndpointError):
        await heard(service, screen, "nowhere")


def noting(service, *items):
    """Such a service, and what is asked of its campaigns; these are their items."""
    asked = []

    async def resume(job_id):
        asked.append(("resume", job_id))
        return of_service(plain(job_id, JobState.RUNNING, kind=CAMPAIGN))

    async def interrupt(job_id):
        asked.append(("interrupt", job_id))

    async def listed(_job_id, *, outcome, after, limit):
        assert (outcome, limit) == (None, campaign_items.PAGE)
        return [] if after else [item_of(*item) for item in items]

    service.resume_campaign, service.interrupt_campaign, service.list_items = resume, interrupt, listed
    return asked


def item_of(item, job=None):
    """An item as a client gets it."""
    return ItemModel.model_validate(item_model(item, "c", job).model_dump(mode="json"))


@pytest.mark.parametrize(
    ("job", "asked"),
    [
        (plain("c", JobState.RUNNING, kind=CAMPAIGN), []),  # the service goes on with it by itself
        (plain("c", JobState.INTERRUPTED, kind=CAMPAIGN), [("resume", "c")]),
        (plain("c", JobState.RUNNING, kind="gyro"), [("resume", "c")]),  # which is refused there
    ],
)
async def test_a_stopped_campaign_is_resumed_and_a_running_one_followed(make_service, job, asked):
    service = make_service(job)
    noted = noting(service)
    assert (await resumed("c")(service, [])).job.id == "c"
    assert noted == asked


async def test_a_campaign_that_there_is_not_is_an_error(make_service):
    with pytest.raises(JobUnknown):
        await resumed("c")(make_service(), [])


async def test_a_stopped_campaign_takes_its_captures_with_it_and_nothing_else(make_service, screen):
    capture, review, write, ended = (
        plain(name, state)
        for name, state in [
            ("capture", JobState.RUNNING),
            ("review", JobState.REVIEW),
            ("write", JobState.APPLYING),
            ("ended", JobState.SUCCEEDED),
        ]
    )
    service = make_service(capture, review, write, ended, plain("foreign", JobState.RUNNING))
    going_on = [(Item(n, "v1", job_id=job.id), job) for n, job in enumerate((capture, review, write, ended), 1)]
    noted = noting(service, *going_on, (Item(9, "v9"),))
    service.jobs.jobs["c"] = plain("c", JobState.RUNNING, kind=CAMPAIGN)
    await campaign_run._leave_campaign(service, screen, Begun(await service.get_job("c")))
    assert noted == [("interrupt", "c")]
    assert service.jobs.done == [("cancel", "capture"), ("wait_for_cleanup",)]


async def test_a_campaign_that_a_shared_service_goes_on_with_is_left_alone(make_service, screen):
    service = make_service(plain("c", JobState.RUNNING, kind=CAMPAIGN), shared=True)
    noted = noting(service)
    begun = await resumed("c")(service, [])
    await campaign_run._leave_campaign(service, screen, begun)
    assert (noted, screen.lines) == ([], ["stopped: the service goes on with campaign c"])


@pytest.fixture
def run(make_service, screen):
    """Runs a campaign over one vehicle; `begin` makes it."""

    async def of(begin):
        service = make_service()
        service.joined(A, "v1")
        service.noted = noting(service, (Item(1, "v1", outcome=ItemOutcome.DONE),))
        how = {"whom": Whom((A,)), "begin": lambda *given: begin(service, *given), "output": OutputOptions()}
        return service, await campaign_run._run(service, **how, screen=screen)

    return of


def begun(state):
    async def begin(service, _client, chosen):
        assert chosen == ["v1"]
        service.jobs.jobs["c"] = plain("c", state, kind=CAMPAIGN)
        return Begun(await service.get_job("c"))

    return begin


async def test_a_campaign_ends_with_its_items_told_and_the_old_rates_back(run, screen):
    service, code = await run(begun(JobState.SUCCEEDED))
    assert (code, service.jobs.done) == (0, [("wait_for_cleanup",)])
    assert screen.lines == ["campaign c", "succeeded: "]


async def stopped(_jobs, _screen):
    raise asyncio.CancelledError


async def test_a_campaign_that_is_stopped_can_be_resumed(run, screen, monkeypatch):
    monkeypatch.setattr(campaign_run, "followed", stopped)
    made = []

    async def begin(service, *given):
        made.append(service)
        return await begun(JobState.RUNNING)(service, *given)

    with pytest.raises(asyncio.CancelledError):
        await run(begin)
    [service] = made
    assert service.noted == [("interrupt", "c")]
    assert screen.lines[-1] == "stopped: `mavcal campaign resume c` goes on with it"
    assert ("wait_for_cleanup",) in service.jobs.done
