"""Waits for frames, with deadlines on a given clock.

Nothing sleeps: a wait is a future that a frame resolves, or a tick once its deadline has passed.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Generic, TypeVar

from mavcal.calib.wire.frames import Frame

T = TypeVar("T")


class Expectation(Generic[T]):
    """Frames that are waited for. Use as a context manager around sending and waiting, so that no answer is missed.

    ``match`` turns a frame into an answer, or into None if it is none.
    """

    def __init__(
        self, waits: Waits, message_ids: frozenset[int], match: Callable[[Frame], T | None], anywhere: bool
    ) -> None:
        self._waits = waits
        self.message_ids = message_ids
        self.anywhere = anywhere
        """Whether an answer counts that comes over another link than the one that is in use."""
        self._match = match
        self._answers: list[T] = []
        self._future: asyncio.Future[None] | None = None
        self._deadline = 0.0

    def __enter__(self) -> Expectation[T]:
        self._waits.add(self)
        return self

    def __exit__(self, *_: object) -> None:
        self._waits.remove(self)

    async def within(self, seconds: float) -> T | None:
        """The next answer, or None once so many seconds have passed."""
        if not self._answers:
            self._future = asyncio.get_running_loop().create_future()
            self._deadline = self._waits.clock() + seconds
            await self._future
        return self._answers.pop(0) if self._answers else None

    def feed(self, frame: Frame) -> None:
        """Take a frame of one of the ids."""
        answer = self._match(frame)
        if answer is not None:
            self._answers.append(answer)
            self._resolve()

    def tick(self, now: float) -> None:
        """End the wait if its time is over."""
        if now >= self._deadline:
            self._resolve()

    def fail(self, error: Exception) -> None:
        """End the wait with an error."""
        if self._future is not None and not self._future.done():
            self._future.set_exception(error)

    def _resolve(self) -> None:
        if self._future is not None and not self._future.done():
            self._future.set_result(None)


class Waits:
    """All that a vehicle's tasks wait for."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self.clock = clock
        self._expectations: list[Expectation[object]] = []
        self._error: Exception | None = None

    def expect(
        self, message_ids: set[int], match: Callable[[Frame], T | None], *, anywhere: bool = False
    ) -> Expectation[T]:
        """Prepare to wait for frames, be it `anywhere`; they are noticed from entering the returned context on."""
        return Expectation(self, frozenset(message_ids), match, anywhere)

    async def sleep(self, seconds: float) -> None:
        """Wait by this clock."""
        nothing: Expectation[None] = self.expect(set(), lambda _frame: None)
        with nothing:
            await nothing.within(seconds)

    def add(self, expectation: Expectation[T]) -> None:
        """Register a wait; raises if the vehicle has been closed."""
        if self._error is not None:
            raise self._error
        self._expectations.append(expectation)  # type: ignore[arg-type] # only fed and ticked from here on

    def remove(self, expectation: Expectation[T]) -> None:
        """Remove a wait."""
        self._expectations.remove(expectation)  # type: ignore[arg-type]

    def feed(self, frame: Frame, *, beside: bool = False) -> None:
        """Hand a frame to those who wait for its kind; `beside`: it came over a link that is not in use."""
        for expectation in list(self._expectations):
            if frame.message_id in expectation.message_ids and (expectation.anywhere or not beside):
                expectation.feed(frame)

    @property
    def any(self) -> bool:
        """Whether anything is waited for."""
        return bool(self._expectations)

    def tick(self, now: float) -> None:
        """End what has waited long enough; `now` is the time until which every frame was fed."""
        for expectation in list(self._expectations):
            expectation.tick(now)

    def close(self, error: Exception) -> None:
        """End every wait, now and later, with an error."""
        self._error = error
        for expectation in list(self._expectations):
            expectation.fail(error)
