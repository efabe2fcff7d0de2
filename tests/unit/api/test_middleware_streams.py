from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest
from anyio import BrokenResourceError
from fastapi import FastAPI
from fastapi.sse import EventSourceResponse, ServerSentEvent
from starlette.types import ASGIApp, Receive, Scope, Send

from mavcal.service.api.middleware import Envelope
from mavcal.service.api.security import RequestGuard
from mavcal.service.settings import Settings

SENT = 3
"""Events that a reader takes before it leaves."""


SCOPE = {
    "type": "http",
    "method": "GET",
    "path": "/events",
    "scheme": "http",
    "query_string": b"",
    "headers": [(b"host", b"localhost:8765")],
}


def enveloped(app: ASGIApp) -> Envelope:
    settings = Settings()
    return Envelope(app, settings, RequestGuard(settings), asyncio.Event())


async def followed(*, broken: Exception | None = None) -> int:
    """Read an endless event stream that is faster than its reader, who then leaves; returns the events sent."""
    app, left = FastAPI(), asyncio.Event()

    @app.get("/events", response_class=EventSourceResponse)
    async def events() -> AsyncIterator[ServerSentEvent]:
        for k in range(1_000_000):
            if broken is not None and k == SENT:
                raise broken
            yield ServerSentEvent(data=k)

    sent = 0

    async def receive() -> dict[str, Any]:
        await left.wait()
        return {"type": "http.disconnect"}

    async def send(message: Any) -> None:
        nonlocal sent
        sent += bool(message.get("body"))
        if sent == SENT:
            left.set()
            await asyncio.Event().wait()  # the reader's window is full: only its leaving ends this

    await enveloped(app)(SCOPE, receive, send)
    return sent


async def test_a_reader_who_leaves_in_the_instant_of_a_send_is_no_error():
    assert await followed() == SENT


async def test_an_error_of_the_stream_itself_is_raised():
    with pytest.raises(ExceptionGroup) as raised:
        await followed(broken=ZeroDivisionError())
    assert raised.group_contains(ZeroDivisionError)


async def test_an_error_beside_the_readers_leaving_is_raised():
    async def broken(_scope: Scope, _receive: Receive, send: Send) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})
        raise ExceptionGroup("both", [BrokenResourceError(), ValueError("ours")])

    async def silent(*_: object) -> Any:
        pass

    with pytest.raises(ExceptionGroup) as raised:
        await enveloped(broken)(SCOPE, silent, silent)
    assert raised.group_contains(ValueError)
