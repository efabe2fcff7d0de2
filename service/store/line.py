"""Writes a store in one thread, in the order of the requests, so that the event loop never waits for the disk."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from typing import TypeVar

T = TypeVar("T")


class WriteLine:
    """Runs what it is given one after the other. Its thread begins with the first work."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="store")
        self._lock = threading.Lock()
        self._last: Future[object] | None = None
        self._thread: int | None = None

    def soon(self, work: Callable[[], T]) -> Future[T]:
        """Have `work` done after everything that was asked for before."""

        def run() -> T:
            self._thread = threading.get_ident()
            return work()

        with self._lock:
            future = self._pool.submit(run)
            self._last = future  # type: ignore[assignment]
        return future

    async def do(self, work: Callable[[], T]) -> T:
        """The same, and wait for it. A cancelled caller leaves only when it is done: begun is finished."""
        future = asyncio.wrap_future(self.soon(work))
        try:
            return await asyncio.shield(future)
        except asyncio.CancelledError:
            while not future.done():
                with suppress(asyncio.CancelledError):
                    await asyncio.wait({future})
            if not future.cancelled():
                future.exception()  # looked at: the caller is gone
            raise

    def caught_up(self) -> None:
        """Block until everything that was asked for is done, unless this is the line's own thread."""
        last = self._last
        if last is not None and not last.done() and threading.get_ident() != self._thread:
            wait([last])

    def close(self) -> None:
        """Do what is left and end the thread."""
        self._pool.shutdown(wait=True)
