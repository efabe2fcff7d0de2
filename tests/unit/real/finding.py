"""What is known of a recording beside what a method finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Finding:
    """What came of one comparison."""

    recording: str
    method: str
    quantity: str
    known: str
    ours: str
    verdict: str
    agrees: bool


@dataclass(frozen=True)
class Compared:
    """A recording and the method that was put to it."""

    recording: str
    method: str

    def number(
        self, quantity: str, known: ArrayLike, ours: ArrayLike, sd: ArrayLike, within: ArrayLike, because: str
    ) -> Finding:
        """A finding that agrees if every number is within `within`, plus two of our own sd, of the known one.

        All are of shape (k,), or one number for all, in one unit. `because` says where `within` comes from.
        """
        k, o, s, w = np.broadcast_arrays(
            *(np.atleast_1d(np.asarray(v, dtype=float)) for v in (known, ours, sd, within))
        )
        apart = np.abs(o - k)
        agrees = bool(np.isfinite(o).all() and (apart <= w + 2.0 * s).all())
        verdict = f"{'agrees' if agrees else 'differs'}: apart by {_numbers(apart, 2)}; {because}"
        text = ", ".join(f"{a:.6g} ± {b:.1g}" if b else f"{a:.6g}" for a, b in zip(o, s, strict=True))
        return Finding(self.recording, self.method, quantity, _numbers(k, 6), text, verdict, agrees)

    def word(self, quantity: str, known: str, ours: str, *, agrees: bool) -> Finding:
        """A finding in words: the method has to say the right thing."""
        verdict = "as it should" if agrees else "not as it should"
        return Finding(self.recording, self.method, quantity, known, ours, verdict, agrees)


def _numbers(values: Sequence[float] | np.ndarray, digits: int) -> str:
    shown = [f"{v:.{digits}g}" for v in values]
    return shown[0] if len(set(shown)) == 1 else ", ".join(shown)
