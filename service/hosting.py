"""Runs the application in the process of a command, on a loopback port with a key of its own."""

from __future__ import annotations

import asyncio
import hashlib
import secrets
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from dataclasses import dataclass

from mavcal.service import core
from mavcal.service.core import Service
from mavcal.service.errors import ServiceError
from mavcal.service.loading import loading
from mavcal.service.settings import ApiKey, Settings


@dataclass(frozen=True)
class Hosted:
    """A service of this process, and how it is asked."""

    url: str
    key: str
    service: Service

    async def open(self, endpoint: str) -> str:
        """The id of a link that is not remembered. Raises EndpointError, PortBusy."""
        return (await self.service.links.open(endpoint, remember=False, trusted=True)).id

    async def wait_for_cleanup(self) -> None:
        """Wait until the message rates of every vehicle are restored, and checks after a write are done."""
        await self.service.jobs.wait_for_cleanup()


@asynccontextmanager
async def hosted(settings: Settings, actor: str, endpoints: Iterable[str] = ()) -> AsyncIterator[Hosted]:
    """A service with these settings that answers the holder of its key alone, who is called `actor` in what is kept.

    Its links to `endpoints` open first: vehicles are heard while the application is loaded. One that cannot be opened
    is left to :meth:`Hosted.open`, which says why.

    Raises
    ------
    DataDirLocked, EndpointError, PortBusy
        As :func:`service.core.running_service`.
    """
    key = secrets.token_urlsafe(32)
    ours = ApiKey(name=actor, sha256=hashlib.sha256(key.encode()).hexdigest(), scopes=frozenset({"admin"}))
    settings = settings.model_copy(update={"host": "127.0.0.1", "port": 0, "api_keys": (ours,)})
    async with core.running_service(settings, attended=True) as service:
        for endpoint in endpoints:
            with suppress(ServiceError):
                await service.links.open(endpoint, remember=False, trusted=True)
        answering = await asyncio.to_thread(_loaded)
        async with answering(settings, service) as url:
            yield Hosted(url, key, service)


def _loaded() -> Callable[[Settings, Service], AbstractAsyncContextManager[str]]:
    """The function that answers requests; loading it takes a third of a start."""
    with loading():
        from mavcal.service.answering import answering

        return answering
