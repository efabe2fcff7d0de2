"""Exchanges of one effect of a model for a better one.

Forward selection takes the best single effect first, even if it stands for two others, or if noise stands for a change
of the mean. Each effect is therefore compared with every other hypothesis, beside the remaining effects. `kappa` is the
part of its fitted energy that a rival can imitate; ``gain (1 - kappa)`` separates them.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavcal.calib.gap.effects.base import MeanEffect, NoiseEffect
from mavcal.calib.gap.model.hypotheses import Hypothesis, HypothesisColumns, Key, columns_of
from mavcal.calib.gap.model.joint import Model, NoiseTerm, Term
from mavcal.calib.gap.model.noise_fit import noise_fitted, without_term
from mavcal.calib.gap.model.refinement import misfit, refined
from mavcal.calib.gap.search import prices
from mavcal.calib.gap.search.contest import Contest, ContestScore, exact_gain, fixed_score, free_score, noise_score
from mavcal.calib.gap.search.evidence import price_of_kind
from mavcal.calib.gap.search.filtered_noise import filter_evidence
from mavcal.calib.gap.search.projection import Projection, independent_directions
from mavcal.calib.gap.search.selection import (
    ChosenModel,
    extended,
    has_learned_spectrum,
    largest_gain,
    objective,
    select,
)
from mavcal.calib.gap.search.terms import jointly_fitted, with_score, with_term_in_residual, without_effect
from mavcal.calib.recording import Sensor


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another hypothesis in place of an effect; `kappa` is 0 if it is too unlikely to be listed."""

    score: ContestScore
    kappa: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """All alternatives to one effect, and the penalised evidence of the effect itself, `own`."""

    alternatives: tuple[Alternative, ...]
    own: float


@dataclass(frozen=True, eq=False)
class StableModel:
    """A model that no single exchange improves, and the comparisons of its effects."""

    chosen: ChosenModel
    comparisons: Mapping[Key, Comparison]


def stable_model(chosen: ChosenModel, contest: Contest, alpha: float, before: StableModel | None = None) -> StableModel:
    """The model after exchanges of effects, until no exchange improves it.

    After an exchange only the effects of the same sensors are compared again; at the end all are.

    Parameters
    ----------
    chosen, contest, alpha
        A model, what competes for the places in it, and the chance of an effect where there is none.
    before
        The result of another contest. For the same model only new hypotheses are compared. With no time left, its
        comparisons are also used for a model with fewer effects.
    """
    level = alpha / max(chosen.tests, 1)
    members = {term.hypothesis.key for term in chosen.model.members}
    if before is not None and members <= before.comparisons.keys() and contest.pace.ends():
        return StableModel(chosen, {key: before.comparisons[key] for key in members})
    comparisons = _comparisons(
        chosen, contest, before.comparisons if before is not None and before.chosen is chosen else {}
    )
    fresh, exchanges = True, 0
    while True:
        other = _after_best_exchange(chosen, comparisons, level, contest) if exchanges < prices.MOST_EXCHANGES else None
        if other is None and (fresh or contest.pace.ends()):
            return StableModel(chosen, comparisons)
        if other is None:
            comparisons, fresh = _comparisons(chosen, contest, {}), True
            continue
        elsewhere = _unaffected(chosen.model, other.model)
        still = {key: comparison for key, comparison in comparisons.items() if key in elsewhere}
        chosen, exchanges, fresh = other, exchanges + 1, not still
        comparisons = {**still, **_comparisons(chosen, contest, {}, still)}


def _comparisons(
    chosen: ChosenModel, contest: Contest, known: Mapping[Key, Comparison], but: Collection[Key] = ()
) -> dict[Key, Comparison]:
    """Comparisons of the effects of a model, except `but`; a `known` one gets only its missing alternatives."""
    keys = {term.hypothesis.key: term for term in chosen.model.members}
    return {
        key: _comparison(chosen, contest, term, known[key].alternatives if key in known else ())
        for key, term in keys.items()
        if key not in but
    }


