"""Exchanges of one effect of a model for another that stands better in its place.

Forward steps take the best single effect first: one that stands for two of them, noise for a mean. Each effect is
therefore compared with every other hypothesis in its own place, beside all the other effects. `kappa` is the part of
its fitted energy that a rival can imitate; what separates them is ``gain (1 - kappa)``.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavcal.calib.gap.effects.base import NoiseEffect
from mavcal.calib.gap.model.hypotheses import Hypothesis, HypothesisColumns, Key, columns_of
from mavcal.calib.gap.model.joint import Model, NoiseTerm, Term
from mavcal.calib.gap.model.noise_fit import refitted, without_term
from mavcal.calib.gap.model.refinement import misfit, refined
from mavcal.calib.gap.search import prices
from mavcal.calib.gap.search.contest import Contest, ContestScore, exactly, fixed_score, noise_score, priced
from mavcal.calib.gap.search.evidence import price_of_kind
from mavcal.calib.gap.search.filtered_noise import filter_evidence
from mavcal.calib.gap.search.projection import Beside, existing
from mavcal.calib.gap.search.selection import (
    ChosenModel,
    fitted,
    grown,
    largest_gain,
    objective,
    of_flights,
    restored,
    select,
    with_score,
    without,
)
from mavcal.calib.recording import Sensor


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another hypothesis instead of an effect; `kappa` is 0 where it is too far behind to be listed."""

    score: ContestScore
    kappa: float


@dataclass(frozen=True, eq=False)
class Place:
    """Every other hypothesis instead of one effect, and the penalised evidence of its `own`."""

    others: tuple[Alternative, ...]
    own: float


@dataclass(frozen=True, eq=False)
class SettledModel:
    """A model in which no effect has a better one in its place, and the places of its effects."""

    chosen: ChosenModel
    places: Mapping[Key, Place]


def settled(chosen: ChosenModel, contest: Contest, alpha: float, before: SettledModel | None = None) -> SettledModel:
    """A model in which no effect has a better one in its place.

    Each effect is compared with all others once the model is complete. After an exchange only the effects of its
    sensors are compared again; once none is better, all are.

    Parameters
    ----------
    chosen, contest, alpha
        A model, what competes for the places in it, and the chance of an effect where there is none.
    before
        The result of another contest. For the same model only hypotheses that were not in it are compared; with no time
        left, what was found there is taken for a model with fewer effects too.
    """
    level = alpha / max(chosen.tests, 1)
    members = {term.hypothesis.key for term in chosen.model.members}
    if before is not None and members <= before.places.keys() and contest.pace.ends():
        return SettledModel(chosen, {key: before.places[key] for key in members})
    places = _places(chosen, contest, before.places if before is not None and before.chosen is chosen else {})
    fresh, exchanges = True, 0
    while True:
        other = _improved(chosen, places, level, contest) if exchanges < prices.MOST_EXCHANGES else None
        if other is None and (fresh or contest.pace.ends()):
            return SettledModel(chosen, places)
        if other is None:
            places, fresh = _places(chosen, contest, {}), True
            continue
        elsewhere = _elsewhere(chosen.model, other.model)
        still = {key: place for key, place in places.items() if key in elsewhere}
        chosen, exchanges, fresh = other, exchanges + 1, not still
        places = {**still, **_places(chosen, contest, {}, still)}


def _places(
    chosen: ChosenModel, contest: Contest, known: Mapping[Key, Place], but: Collection[Key] = ()
) -> dict[Key, Place]:
    """The places of the effects of a model, except `but`; a place that is `known` gets only the missing rivals."""
    keys = {term.hypothesis.key: term for term in chosen.model.members}
    return {
        key: _place(chosen, contest, term, known[key].others if key in known else ())
        for key, term in keys.items()
        if key not in but
    }


def _elsewhere(model: Model, other: Model) -> frozenset[Key]:
    """Effects of both models whose sensor neither has an effect on that the other has not."""
    own, new = ({t.hypothesis.key: t.hypothesis.effect for t in m.members} for m in (model, other))
    changed = [(own | new)[key] for key in own.keys() ^ new.keys()]
    sensors = set(Sensor) if any(e.shared for e in changed) else {e.sensor for e in changed}
    return frozenset(key for key in own.keys() & new.keys() if not own[key].shared and own[key].sensor not in sensors)


def _improved(chosen: ChosenModel, places: Mapping[Key, Place], level: float, contest: Contest) -> ChosenModel | None:
    """The model after the best exchange that keeps what it promised once everything was fitted again; None: none does.

    Every exchange is judged beside the others as they are fitted to that moment, and they may have leant on what goes.
    """
    for worth, key, score in _exchanges(chosen, places, level, contest)[: prices.EXCHANGES_TRIED]:
        if contest.pace.ends():
            break
        other = grown(_exchanged(chosen, key, score), contest, level)
        if objective(other) < objective(chosen) + worth:
            return other
    return None


