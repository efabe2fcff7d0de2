"""Forward-backward selection of significant effects that are worth their price.

After every step all parameters and the noise are fitted again, and effects that became superfluous leave.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from mavcal.calib.gap.effects.base import MeanEffect, NoiseEffect
from mavcal.calib.gap.model.hypotheses import Hypothesis, Key
from mavcal.calib.gap.model.joint import (
    Joint,
    Model,
    NoiseTerm,
    Term,
    with_noise,
    with_residual,
)
from mavcal.calib.gap.model.noise_fit import (
    FittedNoise,
    is_declared,
    noise_fitted,
    starting_noise,
)
from mavcal.calib.gap.model.refinement import coupled_sensors
from mavcal.calib.gap.search import prices
from mavcal.calib.gap.search.added_noise import is_line_unsteadiness
from mavcal.calib.gap.search.contest import Contest, ContestScore
from mavcal.calib.gap.search.projection import Projection
from mavcal.calib.gap.search.terms import (
    Gains,
    jointly_fitted,
    locally_fitted,
    marginal_gains,
    member_of,
    with_score,
    without_effect,
)
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ChosenModel:
    """A fitted model, its covariance, the scores of its terms when they entered, and the number of tests.

    `first` are the scores of all hypotheses against `start`, the model without an effect.
    """

    model: Model
    joint: Joint
    noise: FittedNoise
    scores: tuple[ContestScore, ...]
    tests: int
    first: tuple[ContestScore, ...]
    start: Model


def largest_gain(chosen: ChosenModel, contest: Contest) -> float:
    """Largest marginal gain of the effects in a model."""
    return max((gain for gain, _, _ in marginal_gains(chosen.model, contest).values()), default=0.0)


def select(start: Model, contest: Contest, alpha: float, earlier: ChosenModel | None = None) -> ChosenModel:
    """The model with the effects that the data show, by forward-backward selection.

    Drift noise can replace any slow effects on the mean, even two at once. It is therefore excluded at first, then
    allowed beside the selected effects, and only then tested in their place.

    Parameters
    ----------
    start
        The model without an effect, its noise fitted.
    contest
        Everything that competes.
    alpha
        Chance that any of the tests fires without a gap.
    earlier
        A selection from another contest. If its start is the same model, its first scores are used again.
    """
    candidates = contest.hypotheses
    steady = [h for h in candidates if not h.effect.drifts]
    tests = sum(not h.again for h in candidates)
    level = alpha / max(tests, 1)
    model, joint, noise = jointly_fitted(start)
    known = {s.hypothesis.key: s for s in earlier.first} if earlier is not None and earlier.start is start else {}
    first = tuple(_candidate_scores(model, contest, candidates, known, set()).values())
    bare = ChosenModel(model, joint, noise, (), tests, first, start)
    chosen = extended(bare, contest, level, steady, later=[h for h in candidates if h.effect.drifts])
    if _undeclared_noise_is_slow(chosen.model) and not contest.pace.ends():
        quiet = _with_white_noise(model)
        scores = tuple(_candidate_scores(quiet, contest, steady, {}, None).values())
        chosen = _better_by_sensor(
            chosen, extended(replace(bare, model=quiet, first=scores, start=quiet), contest, level, steady), contest
        )
    if not (has_drift_noise(chosen) or _drift_is_best(first, level)) or contest.pace.ends():
        return chosen
    return _better_by_sensor(chosen, extended(bare, contest, level, candidates), contest)


def _undeclared_noise_is_slow(model: Model) -> bool:
    """Whether undeclared noise has most power at low frequencies, and no re-estimated trajectory causes it."""
    views = model.setting.views
    if any(view.att_sd > 0.0 for view in views):
        return False
    powers = [n.power for a, n in enumerate(model.noise) if not is_declared(views[a // 3]) and not views[a // 3].first]
    return any(power[0] > prices.SLOW_POWER_RATIO * power[-1] for power in powers)


def _with_white_noise(model: Model) -> Model:
    """The model with white noise on every axis whose noise is not declared.

    An offset is in one bin of the transform and a slow effect in a few. Noise that is fitted earlier absorbs them.
    """
    start = starting_noise(model.setting)
    views = model.setting.views
    return with_noise(model, tuple(n if is_declared(views[a // 3]) else start[a] for a, n in enumerate(model.noise)))


def _better_by_sensor(chosen: ChosenModel, other: ChosenModel, contest: Contest) -> ChosenModel:
    """`other` if its objective is materially better: by sensor, unless shared effects or the reference tie them.

    Drift noise replaces an effect on the mean only if it gains more, by at least what drift noise needs to enter.
    """
    if any(t.effect.shared for c in (chosen, other) for t in c.model.terms) or chosen.model.ridge is not None:
        worth = max(prices.SECOND_ORDER_SHARE * largest_gain(chosen, contest), _entry_of_drifts(other, contest))
        return other if objective(other) < objective(chosen) - worth else chosen
    skirts = {
        t.hypothesis.effect.sensor
        for t in other.model.noise_terms
        if t.hypothesis.effect.drifts and is_line_unsteadiness(t, other.model)
    }
    named = [t.hypothesis for t in chosen.model.members if not t.hypothesis.effect.nameless]
    gains, taken = marginal_gains(chosen.model, contest), set()
    part = prices.FLIGHT_SECOND_ORDER_SHARE if has_learned_spectrum(chosen.model) else prices.SECOND_ORDER_SHARE
    for sensor in {view.sensor for view in chosen.model.setting.views} - skirts:
        worth = part * max((gains[h.key][0] for h in named if h.effect.sensor is sensor), default=0.0)
        if any(h.effect.sensor is sensor for h in named):
            worth = max(worth, _entry_of_drifts(other, contest, sensor))
        if _sensor_objective(other, sensor) < _sensor_objective(chosen, sensor) - worth:
            taken.add(sensor)
    return _merged_by_sensor(chosen, other, taken) if taken else chosen


def _entry_of_drifts(chosen: ChosenModel, contest: Contest, sensor: Sensor | None = None) -> float:
    """Gain that the drift noise of a model needs to enter one; of `sensor` only, if given."""
    drifts = (t.hypothesis for t in chosen.model.noise_terms if t.hypothesis.effect.drifts)
    return max((contest.thresholds.to_enter(h) for h in drifts if sensor in (None, h.effect.sensor)), default=0.0)


def _sensor_objective(chosen: ChosenModel, sensor: Sensor) -> float:
    """The part of :func:`objective` of one sensor."""
    deviance = sum(level for (own, _), level in chosen.noise.deviance.items() if own is sensor)
    return deviance + total_price(s for s in chosen.scores if s.hypothesis.effect.sensor is sensor)


def _merged_by_sensor(chosen: ChosenModel, other: ChosenModel, taken: Collection[Sensor]) -> ChosenModel:
    """The effects of `other` on the sensors `taken`, and those of `chosen` on the rest."""
    others = [s for s in chosen.scores if s.hypothesis.effect.sensor not in taken]
    scores = (*others, *(s for s in other.scores if s.hypothesis.effect.sensor in taken))
    pair = (chosen.model, other.model)
    views = chosen.model.setting.views
    own = [pair[views[a // 3].sensor in taken] for a in range(chosen.model.setting.axes)]
    mixed = replace(
        chosen.model,
        terms=tuple(t for m in pair for t in m.terms if _is_on(t, taken) is (m is other.model)),
        noise_terms=tuple(t for m in pair for t in m.noise_terms if _is_on(t, taken) is (m is other.model)),
        noise=tuple(m.noise[a] for a, m in enumerate(own)),
        weight=tuple(m.weight[a] for a, m in enumerate(own)),
    )
    model, joint, fit = jointly_fitted(with_residual(mixed))
    return ChosenModel(model, joint, fit, scores, chosen.tests, chosen.first, chosen.start)


def _is_on(term: Term | NoiseTerm, sensors: Collection[Sensor]) -> bool:
    return term.hypothesis.effect.sensor in sensors


def _drift_is_best(first: Sequence[ContestScore], level: float) -> bool:
    """Whether drift noise is the best single effect on some sensor."""
    best: dict[Sensor, ContestScore] = {}
    for score in (s for s in first if s.p < level):
        sensor = score.hypothesis.effect.sensor
        if sensor not in best or score.delta > best[sensor].delta:
            best[sensor] = score
    return any(score.hypothesis.effect.drifts for score in best.values())


def extended(
    chosen: ChosenModel,
    contest: Contest,
    level: float,
    candidates: Sequence[Hypothesis] | None = None,
    later: Sequence[Hypothesis] = (),
) -> ChosenModel:
    """The model with every further effect that is significant at `level` a test and worth its price.

    `candidates` compete first (None: the whole contest), and those of `later` once no other candidate qualifies.
    """
    candidates = contest.hypotheses if candidates is None else candidates
    model, joined = chosen.model, list(chosen.scores)
    gains: Gains = {}
    if joined:  # what was exchanged may have made others superfluous
        model, joined, gains = pruned(model, contest, joined, level)
    known = {} if joined else {s.hypothesis.key: s for s in chosen.first}
    scores = _candidate_scores(model, contest, candidates, known, None if joined else set())
    step = 0
    while step < prices.MOST_IN_A_ROW + prices.MOST_EVENTS:
        full = step >= prices.MOST_IN_A_ROW
        # Until errors of other sensors enter, a postponed event would distort the noise of its own sensor.
        still = {key: s for key, s in scores.items() if s.hypothesis.effect.jumps} if full else scores
        best, trial = _best_candidate(still, level, gains, contest, model)
        if best is None and later and not contest.pace.ends():
            candidates, later = (*candidates, *later), ()
            scores = _candidate_scores(model, contest, candidates, scores if joined else known | scores, set())
            continue
        if best is None or contest.pace.ends():
            break
        contest.pace.advance()
        joined.append(best)
        if trial is None:
            began = contest.pace.now
            trial = locally_fitted(with_score(model, best), best.hypothesis)
            contest.pace.reserve(len(joined), contest.pace.now - began)
        model, joined, gains = pruned(trial, contest, joined, level)
        changed = {view.sensor for view in trial.setting.views if best.hypothesis.touches(view)}
        scores = _candidate_scores(model, contest, candidates, scores, changed)
        step += 1
    model, joined = _without_second_order(model, joined, gains)
    model, joint, noise = jointly_fitted(model)
    return replace(chosen, model=model, joint=joint, noise=noise, scores=tuple(joined))


def _candidate_scores(
    model: Model,
    contest: Contest,
    candidates: Sequence[Hypothesis],
    old: dict[Key, ContestScore],
    changed: set[Sensor] | None,
) -> dict[Key, ContestScore]:
    """Scores of all candidates that are not in the model; those of unchanged sensors are kept from `old`."""
    there = [term.hypothesis for term in model.members]
    taken = {hypothesis.key for hypothesis in there}
    beside = Projection(model)
    scores, stale = {}, []
    for hypothesis in candidates:
        if hypothesis.key in taken or hypothesis.is_covered_by(there):
            continue
        if hypothesis.is_unobservable_beside(there, model.setting.views):
            continue
        if hypothesis.before is not None and hypothesis.before not in taken:
            continue
        moved = changed is None or hypothesis.effect.shared or hypothesis.effect.sensor in changed
        known = old.get(hypothesis.key)
        if moved or known is None:
            stale.append(hypothesis)
        else:
            scores[hypothesis.key] = known
    return {**scores, **{s.hypothesis.key: s for s in contest.scores(stale, beside)}}


def _best_candidate(
    scores: dict[Key, ContestScore], level: float, gains: Gains, contest: Contest, model: Model
) -> tuple[ContestScore | None, Model | None]:
    """The best significant score that is refined and not of second order, and its fitted model, if any.

    Drift noise and undeclared noise may have absorbed a slow mean, so the gain of a mean beside them is not compared
    with the second order.
    """
    wandering = any(t.hypothesis.effect.drifts for t in model.noise_terms)
    undeclared = {view.sensor for view in model.setting.views if not is_declared(view)}

    def least(score: ContestScore) -> float:
        hypothesis = score.hypothesis
        absorbed = not hypothesis.periodic and (wandering or hypothesis.effect.sensor in undeclared)
        part = 0.0 if absorbed else prices.ENTRY_SHARE
        return max(part * _second_order_limit(hypothesis, model, gains), contest.thresholds.to_enter(hypothesis))

    def may_be_hidden(score: ContestScore) -> bool:
        return score.hypothesis.effect.sensor not in judged and _is_hidden_by_noise(score, model)

    beside: Projection | None = None
    judged: set[Sensor] = set()
    while True:
        good = [s for s in scores.values() if s.p < level and (s.gain >= least(s) or may_be_hidden(s))]
        if not good:
            return None, None
        ranked = sorted(good, key=lambda s: -s.delta)
        most = prices.CANDIDATES_FITTED
        place, unsure = next(((k, s) for k, s in enumerate(ranked) if not s.sure), (most, None))
        if unsure is None or place >= most:
            found = _best_after_refit(ranked, least, model)
            if found[0] is not None:
                return found
            judged.add(ranked[0].hypothesis.effect.sensor)  # what the noise hides there is not worth enough
            continue
        beside = beside or Projection(model)
        scores[unsure.hypothesis.key] = contest.score(unsure.hypothesis, beside)


def _is_hidden_by_noise(score: ContestScore, model: Model) -> bool:
    """Whether the fitted noise holds so much of an effect that its gain says little of its worth."""
    size = sum(3 * view.count for view in model.setting.views if score.hypothesis.touches(view))
    return score.gain >= prices.HIDING_GAIN * size


def _best_after_refit(
    ranked: Sequence[ContestScore], least_gain: Callable[[ContestScore], float], model: Model
) -> tuple[ContestScore | None, Model | None]:
    """The best score; if noise hides effects of its sensor, the best of several after the noise was fitted with each.

    An unexplained large gap is part of the noise. Beside a bias of a hundred standard deviations a misalignment gains
    next to nothing, and the bias itself no more than the number of samples. None if none then gains enough.
    """
    best = ranked[0]
    own = [s for s in ranked if s.hypothesis.effect.sensor is best.hypothesis.effect.sensor]
    hidden = {s.hypothesis.key for s in own if _is_hidden_by_noise(s, model)}
    if not hidden:
        return best, None
    rivals: dict[str, ContestScore] = {}
    for score in own:
        if score.delta > prices.RIVAL_SHARE * best.delta or score.hypothesis.key in hidden:
            rivals.setdefault(score.hypothesis.effect.id, score)
    tried = list(rivals.values())[: prices.RIVALS_TRIED]
    touched = {v.sensor for v in model.setting.views if any(s.hypothesis.touches(v) for s in tried)}
    near = sorted(coupled_sensors(model, touched))
    before = sum(noise_fitted(model, near).deviance.values())
    worth, least = None, math.inf
    for score in tried:
        trial = locally_fitted(with_score(model, score), score.hypothesis)
        left = sum(noise_fitted(trial, near).deviance.values())
        if max(score.gain, before - left) < least_gain(score):
            continue
        level = left + score.price  # of -2 log L
        if worth is None or level < least:
            worth, least = (score, trial), level
    return (None, None) if worth is None else worth


def _second_order_limit(hypothesis: Hypothesis, model: Model, gains: Gains) -> float:
    """Gain below which an effect is of second order to the largest one on its sensor, or to a far larger one elsewhere.

    Vibration has no second-order terms that follow temperature or rotation: only a mean can be one of a mean.
    """
    near = [
        gains[term.hypothesis.key][0]
        for term in model.members
        if term.hypothesis.key in gains and _may_be_second_order(hypothesis, term.hypothesis)
    ]
    far = max((gain for gain, _, _ in gains.values()), default=0.0)
    part = prices.FLIGHT_SECOND_ORDER_SHARE if has_learned_spectrum(model) else prices.SECOND_ORDER_SHARE
    return max(part * max(near, default=0.0), prices.OTHER_SENSOR_SHARE * far)


def _may_be_second_order(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether an effect could be of second order to another.

    A mean is not one of stationary noise, nor is an effect on some units one of an effect common to more units.
    """
    effect, large = one.effect, other.effect
    if not (effect.sensor is large.sensor or effect.shared or large.shared):
        return False
    if effect.sensor is large.sensor and set(one.instances) < set(other.instances):
        return False
    steady = isinstance(large, NoiseEffect) and not large.drifts
    return not (steady and isinstance(effect, MeanEffect) and not effect.tonal)


