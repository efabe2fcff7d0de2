"""Ctrl-C and SIGTERM end a command in an orderly way: its task is cancelled, and says what it leaves behind."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def stoppable() -> Iterator[list[int]]:
    """Cancel the current task on SIGINT and SIGTERM; the list holds the signals that came."""
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    caught: list[int] = []

    def stop(number: int) -> None:
        caught.append(number)
        if task is not None:
            task.cancel()

    numbers = (signal.SIGINT, signal.SIGTERM)
    with suppress(NotImplementedError):  # not on every system: there the interpreter's own handling stays
        for number in numbers:
            loop.add_signal_handler(number, stop, number)
    try:
        yield caught
    finally:
        with suppress(NotImplementedError):
            for number in numbers:
                loop.remove_signal_handler(number)