def _exchanged(chosen: ChosenModel, old: Key, new: ContestScore) -> ChosenModel:
    model, joint, noise = fitted(with_score(without(chosen.model, old), new))
    scores = (*(s for s in chosen.scores if s.hypothesis.key != old), new)
    return replace(chosen, model=model, joint=joint, noise=noise, scores=scores)


def steadily(chosen: ChosenModel, start: Model, contest: Contest, alpha: float) -> ChosenModel:
    """The model, or a better one without noise that wanders, whose effects were exchanged until none has a better one.

    Forward steps may stop where two of the wrong effects stand; wandering noise then beats them, and not the right two.
    A magnet that is put on and taken off makes two jumps. Neither alone says much, so events are also tried first.
    """
    drifting = {t.hypothesis.effect.sensor for t in chosen.model.noise_terms if t.hypothesis.effect.drifts}
    if not drifting or {Sensor.ACCEL, Sensor.MAG} <= drifting:  # both: it is the reference, which comes next
        return chosen
    if contest.pace.ends():
        return chosen
    steady = [h for h in contest.hypotheses if not h.effect.drifts]
    level = alpha * len(steady) / max(len(contest.hypotheses), 1)
    without_drift = contest.among(steady)
    other = settled(select(start, without_drift, level), without_drift, level).chosen
    best = other if objective(other) < objective(chosen) else chosen
    jumps = [h for h in steady if h.effect.jumps and h.effect.sensor in drifting]
    events = _events_first(start, jumps, without_drift, level)
    if events is not None and objective(events) < objective(best) - prices.EVENT_GAIN_SHARE * largest_gain(
        chosen, contest
    ):
        best = events
    return replace(best, tests=chosen.tests, first=chosen.first)


def _events_first(start: Model, jumps: Sequence[Hypothesis], contest: Contest, alpha: float) -> ChosenModel | None:
    """A model that begins with `jumps` alone; None where there are no two of them."""
    tests = sum(not h.again for h in contest.hypotheses)
    events = select(start, contest.among(jumps), alpha * len(jumps) / max(len(contest.hypotheses), 1))
    if len(events.scores) < 2:
        return None
    begun = grown(replace(events, tests=tests), contest, alpha / max(tests, 1))
    return settled(begun, contest, alpha).chosen


def _exchanges(
    chosen: ChosenModel, places: Mapping[Key, Place], level: float, contest: Contest
) -> list[tuple[float, Key, ContestScore]]:
    """Exchanges of one effect for another that gain, best first, and by how much the model may seem worse after each.

    Beside noise that was learned from flights a hundredth of an effect is a second order of it: for that much the one
    with fewer numbers is believed.
    """
    found = []
    for key, place in places.items():
        second = second_order(chosen, place.own)
        for score in (other.score for other in place.others):
            gain = -behind(place.own, score, freedom_of(chosen, key), second)
            if score.p < level and score.gain >= contest.thresholds.joining(score.hypothesis) and gain > 0.0:
                found.append((gain, max(second, prices.SECOND_ORDER_SHARE * place.own), key, score))
    return [exchange[1:] for exchange in sorted(found, key=lambda exchange: -exchange[0])]


def second_order(chosen: ChosenModel, own: float) -> float:
    """Part of an effect's evidence that is its second order; zero unless the noise was learned from flights."""
    return prices.FLIGHT_SECOND_ORDER_SHARE * max(own, 0.0) if of_flights(chosen.model) else 0.0


Freedom = tuple[bool, int]
"""Whether an effect is noise that wanders, and its degrees of freedom. In this order: such noise takes the place of
anything slow, and is freer than any number of amplitudes.
"""


def freedom_of(chosen: ChosenModel, key: Key) -> Freedom | None:
    """The freedom of an effect of the model; None for one that did not compete."""
    return next((_freedom(score) for score in chosen.scores if score.hypothesis.key == key), None)


def _freedom(score: ContestScore) -> Freedom:
    return score.hypothesis.effect.drifts, score.df


def behind(own: float, score: ContestScore, freedom: Freedom | None, second: float) -> float:
    """Evidence by which a rival is behind an effect; the freer of the two explains more of a `second` order."""
    if freedom is None or _freedom(score) == freedom:
        return own - score.delta
    return own - score.delta + (second if _freedom(score) > freedom else -prices.SECOND_ORDER_LOSS * second)


