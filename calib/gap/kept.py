"""Transformed columns that are asked for again and again, by every contest on one setting."""

from __future__ import annotations

from mavcal.calib.gap.hypotheses import Hypothesis, HypothesisColumns, columns_of
from mavcal.calib.gap.model import Setting


class Kept:
    """Transformed columns of hypotheses on one setting, as many as fit into `budget` numbers."""

    def __init__(self, budget: int) -> None:
        self._columns: dict[tuple[str, tuple[int, ...], float], HypothesisColumns] = {}
        self._left = budget

    def of(self, hypothesis: Hypothesis, theta: float, setting: Setting) -> HypothesisColumns:
        """Those of `hypothesis` at the shape `theta`."""
        key = (*hypothesis.key, theta)
        if key in self._columns:
            return self._columns[key]
        made = columns_of(hypothesis, theta, setting.views, setting.frames)
        size = sum(part.X.size for part in made.parts.values())
        if size <= self._left:
            self._columns[key] = made
            self._left -= size
        return made