def _unaffected(model: Model, other: Model) -> frozenset[Key]:
    """Effects of both models on sensors whose effects are the same in both."""
    own, new = ({t.hypothesis.key: t.hypothesis.effect for t in m.members} for m in (model, other))
    changed = [(own | new)[key] for key in own.keys() ^ new.keys()]
    sensors = set(Sensor) if any(e.shared for e in changed) else {e.sensor for e in changed}
    return frozenset(key for key in own.keys() & new.keys() if not own[key].shared and own[key].sensor not in sensors)


def _after_best_exchange(
    chosen: ChosenModel, comparisons: Mapping[Key, Comparison], level: float, contest: Contest
) -> ChosenModel | None:
    """The model after the best exchange that still improves it after a complete fit; None if there is none.

    An exchange is judged beside the other effects as they were fitted, and they may depend on the effect that leaves.
    """
    for worth, key, score in _gainful_exchanges(chosen, comparisons, level, contest)[: prices.EXCHANGES_TRIED]:
        if contest.pace.ends():
            break
        exchanged = _with_exchange(chosen, key, score)
        other = extended(exchanged, contest, level)
        # the extension also drops what a rule forbids, which the model before the exchange may still have
        if min(objective(exchanged), objective(other)) < objective(chosen) + worth:
            return other
    return None


def _with_exchange(chosen: ChosenModel, old: Key, new: ContestScore) -> ChosenModel:
    model, joint, noise = jointly_fitted(with_score(without_effect(chosen.model, old), new))
    scores = (*(s for s in chosen.scores if s.hypothesis.key != old), new)
    return replace(chosen, model=model, joint=joint, noise=noise, scores=scores)


def without_drift_noise(chosen: ChosenModel, start: Model, contest: Contest, alpha: float) -> ChosenModel:
    """The model, or a better one that was selected without drift noise and stabilised by exchanges.

    Forward selection may stop at two wrong effects, which drift noise then beats, although it would not beat the two
    right ones. A magnet put on and taken off makes two jumps, neither significant alone: events are therefore also
    tried first.
    """
    drifting = {t.hypothesis.effect.sensor for t in chosen.model.noise_terms if t.hypothesis.effect.drifts}
    if not drifting or {Sensor.ACCEL, Sensor.MAG} <= drifting:  # both: it is the reference, which comes next
        return chosen
    if contest.pace.ends():
        return chosen
    steady = [h for h in contest.hypotheses if not h.effect.drifts]
    level = alpha * len(steady) / max(len(contest.hypotheses), 1)
    without_drift = contest.restricted_to(steady)
    other = stable_model(select(start, without_drift, level), without_drift, level).chosen
    best = other if objective(other) < objective(chosen) else chosen
    jumps = [h for h in steady if h.effect.jumps and h.effect.sensor in drifting]
    events = _starting_with_events(start, jumps, without_drift, level)
    if events is not None and objective(events) < objective(best) - prices.EVENT_GAIN_SHARE * largest_gain(
        chosen, contest
    ):
        best = events
    return replace(best, tests=chosen.tests, first=chosen.first)


def _starting_with_events(
    start: Model, jumps: Sequence[Hypothesis], contest: Contest, alpha: float
) -> ChosenModel | None:
    """A model that was selected from `jumps` first; None if fewer than two were selected."""
    tests = sum(not h.again for h in contest.hypotheses)
    events = select(start, contest.restricted_to(jumps), alpha * len(jumps) / max(len(contest.hypotheses), 1))
    if len(events.scores) < 2:
        return None
    begun = extended(replace(events, tests=tests), contest, alpha / max(tests, 1))
    return stable_model(begun, contest, alpha).chosen


