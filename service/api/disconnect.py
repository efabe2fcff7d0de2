"""Cancels the work of a request whose client has disconnected."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Coroutine
from typing import Any, TypeVar

from fastapi import HTTPException, Request
from starlette.requests import ClientDisconnect

T = TypeVar("T")


class Body:
    """The request's body in chunks; `whole` is set when all of it is there."""

    def __init__(self, request: Request) -> None:
        self._request = request
        self.whole = asyncio.Event()

    async def chunks(self) -> AsyncIterator[bytes]:
        """The body. Raises HTTPException 408 if the client goes away."""
        try:
            async for chunk in self._request.stream():
                yield chunk
        except ClientDisconnect:
            raise _left() from None
        self.whole.set()


async def while_connected(request: Request, work: Coroutine[Any, Any, T], body: Body | None = None) -> T:
    """The result of `work`, which is cancelled when the client goes away.

    Parameters
    ----------
    request
        Whose client is watched.
    work
        What takes long.
    body
        The body, if `work` reads it; None: it has been read.

    Raises
    ------
    HTTPException
        408, which nobody reads, if the client went away.
    """
    working = asyncio.ensure_future(work)
    gone = asyncio.ensure_future(_gone(request, body))
    try:
        await asyncio.wait({working, gone}, return_when=asyncio.FIRST_COMPLETED)
        if not working.done():
            raise _left()
        return working.result()
    finally:
        for task in (working, gone):
            task.cancel()
        await asyncio.gather(working, gone, return_exceptions=True)


async def _gone(request: Request, body: Body | None) -> None:
    if body is not None:
        await body.whole.wait()
    while (await request.receive())["type"] != "http.disconnect":
        pass


def _left() -> HTTPException:
    return HTTPException(408, "the client went away")
