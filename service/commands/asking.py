"""The client of a service in this process: it raises the errors of the service themselves."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Any

from mavcal.client import ApiProblem, AsyncClient
from mavcal.client.exchange import Query
from mavcal.service.commands.output import refused
from mavcal.service.errors import error_of

if TYPE_CHECKING:
    import httpx


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


def _raised(problem: ApiProblem) -> Exception:
    return error_of(problem.code, problem.detail) or refused(problem)
