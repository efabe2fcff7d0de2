"""Exchanges of messages with a vehicle: the addressee, the time allowed for an answer, and the wait for it.

Nothing sleeps: a wait is a future, resolved by a frame or by a tick after its deadline.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from mavcal.calib.wire.codec import Message, RawMessage
from mavcal.calib.wire.frames import Frame
from mavcal.service.link.types import OwnIdentity
from mavcal.service.vehicle.state import VehicleState

T = TypeVar("T")

MOST_S = 5.0
"""Longest wait for an answer, s, however slow the answers have become."""
_SMOOTHING, _SPREADING = 1 / 8, 1 / 4
_SPREADS = 4.0
_TRIPS = 100
"""Number of questions whose answers are remembered; a link may become worse or better."""
MISSED = 1 / 200
"""Accepted chance that an existing parameter counts as absent."""
MOST_SILENCES, FEWEST_SILENCES = 5, 2
"""Five: at 30 % loss each way a parameter that exists is missed once in 200 times. Two: one gap of the link proves
nothing."""


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
        """Whether an answer over a link that is not in use counts."""
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
        """The next answer, or None after so many seconds."""
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
    """All waits of a vehicle's tasks."""

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
        """Pass a frame to the waits for its kind; `beside`: it came over a link that is not in use."""
        for expectation in list(self._expectations):
            if frame.message_id in expectation.message_ids and (expectation.anywhere or not beside):
                expectation.feed(frame)

    @property
    def any(self) -> bool:
        """Whether anything is waited for."""
        return bool(self._expectations)

    def tick(self, now: float) -> None:
        """End expired waits; `now` is the time until which every frame was fed."""
        for expectation in list(self._expectations):
            expectation.tick(now)

    def close(self, error: Exception) -> None:
        """End every wait, now and later, with an error."""
        self._error = error
        for expectation in list(self._expectations):
            expectation.fail(error)


class Addressee(Protocol):
    """A vehicle that messages can be sent to, with its pending answers and its state."""

    system: int
    """Its system id."""

    component: int
    """Its component id."""

    @property
    def own(self) -> OwnIdentity:
        """Our own ids in the messages to it, to which it answers."""

    waits: Waits
    """The answers that are awaited from it."""

    state: VehicleState
    """The latest state."""

    @property
    def silent(self) -> bool:
        """Whether its last heartbeat is more than 3 s older than what was read of the link."""

    def clock(self) -> float:
        """Monotonic time, s."""

    def send(self, message: Message | RawMessage) -> None:
        """Send to it. Raises LinkDown if that is not possible."""


class Pace:
    """Mean and spread of the answers' delays, estimated as TCP does it (RFC 6298)."""

    def __init__(self) -> None:
        self._mean: float | None = None
        self._spread = 0.0
        self._trips: deque[bool] = deque(maxlen=_TRIPS)

    def answered(self, seconds: float) -> None:
        """Record the delay of an answer; not for a question asked twice, since either may have been answered."""
        if self._mean is None:
            self._mean, self._spread = seconds, seconds / 2
            return
        self._spread += _SPREADING * (abs(seconds - self._mean) - self._spread)
        self._mean += _SMOOTHING * (seconds - self._mean)

    def patience(self, at_first: float, least: float) -> float:
        """Time to wait for an answer, s.

        Parameters
        ----------
        at_first
            The time while no answer has been timed.
        least
            The least time, however fast the answers were.
        """
        if self._mean is None:
            return at_first
        return min(max(self._mean + _SPREADS * self._spread, least), MOST_S)

    def trip(self, *, answered: bool) -> None:
        """Record whether a question that has an answer was answered in time."""
        self._trips.append(answered)

    def silences(self) -> int:
        """Number of unanswered questions that proves absence: by loss alone it happens less than once in 200 times.

        The share of losses is estimated from the questions so far, with a uniform prior. The chance of k losses in a
        row is then the product of (lost + 1 + i) / (asked + 2 + i) for i below k.
        """
        asked, lost = len(self._trips), sum(not answered for answered in self._trips)
        chance, k = 1.0, 0
        while k < MOST_SILENCES and (k < FEWEST_SILENCES or chance > MISSED):
            chance *= (lost + 1 + k) / (asked + 2 + k)
            k += 1
        return k
