"""Which message rates were set on which link: both firmwares keep them for each of their ports."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from typing import Any


class PortRates:
    """The rates that are ours, and what every link had before. They follow the vehicle to another link."""

    def __init__(self) -> None:
        self.asked: dict[int, float] = {}
        """Intervals in us that were asked for and not put back."""
        self._before: dict[str, dict[int, int]] = {}
        self._moving: asyncio.Task[None] | None = None

    def ask(self, message_id: int, interval_us: float) -> None:
        """Note what is asked for."""
        self.asked[message_id] = interval_us

    def before(self, way: str, message_id: int, interval_us: int) -> None:
        """Note what a link had, unless that is known."""
        self._before.setdefault(way, {}).setdefault(message_id, interval_us)

    def knows(self, way: str, message_id: int) -> bool:
        """Whether it is known what a link had."""
        return message_id in self._before.get(way, {})

    def to_restore(self, way: str, intervals: Mapping[int, int]) -> dict[int, int]:
        """`intervals`, with those of this link where they were read on it."""
        known = self._before.get(way, {})
        return {message_id: known.get(message_id, interval) for message_id, interval in intervals.items()}

    def restored(self, way: str, message_ids: tuple[int, ...]) -> dict[str, dict[int, int]]:
        """Note that these are as before on a link; what is still to be put back on others."""
        left: dict[str, dict[int, int]] = {}
        for message_id in message_ids:
            self.asked.pop(message_id, None)
            for name, known in self._before.items():
                interval = known.pop(message_id, None)
                if name != way and interval is not None:
                    left.setdefault(name, {})[message_id] = interval
        return left

    def drop(self, way: str) -> None:
        """A link is gone, and its rates with it."""
        self._before.pop(way, None)

    def move(self, follow: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Another link is in use: ask for our rates there; those of the one before are left alone."""
        if self._moving is not None:
            self._moving.cancel()
        if self.asked:
            self._moving = asyncio.get_running_loop().create_task(follow())

    async def moved(self) -> None:
        """Wait until the rates have followed to the link in use."""
        if self._moving is not None:
            await asyncio.wait({self._moving})
