"""Serves HTTP for a service in this process on a port of its own, without a server's signals and loop."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI, Request
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.server import ServerState

from mavcal.calib.errors import CalibError
from mavcal.service.api.problems import ProblemResponse, problem
from mavcal.service.app import create_app
from mavcal.service.core import Service
from mavcal.service.http import server_config
from mavcal.service.settings import Settings


@asynccontextmanager
async def answering(settings: Settings, service: Service) -> AsyncIterator[str]:
    """The address of the application, until the end of the block; unanswered requests are then cancelled."""
    app = create_app(settings)
    app.state.service = service
    app.state.noting = False  # the audit trail keeps what was written, not every step of a command
    app.add_exception_handler(CalibError, _named)
    config = server_config(_quiet(app), settings.limits, lifespan="off")
    config.load()
    state = ServerState()

    def connected() -> asyncio.Protocol:
        return config.http_protocol_class(config=config, server_state=state, app_state={})  # type: ignore[call-arg]

    server = await asyncio.get_running_loop().create_server(connected, settings.host, settings.port)
    try:
        yield f"http://{settings.host}:{server.sockets[0].getsockname()[1]}"
    finally:
        server.close()
        for connection in tuple(state.connections):
            connection.transport.abort()
        await asyncio.sleep(0)  # connections know that they are lost before their requests end: no error of the server
        app.state.ending.set()
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