def _gainful_exchanges(
    chosen: ChosenModel, comparisons: Mapping[Key, Comparison], level: float, contest: Contest
) -> list[tuple[float, Key, ContestScore]]:
    """Exchanges that gain, best first, and by how much the objective may rise after each.

    Beside noise learned from flights, a hundredth of an effect is of second order: the effect with fewer parameters is
    preferred by that much.
    """
    found = []
    for key, comparison in comparisons.items():
        second = second_order_evidence(chosen, comparison.own)
        for score in (other.score for other in comparison.alternatives):
            gain = -evidence_deficit(comparison.own, score, flexibility_of(chosen, key), second)
            if score.p < level and score.gain >= contest.thresholds.to_enter(score.hypothesis) and gain > 0.0:
                found.append((gain, max(second, prices.SECOND_ORDER_SHARE * comparison.own), key, score))
    return [exchange[1:] for exchange in sorted(found, key=lambda exchange: -exchange[0])]


def second_order_evidence(chosen: ChosenModel, own: float) -> float:
    """Second-order part of an effect's evidence; zero unless the noise was learned from flights."""
    return prices.FLIGHT_SECOND_ORDER_SHARE * max(own, 0.0) if has_learned_spectrum(chosen.model) else 0.0


Flexibility = tuple[bool, bool, int]
"""Sort key: whether an effect is wandering noise, whether it is a nameless shape, and its degrees of freedom including
the shape. Wandering noise can imitate anything slow, and one of a thousand shapes is near anything. Both are more
flexible than any number of amplitudes: a scale about one axis is near the product of its rate and gravity.
"""


def flexibility_of(chosen: ChosenModel, key: Key) -> Flexibility | None:
    """The flexibility of an effect of the model; None if it did not compete."""
    return next((_flexibility(score) for score in chosen.scores if score.hypothesis.key == key), None)


def _flexibility(score: ContestScore) -> Flexibility:
    effect = score.hypothesis.effect
    df = score.df + (isinstance(effect, MeanEffect) and effect.shape is not None)
    return effect.drifts, effect.nameless, df


def evidence_deficit(own: float, score: ContestScore, freedom: Flexibility | None, second: float) -> float:
    """Evidence by which a rival is worse than an effect; the more flexible one is discounted by a `second` order."""
    if freedom is None or _flexibility(score) == freedom:
        return own - score.delta
    return own - score.delta + (second if _flexibility(score) > freedom else -prices.SECOND_ORDER_LOSS * second)


def _comparison(
    chosen: ChosenModel, contest: Contest, term: Term | NoiseTerm, known: Sequence[Alternative]
) -> Comparison:
    """Every other hypothesis in place of `term`; some are `known` already."""
    model = chosen.model
    key = term.hypothesis.key
    if isinstance(term, NoiseTerm):
        bare = noise_fitted(without_term(model, term), [term.hypothesis.effect.sensor]).model
        beside, own_columns, energy, stiff = Projection(bare), None, 0.0, 0.0
        own = noise_score(term.hypothesis, bare)
        own_gain, own_delta = own.gain, own.delta
    else:
        i = model.terms.index(term)
        bare, _ = refined(without_effect(model, key))
        beside = Projection(with_term_in_residual(model, i), omit=(i,))
        own_columns = columns_of(term.hypothesis, term.theta, model.setting.views, model.setting.frames)
        gram, _, _ = beside.projected(own_columns)
        energy = float(term.beta @ gram @ term.beta)
        own = _own_score(chosen, term, own_columns, beside)
        own_gain, own_delta = own.gain, own.delta
        # The part that the other terms absorb: linearised columns could take it, added noise could not.
        stiff = max(misfit(bare) - misfit(model) - own_gain, 0.0)
    taken = {t.hypothesis.key for t in model.members} | {one.score.hypothesis.key for one in known}
    found = list(known)
    others = [t.hypothesis for t in model.members if t is not term]
    rivals = [
        rival
        for rival in contest.hypotheses
        if not (rival.key in taken or rival.again)
        and _share_a_series(rival, term.hypothesis, model)
        and not rival.is_unobservable_beside(others, model.setting.views)
    ]
    likely = [
        rival for rival in rivals if _is_known_rival(rival, term.hypothesis)
    ]  # never left out, or nothing is probable
    far = [rival for rival in rivals if not _is_known_rival(rival, term.hypothesis)]
    scores = [_lowered(noise_score(rival, bare), stiff) for rival in likely if isinstance(rival.effect, NoiseEffect)]
    for rival in far:
        if isinstance(rival.effect, NoiseEffect) and not contest.pace.ends():
            scores.append(_lowered(noise_score(rival, bare), stiff))
    means = [rival for rival in likely if not isinstance(rival.effect, NoiseEffect)]
    coarse = [contest.score(rival, beside, refine=False) for rival in means]
    coarse += contest.scores([rival for rival in far if not isinstance(rival.effect, NoiseEffect)], beside)
    if isinstance(term, NoiseTerm):
        large = [score.hypothesis for score in coarse if score.gain > prices.WORTH_A_FIT * own_gain]
        scores += [_with_noise_fitted(contest.score(hypothesis, beside), bare) for hypothesis in large]
        coarse = [score for score in coarse if score.hypothesis not in large]
    scores += contest.refined_scores(coarse, beside, own_delta - prices.RIVAL_REACH)
    for score in scores:
        near = own_delta - score.delta < prices.RIVAL_REACH + price_of_kind(score.hypothesis.effect)
        kappa = (
            _imitated_share(contest, beside, own_columns, term, score, energy=energy, own_gain=own_gain)
            if near
            else 0.0
        )
        found.append(Alternative(score, kappa))
    return Comparison(tuple(found), own_delta)


