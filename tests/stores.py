"""The store that tests of jobs run on: SQLite in memory, or an empty PostgreSQL database.

Such a test makes its stores by :func:`new_store`. The folder's ``conftest`` runs chosen modules once on each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from mavcal.service.store import SqliteStore
from mavcal.service.store.sql import Store

_in_memory: Callable[[], Store] = lambda: SqliteStore(None)  # noqa: E731 - it is replaced
_make = _in_memory


def new_store() -> Store:
    """An empty store of the kind that this test runs on."""
    return _make()


@contextmanager
def made_by(make: Callable[[], Store]) -> Iterator[None]:
    """Meanwhile stores are of another kind."""
    global _make
    _make = make
    try:
        yield
    finally:
        _make = _in_memory
