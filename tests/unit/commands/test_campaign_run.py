from __future__ import annotations

import asyncio
from types import SimpleNamespace

import click
import pytest

from mavcal.service.campaigns.campaigns import CAMPAIGN
from mavcal.service.campaigns.items import Item, ItemOutcome, row_from_item
from mavcal.service.campaigns.vehicles import BEGUN_BY
from mavcal.service.commands import campaign_run
from mavcal.service.commands.campaign_run import VehicleWish, resumed
from mavcal.service.errors import EndpointError, JobUnknown
from mavcal.service.jobs.core.states import JobState
from tests.unit.commands.doubles import plain

A, B = "udpin:0.0.0.0:14550", "tcp:b:5760"


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Links are not listened to for further vehicles."""
    monkeypatch.setattr(campaign_run, "GATHER_S", 0.0)


async def heard(service, screen, *urls, ids=()):
    return await campaign_run._heard(service, VehicleWish(urls, ids, 0.0), screen)


async def test_every_vehicle_of_the_links_is_gone_through_and_no_other(make_service, screen):
    service = make_service()
    service.joined(A, "v1", "v2")
    service.joined("tcp:remembered:1", "v9")
    service.joined(B, "v3")
    assert await heard(service, screen, A, B, A) == ("v1", "v2", "v3")
    assert [url for url, _ in service.links.opened] == [A, B]


async def test_a_silent_endpoint_is_an_item_by_itself(make_service, screen):
    service = make_service()
    service.joined(A, "v1")
    service.joined(B)
    assert await heard(service, screen, B, A) == ("v1", B)
    [said] = screen.lines
    assert f"no vehicle was heard on {B}" in said


async def test_named_vehicles_alone(make_service, screen):
    service = make_service()
    service.joined(A, "v1", "v2")
    assert await heard(service, screen, A, ids=("v2",)) == ("v2",)


@pytest.mark.parametrize(("there", "said"), [(("v1", "v2"), "there are v1, v2"), ((), "there are none")])
async def test_a_named_vehicle_that_was_not_heard_is_wrong_use(make_service, screen, there, said):
    service = make_service()
    service.joined(A, *there)
    with pytest.raises(click.UsageError, match=f"no vehicle v7 was heard: {said}"):
        await heard(service, screen, A, ids=("v7", *there))


async def test_an_endpoint_that_is_none_ends_the_command(make_service, screen):
    service = make_service()

    async def refused(url, **_):
        raise EndpointError(f"{url} is no endpoint")

    service.links.open = refused
    with pytest.raises(EndpointError):
        await heard(service, screen, "nowhere")


class Campaigns:
    """Notes what a service is asked for its campaigns."""

    def __init__(self):
        self.asked = []

    async def resume(self, job_id):
        self.asked.append(("resume", job_id))
        return plain(job_id, JobState.RUNNING, kind=CAMPAIGN)

    async def interrupt(self, job_id):
        self.asked.append(("interrupt", job_id))


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
    service.campaigns = SimpleNamespace(campaigns=Campaigns())
    assert (await resumed("c")(service, ())).id == "c"
    assert service.campaigns.campaigns.asked == asked


async def test_a_campaign_that_there_is_not_is_an_error(make_service):
    with pytest.raises(JobUnknown):
        await resumed("c")(make_service(), ())


async def test_a_stopped_campaign_takes_its_captures_with_it_and_nothing_else(make_service):
    ours, others = {BEGUN_BY: {"id": "c", "item": 1}}, {BEGUN_BY: {"id": "d", "item": 1}}
    service = make_service(
        plain("capture", JobState.RUNNING, context=ours),
        plain("review", JobState.REVIEW, context=ours),
        plain("write", JobState.APPLYING, context=ours),
        plain("ended", JobState.SUCCEEDED, context=ours),
        plain("foreign", JobState.RUNNING, context=others),
        plain("nobody's", JobState.RUNNING, context=SimpleNamespace(get=lambda _: None)),
    )
    service.campaigns = SimpleNamespace(campaigns=Campaigns())
    await campaign_run._put_down(service, "c")
    assert service.campaigns.campaigns.asked == [("interrupt", "c")]
    assert service.jobs.done == [("cancel", "capture")]


class Ending:
    """The store of a service whose campaign has one item that is done."""

    def __init__(self, store):
        self.close = store.close

    async def do(self, read):
        return read()

    def items(self, job_id, limit):
        return [row_from_item(job_id, Item(1, "v1", outcome=ItemOutcome.DONE))]


@pytest.fixture
def run(make_service, screen, runs):
    """Runs a campaign over one vehicle; `begin` makes it."""

    async def of(begin):
        service = make_service()
        service.joined(A, "v1")
        service.campaigns, service.store = SimpleNamespace(campaigns=Campaigns()), Ending(service.store)
        runs(service)
        return service, await campaign_run._run(None, lambda *given: begin(service, *given), VehicleWish((A,)), screen)

    return of


def begun(state):
    async def begin(service, _service, chosen):
        assert chosen == ("v1",)
        service.jobs.jobs["c"] = plain("c", state, kind=CAMPAIGN)
        return service.jobs.jobs["c"]

    return begin


async def test_a_campaign_ends_with_its_items_told_and_the_old_rates_back(run, screen):
    service, code = await run(begun(JobState.SUCCEEDED))
    assert (code, service.jobs.done) == (0, [("tidied",)])
    assert screen.lines == ["campaign c", "succeeded: "]


async def stopped(_jobs, _screen):
    raise asyncio.CancelledError


@pytest.mark.usefixtures("signalled")
async def test_a_campaign_that_a_signal_stops_can_be_resumed(run, screen, monkeypatch):
    monkeypatch.setattr(campaign_run, "followed", stopped)
    service, code = await run(begun(JobState.RUNNING))
    assert code == 128 + 15
    assert service.campaigns.campaigns.asked == [("interrupt", "c")]
    assert screen.lines[-1] == "stopped: `mavcal campaign resume c` goes on with it"
    assert ("tidied",) in service.jobs.done


async def test_a_campaign_that_something_else_cancels_raises(run, monkeypatch):
    monkeypatch.setattr(campaign_run, "followed", stopped)
    with pytest.raises(asyncio.CancelledError):
        await run(begun(JobState.RUNNING))
