from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from mavcal.service.store import SqliteStore, Store
from mavcal.service.store.postgres import PostgresStore


@pytest.fixture(params=["sqlite", "postgres"])
def open_store(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[], Store]:
    """Opens the same store every time."""
    if request.param == "sqlite":
        return lambda: SqliteStore(tmp_path)
    url = request.getfixturevalue("database_url")
    return lambda: PostgresStore(url, tmp_path)


@pytest.fixture
def store(open_store: Callable[[], Store]) -> Iterator[Store]:
    store = open_store()
    yield store
    store.close()
