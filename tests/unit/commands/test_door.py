"""The door of live commands: the application in this process, on a loopback port, with a key of its own."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from mavcal.client import ApiProblem, AsyncClient, Unreachable
from mavcal.service.commands.door import Door, door
from mavcal.service.commands.output import AnsweredNo
from mavcal.service.errors import EndpointError, JobUnknown, TooManyAttempts
from mavcal.service.errors.base import error_of
from mavcal.service.settings import ApiKey, Settings


@pytest.fixture
def settings(tmp_path):
    theirs = ApiKey(name="theirs", sha256="0" * 64, scopes=frozenset({"admin"}))
    return Settings(data_dir=tmp_path, api_keys=(theirs,), host="0.0.0.0", connect=())


async def test_only_the_command_itself_is_answered_on_loopback(settings):
    async with door(settings) as at:
        assert at.own.url.startswith("http://127.0.0.1:")
        assert await at.client.list_jobs() == []
        async with AsyncClient(at.own.url, key="another") as stranger:
            with pytest.raises(ApiProblem) as refused:
                await stranger.list_jobs()
        assert refused.value.status == 401


async def test_nothing_is_left_behind(settings):
    tasks = asyncio.all_tasks()
    async with door(settings) as at:
        url = at.own.url
        await at.client.list_jobs()
    assert asyncio.all_tasks() == tasks
    async with AsyncClient(url) as late:
        with pytest.raises(Unreachable):
            await late.get_health()
    async with door(settings) as again:  # the data directory is free
        assert await again.client.list_unfinished() == []


async def test_what_the_service_raises_is_raised_here(settings):
    async with door(settings) as at:
        with pytest.raises(JobUnknown, match="there is no job gone"):
            await at.client.get_job("gone")
        with pytest.raises(JobUnknown, match="there is no job gone"):
            await anext(at.client.follow_job("gone"))
        with pytest.raises(AnsweredNo) as refused:
            await at.client.start_calibration_campaign(vehicles=["v1"], kind="nose")
    assert (refused.value.code, refused.value.ends_with) == ("InvalidInputError", 2)


async def test_a_link_is_opened_for_this_run_alone(settings):
    async with door(settings) as at:
        link_id = await at.open("udpin:127.0.0.1:0")
        assert [link.id for link in await at.client.list_links()] == [link_id]
        with pytest.raises(EndpointError):
            await at.open("bogus")
    async with door(settings) as again:
        assert await again.client.list_links() == []


async def test_steps_of_a_command_are_no_entries_of_the_audit_trail(settings):
    async with door(settings) as at:
        with pytest.raises(JobUnknown):
            await at.client.cancel_job("gone")
        assert (await at.client.list_audit()).rows == []


async def test_a_request_that_still_runs_ends_with_the_command(settings, caplog):
    async with door(settings) as at:
        following = asyncio.create_task(at.client.get_link("nothing"))
        following.cancel()
        stream = asyncio.create_task(anext(at.client.follow_events()))
        await asyncio.sleep(0.05)
        stream.cancel()
    assert not caplog.records


async def test_a_vehicle_that_does_not_confirm_its_rates_is_not_waited_for_longer():
    async def never():
        await asyncio.Event().wait()

    await Door(SimpleNamespace(), SimpleNamespace(tidied=never)).tidied(0.0)


def test_an_error_is_told_in_the_words_that_came():
    error = error_of("too-many-attempts", "wait 3 s")
    assert isinstance(error, TooManyAttempts)
    assert str(error) == "wait 3 s"
    assert error_of("unheard-of", "x") is None
