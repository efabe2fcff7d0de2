"""The application inside the process of a command: on a loopback port, with a key of its own, while it runs."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

from fastapi import FastAPI, Request
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.server import ServerState

from mavcal.calib.errors import CalibError
from mavcal.service import core
from mavcal.service.api.problems import ProblemResponse, problem
from mavcal.service.api.security import digest
from mavcal.service.app import create_app
from mavcal.service.core import Service
from mavcal.service.http import server_config
from mavcal.service.settings import ApiKey, Settings

HOST = "127.0.0.1"


@dataclass(frozen=True)
class Hosted:
    """A service of this process, and how it is asked."""

    url: str
    key: str
    service: Service

    async def open(self, endpoint: str) -> str:
        """The id of a link that is not remembered. Raises EndpointError, PortBusy."""
        return (await self.service.links.open(endpoint, remember=False, trusted=True)).id

    async def tidied(self) -> None:
        """Wait until nothing is owed to a vehicle: its old message rates, and a look at it after a write."""
        await self.service.jobs.tidied()


@asynccontextmanager
async def hosted(settings: Settings, actor: str) -> AsyncIterator[Hosted]:
    """A service with these settings that answers the holder of its key alone, who is called `actor` in what is kept.

    Raises
    ------
    DataDirLocked, EndpointError, PortBusy
        As :func:`service.core.running_service`.
    """
    key = secrets.token_urlsafe(32)
    ours = ApiKey(name=actor, sha256=digest(key), scopes=frozenset({"admin"}))
    settings = settings.model_copy(update={"host": HOST, "port": 0, "api_keys": (ours,)})
    app = create_app(settings)
    app.state.noting = False  # the audit trail keeps what was written, not every step of a command
    app.add_exception_handler(CalibError, _named)
    async with core.running_service(settings, attended=True) as service:
        app.state.service = service
        async with _answering(app, settings) as url:
            yield Hosted(url, key, service)


@asynccontextmanager
async def _answering(app: FastAPI, settings: Settings) -> AsyncIterator[str]:
    """The address of the application, until the end of the block; what is not answered by then is cancelled."""
    config = server_config(_quiet(app), settings.limits, lifespan="off")
    config.load()
    state = ServerState()

    def connected() -> asyncio.Protocol:
        return config.http_protocol_class(config=config, server_state=state, app_state={})  # type: ignore[call-arg]

    server = await asyncio.get_running_loop().create_server(connected, HOST, 0)
    try:
        yield f"http://{HOST}:{server.sockets[0].getsockname()[1]}"
    finally:
        app.state.ending.set()
        server.close()
        for connection in tuple(state.connections):
            connection.transport.abort()
        left = tuple(state.tasks)
        for task in left:
            task.cancel()
        await asyncio.gather(*left, return_exceptions=True)


def _quiet(app: FastAPI) -> ASGIApp:
    """The application; a request that is cancelled at the end is no error of the server."""

    async def quiet(scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await app(scope, receive, send)
        except asyncio.CancelledError:
            if not app.state.ending.is_set():
                raise

    return quiet


async def _named(request: Request, error: Exception) -> ProblemResponse:
    """Invalid input with the name of its class as its code, as commands tell it."""
    return problem(request, 422, type(error).__name__, "Invalid input", str(error))