def _with_noise_fitted(score: ContestScore, bare: Model) -> ContestScore:
    """`score` of an effect on the mean with refitted noise, since the noise contained the effect before.

    An offset of 0.4 m/s2 in noise of 0.02 m/s2 gained only a third of what the random walk in its place had gained.
    """
    sensor = score.hypothesis.effect.sensor
    before, after = (noise_fitted(m, [sensor]).deviance for m in (bare, with_score(bare, score)))
    more = math.fsum(before.values()) - math.fsum(after.values()) - score.gain
    return score if more <= 0.0 else _lowered(score, -more)


def _lowered(score: ContestScore, gain: float) -> ContestScore:
    return replace(score, gain=score.gain - gain, delta=score.delta - gain)


def _own_score(chosen: ChosenModel, term: Term, columns: HypothesisColumns, beside: Projection) -> ContestScore:
    if term.effect.fixed:
        gain = beside.fixed_gain(columns) + filter_evidence(term.hypothesis, term.theta, beside.model)
        return fixed_score(term.hypothesis, term.theta, gain)
    found = beside.gain(columns)
    if term.effect.exact is not None:
        gain, beta = exact_gain(term.hypothesis, term.beta, beside)
        found = replace(found, gain=gain, beta=beta, evidence=gain - found.price)
    grid = next((s.grid for s in chosen.scores if s.hypothesis.key == term.hypothesis.key), 1)
    return free_score(term.hypothesis, term.theta, found, grid)


def _is_known_rival(rival: Hypothesis, own: Hypothesis) -> bool:
    """Whether a rival is the same effect on another unit or in another form, or is listed in the catalogue."""
    return rival.effect.id == own.effect.id or rival.effect.id in own.effect.rivals


def _share_a_series(rival: Hypothesis, own: Hypothesis, model: Model) -> bool:
    return any(rival.touches(view) and own.touches(view) for view in model.setting.views)


def _imitated_share(
    contest: Contest,
    beside: Projection,
    own: HypothesisColumns | None,
    term: Term | NoiseTerm,
    score: ContestScore,
    *,
    energy: float,
    own_gain: float,
) -> float:
    """The part of the effect's energy that the rival's columns can imitate."""
    if own is None or isinstance(score.hypothesis.effect, NoiseEffect) or score.df == 0:
        return float(np.clip(score.gain / max(own_gain, 1e-12), 0.0, 1.0))
    assert isinstance(term, Term)
    columns = contest.columns.of(score.hypothesis, score.theta, beside.model.setting)
    gram, _, before = beside.projected(columns)
    basis = independent_directions(gram, before)
    taken = basis.T @ (beside.cross(columns, own) @ term.beta)
    return float(np.clip((taken @ taken) / max(energy, 1e-300), 0.0, 1.0))
