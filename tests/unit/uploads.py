"""Uploads of a folder, and children that answer as they are told."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mavcal.service.children import INSPECT, Limits
from mavcal.service.recordings import Recordings
from mavcal.service.store import SqliteStore

LIMITS = Limits(1 << 30, 10.0, 20.0)
IDENTITY = {"identity": {"uid": "00ab"}}


class Runs:
    """Children that answer by task, or raise; what they were asked is noted."""

    most = 3

    def __init__(self, **answers: Any) -> None:
        self.answers: dict[str, Any] = {INSPECT: {"channels": [], **IDENTITY}, **answers}
        self.asked: list[tuple[str, dict[str, Any], Limits]] = []

    async def run(self, task: str, order: dict[str, Any], limits: Limits, progress: Any = None) -> Any:
        """See service.children.Children."""
        self.asked.append((task, order, limits))
        answer = self.answers[task]
        if callable(answer):
            answer = answer(order)
        if isinstance(answer, BaseException):
            raise answer
        return answer


@contextmanager
def uploads_of(folder: Path, children: Any, *, limit_bytes: int = 1000) -> Iterator[Recordings]:
    """The uploads of a folder, kept in a store in memory."""
    store = SqliteStore(None)
    found = Recordings(store, folder, limit_bytes=limit_bytes, children=children, limits=LIMITS)
    try:
        yield found
    finally:
        found.close()
        store.close()


async def chunks(*parts: bytes) -> AsyncIterator[bytes]:
    """A body in pieces."""
    for part in parts:
        yield part
