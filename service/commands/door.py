"""The one way of live commands to a service: to one that runs elsewhere, or to the application in this process."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mavcal.client import ApiProblem, AsyncClient
from mavcal.client.transport import Query
from mavcal.service.commands.remote import refused
from mavcal.service.errors import error_of
from mavcal.service.loading import loading

if TYPE_CHECKING:
    import httpx

    from mavcal.service.hosting import Hosted
    from mavcal.service.settings import Settings

COMMAND = "command line"
OPERATOR = "operator"
"""Who asks, in what is kept of a write."""
ANSWER_S = 600.0
"""How long an answer may take: a preflight that first calibrates takes minutes."""
TIDY_S = 30.0
"""How long the vehicle may take to confirm its old message rates."""
HURRY_S = 5.0
"""The same for a run that was told to stop."""


class RaisingClient(AsyncClient):
    """Raises what the service has raised, in place of a problem document."""

    async def _sent(self, method: str, path: str, also: tuple[int, ...], **request: Any) -> httpx.Response:
        try:
            return await super()._sent(method, path, also, **request)
        except ApiProblem as problem:
            raise _raised(problem) from None

    async def _stream(self, path: str, query: Query | None, last: int | str | None) -> AsyncIterator[dict[str, Any]]:
        try:
            async for found in super()._stream(path, query, last):
                yield found
        except ApiProblem as problem:
            raise _raised(problem) from None


@dataclass(frozen=True)
class Door:
    """A service, asked by its client."""

    client: AsyncClient
    own: Hosted

    async def open(self, endpoint: str) -> str:
        """The id of a link of this command. Raises EndpointError, PortBusy."""
        return await self.own.open(endpoint)

    async def tidied(self, seconds: float = TIDY_S) -> None:
        """Give the vehicle time to take its old message rates back; what is missing then, the next run does."""
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self.own.tidied()


@asynccontextmanager
async def door(settings: Settings, actor: str = COMMAND) -> AsyncIterator[Door]:
    """The application in this process, with these settings; nothing of it is left behind."""
    with loading():
        from mavcal.service.hosting import hosted

    async with (
        hosted(settings, actor) as own,
        RaisingClient(own.url, key=own.key, timeout_s=ANSWER_S) as client,
    ):
        yield Door(client, own)


def _raised(problem: ApiProblem) -> Exception:
    return error_of(problem.code, problem.detail) or refused(problem)
