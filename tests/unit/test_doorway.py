"""The page and the sign of life come at once; everything else waits for the application."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

import pytest
from starlette.responses import JSONResponse
from starlette.types import Receive, Scope, Send

from mavcal.service.api.headers import CONSTANT, page_policy
from mavcal.service.doorway import Doorway
from mavcal.service.settings import Settings


async def app(scope: Scope, receive: Receive, send: Send) -> None:
    await JSONResponse({"by": "the application"})(scope, receive, send)


async def asked(
    doorway: Doorway, path: str, *, method: str = "GET", host: str = "127.0.0.1:8765"
) -> tuple[int, Mapping[str, str], bytes]:
    """Status, headers and body of one answer."""
    said: list[Any] = []

    async def receive() -> Any:
        return await asyncio.get_running_loop().create_future()  # nobody leaves

    async def send(message: Any) -> None:
        said.append(message)

    scope = {
        "type": "http",
        "method": method,
        "path": path,
        "headers": [(b"host", host.encode())],
        "query_string": b"",
        "root_path": "",
    }
    await doorway(scope, receive, send)
    headers = {key.decode(): value.decode() for key, value in said[0]["headers"]}
    return said[0]["status"], headers, b"".join(m.get("body", b"") for m in said[1:])


@pytest.mark.parametrize(
    ("path", "status", "part"),
    [
        ("/", 200, b"<!doctype html"),
        ("/panel/index.html", 200, b"<!doctype html"),
        ("/panel/no-such-file", 404, b""),
        ("/panel/../service/app.py", 404, b""),
        ("/healthz", 200, b'{"status":"ok"}'),
        ("/readyz", 503, b"still loading"),
    ],
)
async def test_what_needs_only_files_is_answered_while_the_rest_is_loaded(path: str, status: int, part: bytes) -> None:
    doorway = Doorway(Settings())
    found, headers, body = await asked(doorway, path)
    assert (found, part.lower() in body.lower()) == (status, True)
    assert {key: headers[key.lower()] for key in CONSTANT} == dict(CONSTANT)
    assert headers["content-security-policy"] == page_policy(Settings())


@pytest.mark.parametrize(
    ("path", "method", "host"),
    [
        ("/api/v1/vehicles", "GET", "127.0.0.1"),
        ("/", "POST", "127.0.0.1:1"),
        ("/", "GET", "evil.example:8765"),  # a rebound name is the application's to refuse
        ("/panel", "GET", "127.0.0.1:1"),
        ("/info", "GET", "localhost:1"),
    ],
)
async def test_everything_else_waits_until_the_application_is_there(path: str, method: str, host: str) -> None:
    doorway = Doorway(Settings())
    waiting = asyncio.create_task(asked(doorway, path, method=method, host=host))
    for _ in range(5):
        await asyncio.sleep(0)
    assert not waiting.done()
    doorway.open(app)
    assert (await waiting)[2] == b'{"by":"the application"}'


async def test_the_application_answers_everything_once_it_is_there() -> None:
    doorway = Doorway(Settings())
    doorway.open(app)
    for path in ("/", "/healthz", "/readyz", "/panel/index.html"):
        assert (await asked(doorway, path))[2] == b'{"by":"the application"}'
