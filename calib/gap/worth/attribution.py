"""Attribution of the gap to the effects of a model: shares, rivals and probabilities."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.model.hypotheses import Hypothesis, Key
from mavcal.calib.gap.schema import EVEN, Rival
from mavcal.calib.gap.search import prices
from mavcal.calib.gap.search.contest import Contest
from mavcal.calib.gap.search.evidence import price_of_kind
from mavcal.calib.gap.search.exchange import (
    Alternative,
    Comparison,
    Flexibility,
    StableModel,
    evidence_deficit,
    flexibility_of,
    second_order_evidence,
)
from mavcal.calib.gap.search.terms import marginal_gains

_SECOND_ORDER_SCALE = 8.0
"""Second-order evidence per unit of temperature, beside noise learned from flights. Chosen, not measured: a second
order of 16 then counts as much as `TEMPERATURE`."""
TEMPERATURE = 2.0
"""Temperature that flattens differences of penalised evidence into probabilities. Source: GAP 3.7 has the form. The
value is chosen, not measured; `telling/effect_report.py` corrects what it gives."""
_DRIFT_SHARE = 0.8
"""Fraction of its probability that drift noise keeps, since it can imitate anything slow. Chosen, not measured: it
leaves a fifth to other slow causes."""
_LISTED_WITHIN = 12.0
"""Penalised evidence within which a rival is listed. Source: GAP 3.6."""
_LISTED_SHARE = 0.98
"""Fraction of an effect's evidence above which a rival is listed too, though not beyond `prices.RIVAL_REACH`. Source:
GAP 3.6, 2 % of the gain."""


DRIFT_IN_TIME = "drift_in_time"
"""Rival of a thermal effect where time explains as much; growth with time has no effect of its own."""


@dataclass(frozen=True, eq=False)
class Attribution:
    """Marginal gain of an effect, its share of all gains, its rivals and its probability."""

    key: Key
    gain: float
    df: int
    share: float
    probability: float
    unknown_probability: float
    rivals: tuple[Rival, ...]
    shape: str = ""
    """The likeliest nameless shape in its place."""

    @property
    def doubted(self) -> bool:
        """Whether an unnamed cause is likelier than every name."""
        return self.unknown_probability > EVEN


def attributions(settled: StableModel, contest: Contest) -> tuple[Attribution, ...]:
    """One attribution for each effect of a model, the largest share first."""
    chosen, comparisons = settled.chosen, settled.comparisons
    model = chosen.model
    last = marginal_gains(model, contest)
    first = {s.hypothesis.key: s.gain for s in chosen.first}
    joined = {s.hypothesis.key: s.gain for s in chosen.scores}
    worth = {key: 0.5 * (gain + max(first.get(key, joined.get(key, gain)), 0.0)) for key, (gain, _, _) in last.items()}
    total = sum(worth.values()) or 1.0
    found = []
    for term in model.members:
        key = term.hypothesis.key
        comparison = comparisons[key]
        second = second_order_evidence(chosen, comparison.own)
        rivals, probability, unknown = _rivals_and_probabilities(
            term.hypothesis, comparison, flexibility_of(chosen, key), second
        )
        share = worth[key] / total
        gain, df, _ = last[key]
        found.append(
            Attribution(key, gain, df, share, probability, unknown, rivals, _likeliest_shape(comparison.alternatives))
        )
    return tuple(sorted(found, key=lambda a: -a.share))


def _grows_with_time(other: Alternative) -> bool:
    """Whether it grows linearly with time."""
    return Trait.GROWING in other.score.hypothesis.effect.traits


def _likeliest_shape(others: Sequence[Alternative]) -> str:
    shapes = [a.score for a in others if a.score.hypothesis.effect.nameless]
    return max(shapes, key=lambda s: s.delta).hypothesis.effect.excited_by if shapes else ""


def _rivals_and_probabilities(
    own: Hypothesis, comparison: Comparison, freedom: Flexibility | None, second: float
) -> tuple[tuple[Rival, ...], float, float]:
    """Rivals that the data do not exclude, and the probabilities of the effect and of an unnamed cause."""
    rivals = []
    same, weights, unknown = [0.0], [-math.inf], [-math.inf]
    for other in comparison.alternatives:
        if other.score.p >= 1.0:
            continue  # noise that the instances named do not show is no rival
        delta = evidence_deficit(comparison.own, other.score, freedom, second)
        is_unknown = other.score.hypothesis.effect.nameless
        weight = -delta / (2.0 * max(TEMPERATURE, second / _SECOND_ORDER_SCALE))
        if other.score.hypothesis.effect.id == own.effect.id and other.score.hypothesis.instances == own.instances:
            same.append(weight)  # the same name in another form
        else:
            (unknown if is_unknown else weights).append(weight)
        near = max(_LISTED_WITHIN, min((1.0 - _LISTED_SHARE) * comparison.own, prices.RIVAL_REACH)) + price_of_kind(
            other.score.hypothesis.effect
        )
        if is_unknown and Trait.THERMAL in own.effect.traits and _grows_with_time(other) and delta < near:
            rivals.append(Rival(DRIFT_IN_TIME, other.kappa, delta, own.effect.fix))
        if not is_unknown and other.score.hypothesis.effect.id != own.effect.id and delta < near:
            rivals.append(Rival(other.score.hypothesis.effect.id, other.kappa, delta, own.effect.fix))
    best: dict[str, Rival] = {}
    for rival in sorted(rivals, key=lambda r: r.delta):
        best.setdefault(rival.id, rival)
    unnamed = max(unknown)  # the others are parts of it, or it in another guise
    total = float(np.logaddexp.reduce([*same, *weights, unnamed]))
    right = math.exp(float(np.logaddexp.reduce(same)) - total)
    wanders = own.effect.drifts
    return tuple(best.values()), right * (_DRIFT_SHARE if wanders else 1.0), math.exp(unnamed - total)
