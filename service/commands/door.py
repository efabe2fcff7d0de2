"""The one way of live commands to a service: to one that runs elsewhere, or to the application in this process."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mavcal.service.loading import loading

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.service.commands.asking import RaisingClient
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
async def door(settings: Settings, endpoints: Iterable[str] = (), actor: str = COMMAND) -> AsyncIterator[Door]:
    """The application in this process, with these settings and links; nothing of it is left behind."""
    with loading():
        from mavcal.service.hosting import hosted

    async with hosted(settings, actor, endpoints) as own:
        client = await asyncio.to_thread(_loaded)
        async with client(own.url, key=own.key, timeout_s=ANSWER_S) as asking:
            yield Door(asking, own)


def _loaded() -> type[RaisingClient]:
    with loading():
        from mavcal.service.commands.asking import RaisingClient

        return RaisingClient
