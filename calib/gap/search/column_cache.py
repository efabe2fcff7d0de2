"""Cache of transformed columns, shared by every contest on one setting."""

from __future__ import annotations

from collections import OrderedDict

from mavcal.calib.gap.effects.base import MeanEffect
from mavcal.calib.gap.model.hypotheses import Hypothesis, HypothesisColumns, columns_of
from mavcal.calib.gap.model.joint import Setting

_Key = tuple[str, tuple[int, ...], float]

_PASSING = 0.25
"""Fraction of the budget for shapes picked for one residual, which change with the next one. Chosen, not measured: most
of the budget is for columns that are requested again."""


class ColumnCache:
    """Transformed columns of hypotheses on one setting, up to `budget` numbers.

    Columns on a fixed grid are kept, since every step of a selection needs them. Of the others the latest are kept.
    """

    def __init__(self, budget: int) -> None:
        self._lasting: dict[_Key, HypothesisColumns] = {}
        self._passing: OrderedDict[_Key, HypothesisColumns] = OrderedDict()
        self._most_passing = int(_PASSING * budget)
        self._left = budget - self._most_passing
        self._left_passing = self._most_passing

    def of(self, hypothesis: Hypothesis, theta: float, setting: Setting) -> HypothesisColumns:
        """Columns of `hypothesis` at the shape `theta`."""
        key = (*hypothesis.key, theta)
        known = self._lasting.get(key)
        if known is None and (known := self._passing.get(key)) is not None:
            self._passing.move_to_end(key)
        if known is not None:
            return known
        made = columns_of(hypothesis, theta, setting.views, setting.frames)
        size = numbers_of(made)
        if _is_picked(hypothesis):
            if size <= self._most_passing:
                self._keep_passing(key, made, size)
        elif size <= self._left:
            self._lasting[key] = made
            self._left -= size
        return made

    def _keep_passing(self, key: _Key, made: HypothesisColumns, size: int) -> None:
        self._passing[key] = made
        self._left_passing -= size
        while self._left_passing < 0:
            _, gone = self._passing.popitem(last=False)
            self._left_passing += numbers_of(gone)


def _is_picked(hypothesis: Hypothesis) -> bool:
    """Whether a screen picks its shapes for the present residual."""
    effect = hypothesis.effect
    return isinstance(effect, MeanEffect) and effect.shape is not None and effect.shape.screen is not None


def numbers_of(columns: HypothesisColumns) -> int:
    """Count of the numbers that columns hold; axes may share an array."""
    return sum({id(part.X): part.X.size for part in columns.parts.values()}.values())
