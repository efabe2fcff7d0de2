from __future__ import annotations

import asyncio

import pytest
from fastapi import HTTPException
from starlette.requests import Request

from mavcal.service.api.recordings import Body, while_connected


class Client:
    """A client that sends what the test tells it to."""

    def __init__(self):
        self.messages = asyncio.Queue()
        self.request = Request({"type": "http", "headers": []}, self.messages.get)

    def sends(self, body, *, more=False):
        self.messages.put_nowait({"type": "http.request", "body": body, "more_body": more})

    def leaves(self):
        self.messages.put_nowait({"type": "http.disconnect"})


class Work:
    """Something that takes long, and whether it was cancelled."""

    def __init__(self):
        self.release = asyncio.Event()
        self.ended = ""

    async def __call__(self):
        try:
            await self.release.wait()
        except asyncio.CancelledError:
            self.ended = "cancelled"
            raise
        self.ended = "done"
        return 7


async def settled():
    """Let whoever can go on do so."""
    for _ in range(5):
        await asyncio.sleep(0)


async def begun(client, work, body=None):
    running = asyncio.ensure_future(while_connected(client.request, work, body))
    await settled()
    return running


async def test_work_whose_client_stays_has_its_result():
    client, work = Client(), Work()
    running = await begun(client, work())
    work.release.set()
    assert (await running, work.ended) == (7, "done")
    assert asyncio.all_tasks() == {asyncio.current_task()}  # nobody waits for the client any more


async def test_work_whose_client_goes_away_is_cancelled():
    client, work = Client(), Work()
    running = await begun(client, work())
    client.sends(b"a late piece")  # which is no end
    client.leaves()
    with pytest.raises(HTTPException) as raised:
        await running
    assert (raised.value.status_code, work.ended) == (408, "cancelled")


async def test_an_error_of_the_work_is_the_error():
    async def fails():
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        await while_connected(Client().request, fails())


async def test_a_request_that_is_cancelled_takes_its_work_with_it():
    client, work = Client(), Work()
    running = await begun(client, work())
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    assert work.ended == "cancelled"


async def test_a_body_is_read_whole_before_the_client_is_watched():
    client = Client()
    body, work = Body(client.request), Work()
    read = []

    async def reading():
        read.extend([chunk async for chunk in body.chunks()])
        return await work()

    running = await begun(client, reading(), body)
    client.sends(b"one", more=True)
    await settled()
    client.sends(b"two")
    await settled()
    assert [chunk for chunk in read if chunk] == [b"one", b"two"]
    assert body.whole.is_set()
    client.leaves()
    with pytest.raises(HTTPException):
        await running
    assert work.ended == "cancelled"


async def test_a_body_that_breaks_off_is_no_body():
    client = Client()
    body = Body(client.request)
    client.sends(b"one", more=True)
    client.leaves()
    with pytest.raises(HTTPException) as raised:
        [chunk async for chunk in body.chunks()]
    assert raised.value.status_code == 408
    assert not body.whole.is_set()
