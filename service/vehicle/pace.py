"""Response time of a vehicle: nothing is asked again while its answer may still be under way.

And how many of its answers are lost, so that silence proves what it can.
"""

from __future__ import annotations

from collections import deque

MOST_S = 5.0
"""Nothing is waited for longer than this, however slow the answers have become."""
_SMOOTHING, _SPREADING = 1 / 8, 1 / 4
_SPREADS = 4.0
_TRIPS = 100
"""Whether so many questions were answered is remembered; a link may become worse or better."""
MISSED = 1 / 200
"""A parameter that exists may count as absent once in so many times."""
MOST_SILENCES, FEWEST_SILENCES = 5, 2
"""Five: at 30 % loss each way a parameter that exists is missed once in 200 times. Two: one gap of the link proves
nothing."""


class Pace:
    """Mean and spread of the answers' delays, estimated as TCP does it (RFC 6298)."""

    def __init__(self) -> None:
        self._mean: float | None = None
        self._spread = 0.0
        self._trips: deque[bool] = deque(maxlen=_TRIPS)

    def answered(self, seconds: float) -> None:
        """Record the delay of an answer. Not for a question asked twice: which one was answered is unknown."""
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
            While no answer was timed yet.
        least
            However fast they were.
        """
        if self._mean is None:
            return at_first
        return min(max(self._mean + _SPREADS * self._spread, least), MOST_S)

    def trip(self, *, answered: bool) -> None:
        """Count whether a question that has an answer was answered in time."""
        self._trips.append(answered)

    def silences(self) -> int:
        """Number of unanswered questions that proves absence: by loss alone it happens less than once in 200 times.

        Nothing but the questions so far tells the share lost: any was equally likely before them. The chance of
        k losses in a row is then the product of (lost + 1 + i) / (asked + 2 + i) for i below k.
        """
        asked, lost = len(self._trips), sum(not answered for answered in self._trips)
        chance, k = 1.0, 0
        while k < MOST_SILENCES and (k < FEWEST_SILENCES or chance > MISSED):
            chance *= (lost + 1 + k) / (asked + 2 + k)
            k += 1
        return k
