"""A typed client of the service: start, follow, answer, read, apply, take back; ``docs/client.md`` shows it.

:class:`Client` waits for each answer, :class:`AsyncClient` is for asyncio. Both have one method for each operation of
the OpenAPI document. They answer with models of its schemas and raise a subclass of :class:`ApiProblem` for each
problem.
"""

from __future__ import annotations

from mavcal.client.asynchronous import AsyncClient
from mavcal.client.errors import ApiProblem, ClientError, UnexpectedAnswer, Unreachable
from mavcal.client.waiting import Client

__all__ = ["ApiProblem", "AsyncClient", "Client", "ClientError", "UnexpectedAnswer", "Unreachable"]
