"""How long a vehicle takes to answer, so that nothing is asked again while its answer is still under way."""

from __future__ import annotations

MOST_S = 5.0
"""Nothing is waited for longer than this, however slow the answers have become."""
_SMOOTHING, _SPREADING = 1 / 8, 1 / 4
_SPREADS = 4.0


class Pace:
    """Mean and spread of the answers' delays, estimated as TCP does it (RFC 6298)."""

    def __init__(self) -> None:
        self._mean: float | None = None
        self._spread = 0.0

    def answered(self, seconds: float) -> None:
        """An answer took so long. Leave out a question that was asked twice: nobody knows which was answered."""
        if self._mean is None:
            self._mean, self._spread = seconds, seconds / 2
            return
        self._spread += _SPREADING * (abs(seconds - self._mean) - self._spread)
        self._mean += _SMOOTHING * (seconds - self._mean)

    def patience(self, at_first: float, least: float) -> float:
        """How long to wait for an answer, s.

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
