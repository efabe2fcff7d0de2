"""The ASGI application; it has no global state."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache, partial

from fastapi import FastAPI
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles
from starlette.middleware.cors import CORSMiddleware

from mavcal import calib
from mavcal.service.api import campaigns, fleet, gaps, host, jobs, links, recordings, vehicles
from mavcal.service.api.document import document
from mavcal.service.api.middleware import Envelope
from mavcal.service.api.problems import install_problem_handlers
from mavcal.service.api.security import RequestGuard
from mavcal.service.core import running_service
from mavcal.service.doorway import UNCACHED, panel_folder
from mavcal.service.hosts import DESCRIPTION
from mavcal.service.settings import Settings, check_exposure


def create_app(settings: Settings) -> FastAPI:
    """The application; its service runs from startup to shutdown.

    Raises
    ------
    AuthError
        If the settings would let anybody on the network use the service.
    """
    check_exposure(settings)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with running_service(settings) as service:
            app.state.service = service
            yield

    app = FastAPI(
        title="mavcal",
        version=calib.__version__,
        description=DESCRIPTION,
        lifespan=lifespan,
        servers=[{"url": "."}],  # relative: the service may live behind any path prefix
        docs_url=None,  # the built-in pages and redirects name absolute addresses
        redoc_url=None,
        redirect_slashes=False,
    )
    app.state.settings = settings
    app.state.guard = RequestGuard(settings)
    app.state.ending = asyncio.Event()
    install_problem_handlers(app)
    app.add_middleware(Envelope, settings=settings, guard=app.state.guard, ending=app.state.ending)
    if settings.cors_origins:  # outermost: a page of such an origin can read what it is refused with, too
        app.add_middleware(
            CORSMiddleware,
            allow_origins=settings.cors_origins,
            allow_methods=["GET", "POST", "PATCH", "DELETE"],
            allow_headers=["Authorization", "Content-Type", "Idempotency-Key", "Last-Event-ID"],
            expose_headers=["Location", "Link", "X-Request-ID"],
        )
    for module in (links, vehicles, jobs, recordings, gaps, fleet, campaigns):
        app.include_router(module.router, prefix="/api/v1")
    app.include_router(host.router)
    _add_panel(app)
    app.openapi = cache(partial(document, app))  # type: ignore[method-assign]
    return app


def _add_panel(app: FastAPI) -> None:
    folder = panel_folder()

    @app.get("/", include_in_schema=False)
    async def index() -> FileResponse:
        return FileResponse(folder / "index.html", headers=UNCACHED)

    @app.get("/docs", include_in_schema=False)
    async def docs() -> FileResponse:
        return FileResponse(folder / "docs.html", headers=UNCACHED)

    app.mount("/panel", StaticFiles(directory=folder), name="panel")
    app.mount("/swagger", StaticFiles(packages=[("fastapi_swagger", "resources")]), name="swagger")
