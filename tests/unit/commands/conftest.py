from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from mavcal.service.commands import door
from mavcal.service.jobs.core.model import Job
from tests.unit.commands.doubles import FakeService, KeptScreen


@pytest.fixture
def screen() -> KeptScreen:
    return KeptScreen()


@pytest.fixture
def make_service() -> Iterator[Callable[..., Any]]:
    """Makes services of given jobs, whose stores are closed in the end."""
    made: list[FakeService] = []

    def make(*jobs: Job, **more: Any) -> Any:
        made.append(FakeService(*jobs, **more))
        return made[-1]

    yield make
    for service in made:
        service.store.close()


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Makes the door of every command lead to a certain service."""

    def give(service: Any) -> None:
        @asynccontextmanager
        async def opened(*_: Any) -> AsyncIterator[Any]:
            yield service

        monkeypatch.setattr(door, "door", opened)

    return give
