"""Gives every answer a request id and security headers, and refuses foreign origins before any route."""

from __future__ import annotations

import asyncio
import secrets
import time

from anyio import BrokenResourceError, ClosedResourceError
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from mavcal.service.api.headers import CONSTANT, page_policy, report_policy
from mavcal.service.api.problems import internal_problem, refusal
from mavcal.service.api.security import SAFE_METHODS, RequestGuard
from mavcal.service.errors import AuthError, TooManyStreams
from mavcal.service.settings import Settings

LARGEST_REQUEST_BYTES = 2**20
"""Limit for a request; uploads have a limit of their own."""
UPLOADS = "/recordings"
LEAST_BYTES_PER_S = 1000
CLOSE = {"Connection": "close"}
"""Header of an answer after which the rest of the body is not read."""
STREAMS = ("/events", "/stream", "/samples")
"""Endings of the paths of event streams."""


class Envelope:
    """Plain ASGI middleware, so that event streams pass through unbuffered."""

    def __init__(self, app: ASGIApp, settings: Settings, guard: RequestGuard, ending: asyncio.Event) -> None:
        self._app = app
        self._guard = guard
        self._ending = ending
        self._window_s = settings.limits.body_window_s
        self._streams = 0
        self._most_streams = settings.limits.streams
        self._policy, self._reports = page_policy(settings), report_policy(settings)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        scope["request_id"] = secrets.token_hex(8)
        started = False

        async def sending(message: Message) -> None:
            nonlocal started
            started = started or message["type"] == "http.response.start"
            await send(message)

        dressed = self._dressed(scope, sending)
        try:
            self._guard.check_origin(scope["method"], Headers(scope=scope), scope["scheme"])
            if scope["method"] not in SAFE_METHODS:  # before anything of the body is read
                self._guard.authenticate(Request(scope))
        except AuthError as error:
            await refusal(Request(scope), error)(scope, receive, dressed)
            return
        stream = scope["method"] == "GET" and scope["path"].endswith(STREAMS)
        if stream and self._streams >= self._most_streams:
            await refusal(Request(scope), TooManyStreams())(scope, receive, dressed)
            return
        self._streams += stream
        receiving = _limited(scope, _steady(receive, self._window_s))
        try:
            await self._app(scope, _until(self._ending, receiving) if stream else receiving, dressed)
        except Exception as error:
            if stream and started and _reader_left(error):
                return
            if started:
                raise
            await internal_problem(Request(scope), error)(scope, receive, dressed)
        finally:
            self._streams -= stream

    def _dressed(self, scope: Scope, send: Send) -> Send:
        async def dressed(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["X-Request-ID"] = scope["request_id"]
                headers.update(CONSTANT)
                report = scope["path"].endswith(".html")
                headers["Content-Security-Policy"] = self._reports if report else self._policy
            await send(message)

        return dressed


def _reader_left(error: Exception) -> bool:
    """Whether an event stream broke because its reader left in the instant of a send.

    FastAPI closes the reader's end before it cancels the sender (fastapi, discussion 15725).
    """
    if isinstance(error, ExceptionGroup):
        return all(_reader_left(one) for one in error.exceptions)
    return isinstance(error, BrokenResourceError | ClosedResourceError)


def _until(ending: asyncio.Event, receive: Receive) -> Receive:
    """End event streams when the service stops: each sees its client disconnect."""

    async def waited() -> Message:
        message, end = asyncio.ensure_future(receive()), asyncio.ensure_future(ending.wait())
        try:
            await asyncio.wait({message, end}, return_when=asyncio.FIRST_COMPLETED)
            return message.result() if message.done() else {"type": "http.disconnect"}
        finally:
            message.cancel()
            end.cancel()

    return waited


def _steady(receive: Receive, window_s: float) -> Receive:
    """Limit how slowly a request body may arrive; slower ones end with 408."""
    complete, received, began = False, 0, time.monotonic()

    async def steady() -> Message:
        nonlocal complete, received, began
        if complete:  # from here on only the end of the connection is waited for
            return await receive()
        try:
            async with asyncio.timeout(max(0.0, began + window_s - time.monotonic())):
                message = await receive()
        except TimeoutError:
            if received < LEAST_BYTES_PER_S * window_s:
                text = f"the body brought less than {LEAST_BYTES_PER_S} bytes/s over {window_s:g} s: send it again"
                raise HTTPException(408, text, headers=CLOSE) from None
            received, began = 0, time.monotonic()
            return await steady()
        received += len(message.get("body", b""))
        complete = not message.get("more_body", False)
        return message

    return steady


def _limited(scope: Scope, receive: Receive) -> Receive:
    if scope["path"].endswith(UPLOADS):
        return receive
    received = 0

    async def limited() -> Message:
        nonlocal received
        message = await receive()
        received += len(message.get("body", b""))
        if received > LARGEST_REQUEST_BYTES:
            raise HTTPException(413, f"the request is larger than {LARGEST_REQUEST_BYTES} bytes", headers=CLOSE)
        return message

    return limited
