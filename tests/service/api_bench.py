"""The REST interface on a data directory of its own: in this process without a socket, or on a loopback port."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import httpx
import uvicorn
from starlette.types import ASGIApp

from mavcal.service.app import create_app
from mavcal.service.core import Service
from mavcal.service.http import server_config
from mavcal.service.settings import Settings
from tests.patience import scaled

Json = dict[str, Any]
ORIGIN = "http://127.0.0.1:8765"
PROBLEM = {"type", "title", "status", "detail", "request_id"}
ENDED = frozenset({"succeeded", "reverted", "failed", "cancelled", "interrupted", "in_doubt"})
UNTOLD = ("Traceback", 'File "', "/tmp", "/home", "/root", "site-packages", ".venv", "0x7f")
"""What no answer may contain: traces and absolute paths of this machine."""


@dataclass
class Api:
    """The interface as a client sees it."""

    client: httpx.AsyncClient
    service: Service
    told: list[str] = field(default_factory=list)

    async def call(self, method: str, path: str, expect: int | None = None, **request: Any) -> Any:
        """The decoded answer, after the checks that every answer has to pass."""
        response = await self.client.request(method, path, **request)
        check_answer(response, self.service.settings.data_dir)
        assert expect is None or response.status_code == expect, (response.status_code, response.text)
        return (
            response.json() if "json" in response.headers.get("content-type", "") and response.text else response.text
        )

    async def get(self, path: str, expect: int = 200, **request: Any) -> Any:
        return await self.call("GET", f"/api/v1{path}", expect, **request)

    async def post(self, path: str, body: Any = None, expect: int | None = None, **request: Any) -> Any:
        return await self.call("POST", f"/api/v1{path}", expect, json=body, **request)

    async def post_text(self, path: str, body: Any, expect: int) -> Any:
        """POST JSON as Python writes it: NaN, infinities and lone surrogates included."""
        headers = {"Content-Type": "application/json"}
        return await self.call("POST", f"/api/v1{path}", expect, content=json.dumps(body), headers=headers)

    async def delete(self, path: str, expect: int) -> Any:
        return await self.call("DELETE", f"/api/v1{path}", expect)

    async def until(self, job_id: str, *states: str, seconds: float = 30.0) -> Json:
        """The job as soon as it is in one of these states."""
        async with asyncio.timeout(scaled(seconds)):
            while (job := await self.get(f"/jobs/{job_id}"))["state"] not in states:
                assert job["state"] not in ENDED, job["outcome"]
                await asyncio.sleep(0.05)
        return dict(job)

    async def vehicle(self, seconds: float = 20.0) -> Json:
        """The first vehicle that is identified and may be written to."""
        async with asyncio.timeout(scaled(seconds)):
            while not (found := [v for v in await self.get("/vehicles") if v["uid"] and v["writable"]]):  # noqa: ASYNC110
                await asyncio.sleep(0.05)
        return dict(found[0])

    async def events(
        self, path: str, count: int, last_event_id: int | None = None, **request: Any
    ) -> list[tuple[int | None, str, Json]]:
        """The first `count` events of a stream as (id, name, data)."""
        headers = {} if last_event_id is None else {"Last-Event-ID": str(last_event_id)}
        found: list[tuple[int | None, str, Json]] = []
        block: dict[str, str] = {}
        async with (
            asyncio.timeout(scaled(15)),
            self.client.stream("GET", f"/api/v1{path}", headers=headers, **request) as response,
        ):
            assert response.status_code == 200, await response.aread()
            assert response.headers["content-type"].startswith("text/event-stream")
            async for line in response.aiter_lines():
                name, _, value = line.partition(":")
                if line:
                    block[name] = value.removeprefix(" ")
                elif "data" in block:
                    identifier = int(block["id"]) if "id" in block else None
                    found.append((identifier, block.get("event", "message"), json.loads(block["data"])))
                    block = {}
                if len(found) == count:
                    break
        return found


def check_answer(response: httpx.Response, data_dir: Path) -> None:
    """What holds for every answer, good or bad."""
    assert response.status_code != 500, response.text
    assert len(response.headers["x-request-id"]) == 16
    assert response.headers["x-content-type-options"] == "nosniff"
    if not response.headers.get("content-type", "").startswith("text/html"):
        for untold in (*UNTOLD, str(data_dir)):
            assert untold not in response.text, f"{untold!r} in {response.text[:500]}"
    if response.status_code >= 400 and "/problems/" not in response.url.path and "/readyz" not in response.url.path:
        assert response.headers["content-type"] == "application/problem+json", response.text
        problem = response.json()
        assert problem.keys() >= PROBLEM
        assert problem["status"] == response.status_code
        assert problem["request_id"] == response.headers["x-request-id"]
        assert problem["detail"]
        assert problem["title"]


def settings_in(folder: Path, **changes: Any) -> Settings:
    return Settings(data_dir=folder, **changes)


@cache
def described() -> Json:
    """The document of the application, which takes half a second to make; nobody changes it."""
    return dict(create_app(settings_in(Path("/nonexistent"))).openapi())


def kept_document() -> Json:
    """The one in the repository, which is that of the code; for what is asked before any test begins."""
    return dict(json.loads((Path(__file__).parents[2] / "docs" / "openapi.json").read_text()))


@asynccontextmanager
async def api(folder: Path, *, headers: Mapping[str, str] | None = None, **settings: Any) -> AsyncIterator[Api]:
    """The application in this process, asked without a socket."""
    app = create_app(settings_in(folder, **settings))
    async with app.router.lifespan_context(app):
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url=ORIGIN, headers=headers) as client:
            yield Api(client, app.state.service)


def behind_prefix(app: ASGIApp, prefix: str) -> ASGIApp:
    """A reverse proxy that strips a path prefix, as BlueOS and Home Assistant do, without telling the application."""

    async def proxy(scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] == "http":
            assert scope["path"].startswith(prefix), scope["path"]
            raw = scope["raw_path"].removeprefix(prefix.encode())
            scope = {**scope, "path": scope["path"].removeprefix(prefix), "raw_path": raw}
        await app(scope, receive, send)

    return proxy


@asynccontextmanager
async def served(folder: Path, *, prefix: str = "", **settings: Any) -> AsyncIterator[Api]:
    """The application on a loopback port: for event streams, which need a socket."""
    chosen = settings_in(folder, **settings)
    app = create_app(chosen)
    config = server_config(behind_prefix(app, prefix), chosen.limits, port=0)
    server = uvicorn.Server(config)
    running = asyncio.create_task(server._serve())
    try:
        async with asyncio.timeout(scaled(20)):
            while not server.started:
                assert not running.done(), running
                await asyncio.sleep(0.01)
        port = server.servers[0].sockets[0].getsockname()[1]
        async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}{prefix}", timeout=scaled(20)) as client:
            yield Api(client, app.state.service)
    finally:
        server.should_exit = True
        await running