def _place(chosen: ChosenModel, contest: Contest, term: Term | NoiseTerm, known: Sequence[Alternative]) -> Place:
    """Every other hypothesis instead of `term`; some are `known` already."""
    model = chosen.model
    key = term.hypothesis.key
    if isinstance(term, NoiseTerm):
        bare = refitted(without_term(model, term), [term.hypothesis.effect.sensor]).model
        beside, own_columns, energy, stiff = Beside(bare), None, 0.0, 0.0
        own = noise_score(term.hypothesis, bare)
        own_gain, own_delta = own.gain, own.delta
    else:
        i = model.terms.index(term)
        bare, _ = refined(without(model, key))
        beside = Beside(restored(model, i), omit=(i,))
        own_columns = columns_of(term.hypothesis, term.theta, model.setting.views, model.setting.frames)
        gram, _, _ = beside.projected(own_columns)
        energy = float(term.beta @ gram @ term.beta)
        own = _own_score(chosen, term, own_columns, beside)
        own_gain, own_delta = own.gain, own.delta
        # What the others would take over along their tangents, and do not: no noise gains it beside them.
        stiff = max(misfit(bare) - misfit(model) - own_gain, 0.0)
    taken = {t.hypothesis.key for t in model.members} | {one.score.hypothesis.key for one in known}
    found = list(known)
    rivals = [
        rival
        for rival in contest.hypotheses
        if not (rival.key in taken or rival.again) and _meets(rival, term.hypothesis, model)
    ]
    likely = [rival for rival in rivals if _is_near(rival, term.hypothesis)]  # never left out, or nothing is probable
    far = [rival for rival in rivals if not _is_near(rival, term.hypothesis)]
    scores = [_less(noise_score(rival, bare), stiff) for rival in likely if isinstance(rival.effect, NoiseEffect)]
    for rival in far:
        if isinstance(rival.effect, NoiseEffect) and not contest.pace.ends():
            scores.append(_less(noise_score(rival, bare), stiff))
    means = [rival for rival in likely if not isinstance(rival.effect, NoiseEffect)]
    coarse = [contest.score(rival, beside, refine=False) for rival in means]
    coarse += contest.scores([rival for rival in far if not isinstance(rival.effect, NoiseEffect)], beside)
    scores += contest.assured(coarse, beside, own_delta - prices.RIVAL_REACH)
    for score in scores:
        near = own_delta - score.delta < prices.RIVAL_REACH + price_of_kind(score.hypothesis.effect)
        kappa = _imitated(contest, beside, own_columns, term, score, energy=energy, own_gain=own_gain) if near else 0.0
        found.append(Alternative(score, kappa))
    return Place(tuple(found), own_delta)


def _less(score: ContestScore, gain: float) -> ContestScore:
    return replace(score, gain=score.gain - gain, delta=score.delta - gain)


def _own_score(chosen: ChosenModel, term: Term, columns: HypothesisColumns, beside: Beside) -> ContestScore:
    if term.effect.fixed:
        gain = beside.fixed_gain(columns) + filter_evidence(term.hypothesis, term.theta, beside.model)
        return fixed_score(term.hypothesis, term.theta, gain)
    found = beside.gain(columns)
    if term.effect.exact is not None:
        gain, beta = exactly(term.hypothesis, term.beta, beside)
        found = replace(found, gain=gain, beta=beta, evidence=gain - found.price)
    grid = next((s.grid for s in chosen.scores if s.hypothesis.key == term.hypothesis.key), 1)
    return priced(term.hypothesis, term.theta, found, grid)


def _is_near(rival: Hypothesis, own: Hypothesis) -> bool:
    """Whether it is the same effect elsewhere or in another form, or one that is known to imitate it."""
    return rival.effect.id == own.effect.id or rival.effect.id in own.effect.rivals


def _meets(rival: Hypothesis, own: Hypothesis, model: Model) -> bool:
    return any(rival.touches(view) and own.touches(view) for view in model.setting.views)


def _imitated(
    contest: Contest,
    beside: Beside,
    own: HypothesisColumns | None,
    term: Term | NoiseTerm,
    score: ContestScore,
    *,
    energy: float,
    own_gain: float,
) -> float:
    """The part of the effect's energy that the rival's columns can take."""
    if own is None or isinstance(score.hypothesis.effect, NoiseEffect) or score.df == 0:
        return float(np.clip(score.gain / max(own_gain, 1e-12), 0.0, 1.0))
    assert isinstance(term, Term)
    columns = contest.columns.of(score.hypothesis, score.theta, beside.model.setting)
    gram, _, before = beside.projected(columns)
    basis = existing(gram, before)
    taken = basis.T @ (beside.cross(columns, own) @ term.beta)
    return float(np.clip((taken @ taken) / max(energy, 1e-300), 0.0, 1.0))
