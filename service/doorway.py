"""Answers while the application is loading: the panel's page and files, and the liveness check.

Loading takes a second of a processor, and half a minute on one that is busy. Requests of the page are answered at
once; all others wait until the application can answer them itself.
"""

from __future__ import annotations

import asyncio
import secrets
from pathlib import Path

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from mavcal.service.api.headers import CONSTANT, page_policy
from mavcal.service.settings import Settings, is_loopback

LOADING = "the service is still loading"
UNCACHED = {"Cache-Control": "no-cache"}


def panel_folder() -> Path:
    """Folder of the panel's files: beside the package when installed, ``web/`` in a clone."""
    here = Path(__file__).resolve().parent
    installed = here / "_web"
    return installed if installed.is_dir() else here.parent / "web"


class Doorway:
    """An ASGI application in front of one that is still loading."""

    def __init__(self, settings: Settings) -> None:
        self._policy = page_policy(settings)
        self._anywhere = settings.beyond_loopback
        self._folder = panel_folder()
        self._files = StaticFiles(directory=self._folder)
        self._app: ASGIApp | None = None
        self._opened = asyncio.Event()

    def open(self, app: ASGIApp) -> None:
        """Let this application answer everything from now on, including waiting requests."""
        self._app = app
        self._opened.set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or have it wait."""
        if self._app is None and scope["type"] == "http" and self._ours(scope):
            await self._at_once(scope, receive, _dressed(send, self._policy))
            return
        await self._opened.wait()
        assert self._app is not None
        await self._app(scope, receive, send)

    def _ours(self, scope: Scope) -> bool:
        """Whether a request needs only files and no access check, which is the application's task."""
        host = Headers(scope=scope).get("host", "").rpartition(":")[0].strip("[]")
        known = self._anywhere or is_loopback(host)
        path = scope["path"]
        return known and scope["method"] == "GET" and (path in {"/", "/healthz", "/readyz"} or _panel(path))

    async def _at_once(self, scope: Scope, receive: Receive, send: Send) -> None:
        path = scope["path"]
        answer: Response
        if _panel(path):
            below = {**scope, "root_path": scope.get("root_path", "") + "/panel"}
            try:
                await self._files(below, receive, send)
            except HTTPException as error:
                await Response(status_code=error.status_code)(scope, receive, send)
            return
        if path == "/":
            answer = FileResponse(self._folder / "index.html", headers=UNCACHED)
        elif path == "/healthz":
            answer = JSONResponse({"status": "ok"})
        else:
            answer = JSONResponse({"status": "not ready", "reason": LOADING}, status_code=503)
        await answer(scope, receive, send)


def _panel(path: str) -> bool:
    return path.startswith("/panel/")


def _dressed(send: Send, policy: str) -> Send:
    async def dressed(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers.update({**CONSTANT, "X-Request-ID": secrets.token_hex(8), "Content-Security-Policy": policy})
        await send(message)

    return dressed
