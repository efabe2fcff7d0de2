"""What each effect of a model is worth: its share, its rivals, and how probable it is.

An effect is compared with every other hypothesis in its own place, beside all the other effects. `kappa` is the part of
its fitted energy that a rival can imitate; what separates them is ``gain (1 - kappa)``.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.base import NoiseEffect
from mavcal.calib.gap.model.hypotheses import Hypothesis, HypothesisColumns, Key, columns_of
from mavcal.calib.gap.model.joint import Model, NoiseTerm, Term, misfit, refined
from mavcal.calib.gap.model.noise_fit import refitted, without_term
from mavcal.calib.gap.schema import Rival
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
    last_gains,
    objective,
    of_flights,
    restored,
    select,
    with_score,
    without,
)
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_LESS = 0.1
"""Part of a second order that an effect of fewer numbers may lose to take another's place: a model is never exact."""
_WANDERS = 100
"""Numbers that noise which wanders counts for."""
_SECOND = 8.0
"""By how much a second order of an effect counts, beside noise learned from flights, in twice a log-probability."""
TEMPERATURE = 2.0
"""By which differences of penalised evidence are flattened into probabilities."""
_STANDS_IN = 0.8
"""Part of its probability that noise that wanders keeps: it takes the place of anything slow."""
_NEAR = 12.0
_SAME = 0.98
_FAR = 40.0
"""Rivals are listed within `_NEAR`, or within 2 % of the evidence, but not beyond `_FAR`; what pays for fitting
anything of its kind (wandering noise) as far beyond as it pays."""
_EVEN = 0.5
"""Probability of what has no name from which on it is likelier than every name together."""
_CLEARLY = 1.0
"""Penalised evidence by which an exchange must be better."""
_ROUNDS = 3
"""Exchanges at most."""
_TRIED = 2
"""The best of them that are tried before all are given up."""
_TOGETHER = 0.1
"""Part of the largest gain by which events that were tried first must be better: a jump at an end is an offset."""


@dataclass(frozen=True, eq=False)
class Attribution:
    """What one effect gains as the last one, its share of all gains, rivals, and probability."""

    key: Key
    gain: float
    df: int
    share: float
    probability: float
    unknown_probability: float
    rivals: tuple[Rival, ...]
    shape: str = ""
    """The likeliest of what has no name in its place."""

    @property
    def doubted(self) -> bool:
        """Whether something without a name is likelier than every name."""
        return self.unknown_probability > _EVEN


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
    """A model in which no effect has a better one in its place, and what its effects are worth, by their places."""

    chosen: ChosenModel
    attributions: tuple[Attribution, ...]
    places: Mapping[Key, Place]


def settled(chosen: ChosenModel, contest: Contest, alpha: float, before: SettledModel | None = None) -> SettledModel:
    """A model in which no effect has a better one in its place, and what its effects are worth.

    Forward steps take the best single effect first: one that stands for two of them, noise for a mean. Each effect is
    therefore compared with all others once the model is complete. After an exchange that is those of its sensors; once
    none is better, all.

    Parameters
    ----------
    chosen, contest, alpha
        A model, what competes for the places in it, and the chance of an effect where there is none.
    before
        What was found of another contest; of the same model only hypotheses that were not in it are looked at.
    """
    level = alpha / max(chosen.tests, 1)
    places = _places(chosen, contest, before.places if before is not None and before.chosen is chosen else {})
    fresh, exchanges = True, 0
    while True:
        other = _improved(chosen, places, level, contest) if exchanges < _ROUNDS else None
        if other is None and fresh:
            return SettledModel(chosen, _attributed(chosen, contest, places), places)
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
    """The places of the effects of a model, `but` for some; of those that are `known` with what is not yet."""
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
    for worth, key, score in _exchanges(chosen, places, level, contest)[:_TRIED]:
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
    Of a magnet that is put on and taken off neither jump alone says much: events are tried by themselves first as well.
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
    if events is not None and objective(events) < objective(best) - _TOGETHER * largest_gain(chosen, contest):
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
            gain = -_behind(place.own, score, _freedom_of(chosen, key), second)
            if score.p < level and score.gain >= contest.floors.joining(score.hypothesis) and gain > _CLEARLY:
                found.append((gain, max(second, prices.SECOND_ORDER_SHARE * place.own), key, score))
    return [exchange[1:] for exchange in sorted(found, key=lambda exchange: -exchange[0])]


def second_order(chosen: ChosenModel, own: float) -> float:
    """What of an effect's evidence is a second order of it; nothing but beside noise learned from flights."""
    return prices.FLIGHT_SECOND_ORDER_SHARE * max(own, 0.0) if of_flights(chosen.model) else 0.0


