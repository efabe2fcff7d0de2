from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from mavcal.service.jobs.model import Job
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
