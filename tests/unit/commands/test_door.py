"""The door of live commands: the application in this process, on a loopback port, with a key of its own."""

from __future__ import annotations

import asyncio
import json
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from mavcal.client import ApiProblem, AsyncClient, Unreachable
from mavcal.client.enums import JobState
from mavcal.service.commands import door as module
from mavcal.service.commands.door import Door, door, through_door
from mavcal.service.commands.output import AnsweredNo
from mavcal.service.commands.whom import Whom
from mavcal.service.errors import AuthError, EndpointError, JobUnknown, TooManyAttempts, error_of


@pytest.fixture
def here(monkeypatch, tmp_path):
    """The application in this process, whose settings are those of a service for others."""
    theirs = [{"name": "theirs", "sha256": "0" * 64, "scopes": ["admin"]}]
    monkeypatch.setenv("MAVCAL_API_KEYS", json.dumps(theirs))
    monkeypatch.setenv("MAVCAL_HOST", "0.0.0.0")
    monkeypatch.setattr("mavcal.service.logs.configure_logging", lambda **_: None)
    return Whom(data_dir=tmp_path)


async def test_only_the_command_itself_is_answered_on_loopback(here):
    async with door(here) as at:
        assert at.own.url.startswith("http://127.0.0.1:")
        assert await at.client.list_jobs() == []
        async with AsyncClient(at.own.url, key="another") as stranger:
            with pytest.raises(ApiProblem) as refused:
                await stranger.list_jobs()
        assert refused.value.status == 401


async def test_nothing_is_left_behind(here):
    tasks = asyncio.all_tasks()
    async with door(here) as at:
        url = at.own.url
        await at.client.list_jobs()
    assert asyncio.all_tasks() == tasks
    async with AsyncClient(url) as late:
        with pytest.raises(Unreachable):
            await late.get_health()
    async with door(here) as again:  # the data directory is free
        assert await again.client.list_unfinished() == []


async def test_what_the_service_raises_is_raised_here(here):
    async with door(here) as at:
        with pytest.raises(JobUnknown, match="there is no job gone"):
            await at.client.get_job("gone")
        with pytest.raises(JobUnknown, match="there is no job gone"):
            await anext(at.client.follow_job("gone"))
        with pytest.raises(AnsweredNo) as refused:
            await at.client.start_calibration_campaign(vehicles=["v1"], kind="nose")
    assert (refused.value.code, refused.value.ends_with) == ("InvalidInputError", 2)


async def test_a_link_is_opened_for_this_run_alone(here):
    async with door(here) as at:
        link_id = await at.open("udpin:127.0.0.1:0")
        assert [link.id for link in await at.client.list_links()] == [link_id]
        with pytest.raises(EndpointError):
            await at.open("bogus")
    async with door(here) as again:
        assert await again.client.list_links() == []


async def test_steps_of_a_command_are_no_entries_of_the_audit_trail(here):
    async with door(here) as at:
        with pytest.raises(JobUnknown):
            await at.client.cancel_job("gone")
        assert (await at.client.list_audit()).rows == []


async def test_a_request_that_still_runs_ends_with_the_command(here, caplog):
    async with door(here) as at:
        following = asyncio.create_task(at.client.get_link("nothing"))
        following.cancel()
        stream = asyncio.create_task(anext(at.client.follow_events()))
        await asyncio.sleep(0.05)
        stream.cancel()
    assert not caplog.records


async def test_a_vehicle_that_does_not_confirm_its_rates_is_not_waited_for_longer():
    async def never():
        await asyncio.Event().wait()

    await Door(SimpleNamespace(), SimpleNamespace(wait_for_cleanup=never)).wait_for_cleanup(0.0)


def test_an_error_is_told_in_the_words_that_came():
    error = error_of("too-many-attempts", "wait 3 s")
    assert isinstance(error, TooManyAttempts)
    assert str(error) == "wait 3 s"
    assert error_of("unheard-of", "x") is None


async def test_a_service_elsewhere_is_asked_and_goes_on(here):
    async with door(here) as own, door(Whom(url=own.own.url)) as stranger:
        assert (own.shared, stranger.shared) == (False, True)
        with pytest.raises(AuthError):
            await stranger.client.list_jobs()
        assert await own.client.list_jobs() == []


async def test_a_service_that_is_not_there_is_the_answer_no():
    with pytest.raises(AnsweredNo, match="is `mavcal serve` running") as raised:
        async with door(Whom(url="http://127.0.0.1:1")) as at:
            await at.client.list_jobs()
    assert raised.value.code == "unreachable"


async def test_a_service_elsewhere_is_waited_for_until_it_has_looked_at_what_it_wrote(monkeypatch):
    monkeypatch.setattr(module, "_LOOK_S", 0.0)
    wrote = {"state": JobState.SUCCEEDED, "last_write": "written"}
    jobs = [SimpleNamespace(**wrote, readiness=seen) for seen in (None, None, "it would arm")]

    async def get_job(_job_id):
        return jobs.pop(0)

    await Door(SimpleNamespace(get_job=get_job)).wait_for_cleanup(written="j")
    assert jobs == []
    jobs += [SimpleNamespace(state=JobState.REVERTED, last_write="written", readiness=None)]
    await Door(SimpleNamespace(get_job=get_job)).wait_for_cleanup(written="j")
    await Door(SimpleNamespace()).wait_for_cleanup()  # nothing is waited for where nothing was written


@pytest.fixture
def caught(monkeypatch, runs):
    """The signals that a run is said to have got."""
    signals = []

    @contextmanager
    def stoppable():
        yield signals

    monkeypatch.setattr(module, "stoppable", stoppable)
    runs(SimpleNamespace())
    return signals


def test_a_run_that_a_signal_ended_has_its_exit_code_and_one_that_something_else_cancelled_raises(caught):
    async def cancelled(_door):
        raise asyncio.CancelledError

    with pytest.raises(asyncio.CancelledError):
        through_door(Whom(), cancelled)
    caught.append(15)
    assert through_door(Whom(), cancelled) == 128 + 15
