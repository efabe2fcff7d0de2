"""Gates: whether held-out blocks confirm an effect."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.heldout.folds import Fold, applied_to, expected_gain
from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.model.joint import NoiseTerm, Setting, Term
from mavcal.calib.gap.search.selection import ChosenModel
from mavcal.calib.gap.search.terms import Gains

Array = NDArray[np.float64]

_SHORTFALL_SD = 2.5
"""Standard deviations by which a held-out gain may fall short of the expected one. Chosen, not measured: one block in
160 falls short by chance."""
_SUFFICIENT_SHARE = 0.2
"""Fraction of the expected gain that is always sufficient: no model of a real sensor predicts thousands of nats
exactly. Chosen, not measured: a fifth is far from nothing."""
_LEAST_EXPECTED = -5.0
"""Expected gain, nats, below which the other blocks predict nothing for a block. Chosen, not measured: a chance of one
in 150, exp(-5)."""


@dataclass(frozen=True, eq=False)
class Gate:
    """Gains of an effect on the held-out blocks, in nats, and whether it passed; None: undecided."""

    key: Key
    gains: Array
    passed: bool | None


def gate_of(
    term: Term | NoiseTerm,
    gains: Array,
    determined: Sequence[bool],
    folds: Sequence[Fold],
    chosen: ChosenModel,
    beside: Gains,
) -> Gate:
    """The gate of a term: passed if held-out data are predicted better, failed if not although they should be.

    An effect of evidence lambda gains ``lambda / 2 +- sqrt(lambda)`` nats, so a true one near the limit of detection
    may gain nothing. An event in one block cannot be predicted from the others, and neither can a drift.
    """
    total = float(gains.sum())
    key = term.hypothesis.key
    if isinstance(term, NoiseTerm):
        drifts = term.hypothesis.effect.drifts
        return Gate(key, gains, passed=True if total > 0.0 else None if drifts else False)
    expected = [expected_gain(term, fold.train, applied_to(chosen.model, fold.test)) for fold in folds]
    seen = [e > _LEAST_EXPECTED and t for e, t in zip(expected, determined, strict=True)]
    sizes = [_numbers(term, fold.test.setting) for fold in folds]
    due = sum(_gain_beside_noise(e, n) for e, s, n in zip(expected, seen, sizes, strict=True) if s)
    joined_with = next((s.gain for s in chosen.scores if s.hypothesis.key == key), math.inf)
    due = min(due, 0.5 * min(joined_with, beside[key][0]))  # what noise or other effects take in its place is no gain
    total = float(gains[seen].sum())
    if due <= 1.0:
        return Gate(key, gains, passed=None)
    least = min(due - _SHORTFALL_SD * math.sqrt(2.0 * due), _SUFFICIENT_SHARE * due)
    if total <= 0.0 and least < 0.0:
        return Gate(key, gains, passed=None)
    passed = bool(total > max(least, 0.0))  # numpy's False `is` not False
    # the levels of an event are shared with other events and drifts
    return Gate(key, gains, passed=None if not passed and term.effect.discontinuous else passed)


def _numbers(term: Term, setting: Setting) -> int:
    return sum(3 * view.count for view in setting.views if term.hypothesis.touches(view))


def _gain_beside_noise(nats: float, numbers: int) -> float:
    """Gain beside noise that grew in place of the effect: ``n/2 log(1 + 2 nats/n)``."""
    return 0.5 * numbers * math.log1p(max(2.0 * nats / max(numbers, 1), -0.9))