def _freedom_of(chosen: ChosenModel, key: Key) -> int:
    return next((_freedom(score) for score in chosen.scores if score.hypothesis.key == key), 0)


def _freedom(score: ContestScore) -> int:
    """Numbers of an effect; noise that wanders takes the place of anything slow, and has more than any other."""
    return score.df + (_WANDERS if score.hypothesis.effect.drifts else 0)


def _behind(own: float, score: ContestScore, freedom: int, second: float) -> float:
    """By how much evidence a rival stands behind an effect; of what is a `second` order, more freedom explains more."""
    more = _freedom(score) - freedom if freedom else 0
    return own - score.delta + (second if more > 0 else -_LESS * second if more < 0 else 0.0)


def _attributed(chosen: ChosenModel, contest: Contest, places: Mapping[Key, Place]) -> tuple[Attribution, ...]:
    """One attribution for each effect of a model, largest share first."""
    model = chosen.model
    last = last_gains(model, contest)
    first = {s.hypothesis.key: s.gain for s in chosen.first}
    joined = {s.hypothesis.key: s.gain for s in chosen.scores}
    worth = {key: 0.5 * (gain + max(first.get(key, joined.get(key, gain)), 0.0)) for key, (gain, _, _) in last.items()}
    total = sum(worth.values()) or 1.0
    found = []
    for term in model.members:
        key = term.hypothesis.key
        place = places[key]
        second = second_order(chosen, place.own)
        rivals, probability, unknown = _judged(term.hypothesis, place, _freedom_of(chosen, key), second)
        share = worth[key] / total
        gain, df, _ = last[key]
        found.append(Attribution(key, gain, df, share, probability, unknown, rivals, _likeliest_shape(place.others)))
    return tuple(sorted(found, key=lambda a: -a.share))


def _likeliest_shape(others: Sequence[Alternative]) -> str:
    shapes = [a.score for a in others if a.score.hypothesis.effect.nameless]
    return max(shapes, key=lambda s: s.delta).hypothesis.effect.excited_by if shapes else ""


def _place(chosen: ChosenModel, contest: Contest, term: Term | NoiseTerm, known: Sequence[Alternative]) -> Place:
    """Every other hypothesis instead of `term`, of which some are `known`."""
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
    scores = [_less(noise_score(rival, bare), stiff) for rival in rivals if isinstance(rival.effect, NoiseEffect)]
    coarse = contest.scores([rival for rival in rivals if not isinstance(rival.effect, NoiseEffect)], beside)
    scores += contest.assured(coarse, beside, own_delta - _FAR)
    for score in scores:
        near = own_delta - score.delta < _FAR + price_of_kind(score.hypothesis.effect)
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
    columns = contest.columns(score.hypothesis, score.theta, beside.model)
    gram, _, before = beside.projected(columns)
    basis = existing(gram, before)
    taken = basis.T @ (beside.cross(columns, own) @ term.beta)
    return float(np.clip((taken @ taken) / max(energy, 1e-300), 0.0, 1.0))


def _judged(own: Hypothesis, place: Place, freedom: int, second: float) -> tuple[tuple[Rival, ...], float, float]:
    """Rivals that these data cannot tell apart, and the probabilities of the effect and of the unknown."""
    rivals = []
    same, weights, unknown = [0.0], [-math.inf], [-math.inf]
    for other in place.others:
        if other.score.p >= 1.0:
            continue  # noise that the instances named do not show is no rival
        delta = _behind(place.own, other.score, freedom, second)
        is_unknown = other.score.hypothesis.effect.nameless
        weight = -delta / (2.0 * max(TEMPERATURE, second / _SECOND))
        if other.score.hypothesis.effect.id == own.effect.id and other.score.hypothesis.instances == own.instances:
            same.append(weight)  # the same name in another form
        else:
            (unknown if is_unknown else weights).append(weight)
        near = max(_NEAR, min((1.0 - _SAME) * place.own, _FAR)) + price_of_kind(other.score.hypothesis.effect)
        if not is_unknown and other.score.hypothesis.effect.id != own.effect.id and delta < near:
            rivals.append(Rival(other.score.hypothesis.effect.id, other.kappa, delta, own.effect.fix))
    best: dict[str, Rival] = {}
    for rival in sorted(rivals, key=lambda r: r.delta):
        best.setdefault(rival.id, rival)
    stranger = max(unknown)  # the others are parts of it, or it in another guise
    total = float(np.logaddexp.reduce([*same, *weights, stranger]))
    right = math.exp(float(np.logaddexp.reduce(same)) - total)
    wanders = own.effect.drifts
    return tuple(best.values()), right * (_STANDS_IN if wanders else 1.0), math.exp(stranger - total)