def has_learned_spectrum(model: Model) -> bool:
    """Whether a noise spectrum was learned from other recordings, which always contain small true structure."""
    return any(view.density is not None for view in model.setting.views)


def pruned(
    model: Model, contest: Contest, joined: list[ContestScore], level: float
) -> tuple[Model, list[ContestScore], Gains]:
    """The model without terms that are no longer significant (Wald on the mean, likelihood ratio on the noise)."""
    while True:
        gains = marginal_gains(model, contest)
        chances = {key: min(1.0, grid * float(chdtrc(df, gain))) for key, (gain, df, grid) in gains.items()}
        weak = [(key, p) for key, p in chances.items() if p > level]
        if not weak or len(joined) < 2:
            return model, joined, gains
        key = max(weak, key=lambda pair: pair[1])[0]
        gone = member_of(model, key).hypothesis
        joined = [s for s in joined if s.hypothesis.key != key]
        model = locally_fitted(without_effect(model, key), gone)


def refitted_without(chosen: ChosenModel, keys: Collection[Key]) -> ChosenModel:
    """The model without the effects of those keys, fitted again."""
    model = chosen.model
    for key in keys:
        model = without_effect(model, key)
    model, joint, noise = jointly_fitted(model)
    left = tuple(s for s in chosen.scores if s.hypothesis.key not in keys)
    return replace(chosen, model=model, joint=joint, noise=noise, scores=left)


def _without_second_order(model: Model, joined: list[ContestScore], gains: Gains) -> tuple[Model, list[ContestScore]]:
    small = [
        k
        for k, (gain, _, _) in gains.items()
        if gain < _second_order_limit(member_of(model, k).hypothesis, model, gains)
    ]
    for key in small:
        model = without_effect(model, key)
    return model, [s for s in joined if s.hypothesis.key not in small]


def objective(chosen: ChosenModel) -> float:
    """``-2 log L`` with the price of every effect and of their number; smaller is better."""
    return sum(chosen.noise.deviance.values()) + total_price(chosen.scores)


def total_price(scores: Iterable[ContestScore]) -> float:
    """Price of several effects together."""
    return sum(s.price + prices.EFFECT_COUNT_PRICE for s in scores)


def has_drift_noise(chosen: ChosenModel) -> bool:
    """Whether the model contains drift noise."""
    return any(t.hypothesis.effect.drifts for t in chosen.model.noise_terms)
