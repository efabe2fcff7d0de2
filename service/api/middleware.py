"""What every answer gets: a request id, security headers, and the refusal of foreign origins before any route."""

from __future__ import annotations

import secrets

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.problems import internal_problem, refusal
from service.api.security import SAFE_METHODS, Guard
from service.errors import AuthError
from service.settings import Settings

LARGEST_REQUEST_BYTES = 2**20
"""Of a request other than an upload, which has a limit of its own."""
UPLOADS = "/recordings"


class Envelope:
    """Plain ASGI middleware, so that event streams pass through unbuffered."""

    def __init__(self, app: ASGIApp, settings: Settings, guard: Guard) -> None:
        self._app = app
        self._guard = guard
        shown_by = " ".join(settings.frame_ancestors) or "'none'"
        ancestors = f"frame-ancestors {shown_by}"
        self._policy = (
            "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'self'; "
            f"{ancestors}"
        )
        self._reports = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; sandbox; {ancestors}"

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
        try:
            await self._app(scope, _limited(scope, receive), dressed)
        except Exception as error:
            if started:
                raise
            await internal_problem(Request(scope), error)(scope, receive, dressed)

    def _dressed(self, scope: Scope, send: Send) -> Send:
        async def dressed(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["X-Request-ID"] = scope["request_id"]
                headers["X-Content-Type-Options"] = "nosniff"
                headers["Referrer-Policy"] = "same-origin"
                headers["Cross-Origin-Resource-Policy"] = "same-origin"
                # Reports carry their styles with them and run nothing, whatever a recording has put into them.
                report = scope["path"].endswith(".html")
                headers["Content-Security-Policy"] = self._reports if report else self._policy
            await send(message)

        return dressed


def _limited(scope: Scope, receive: Receive) -> Receive:
    if scope["path"].endswith(UPLOADS):
        return receive
    received = 0

    async def limited() -> Message:
        nonlocal received
        message = await receive()
        received += len(message.get("body", b""))
        if received > LARGEST_REQUEST_BYTES:
            raise HTTPException(413, f"the request is larger than {LARGEST_REQUEST_BYTES} bytes")
        return message

    return limited
