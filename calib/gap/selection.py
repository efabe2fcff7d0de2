"""Forward-backward selection: the best hypothesis that is significant and worth its price joins, until none is.

After every step all parameters are fitted together, the noise anew, and what has become superfluous leaves again.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from calib.gap.contest import Beside, Contest, Score
from calib.gap.effects.base import MeanEffect, NoiseEffect
from calib.gap.effects.noise import DRIFTS
from calib.gap.hypotheses import Hypothesis
from calib.gap.model import Joint, Model, NoiseTerm, Term, refined, with_residual
from calib.gap.noise_fit import NoiseFit, refitted, with_term, without_term
from calib.recording import Sensor

Array = NDArray[np.float64]

_MOST = 12
"""Effects in a model: more is no explanation."""
MATERIAL = 0.005
"""Part of the largest gain below which an effect is a second order of the large ones (GAP, pitfalls)."""


_SEEN = 0.1
"""Part of that below which it does not join in the first place."""


@dataclass(frozen=True, eq=False)
class Chosen:
    """A fitted model, its covariance, the scores when each term joined, and the level of significance."""

    model: Model
    joint: Joint
    noise: NoiseFit
    scores: tuple[Score, ...]
    tests: int
    first: tuple[Score, ...]
    """Scores of all hypotheses against no effect at all."""


def largest_gain(chosen: Chosen) -> float:
    """Of the effects in a model, when they joined."""
    return max((s.gain for s in chosen.scores), default=0.0)


def fitted(model: Model, sensors: Sequence[Sensor] | None = None) -> tuple[Model, Joint, NoiseFit]:
    """Mean and noise of a model fitted in turn."""
    model, _ = refined(model)
    noise = refitted(model, sensors)
    model, joint = refined(noise.model)
    return model, joint, replace(noise, model=model)


def select(start: Model, contest: Contest, alpha: float, *, blocked: Sequence[str] = ()) -> Chosen:
    """The effects that the data show.

    Parameters
    ----------
    start
        The model without an effect, its noise fitted.
    contest
        Everything that competes.
    alpha
        Chance that any of the tests fires without a gap.
    blocked
        Ids that take no part.
    """
    candidates = [h for h in contest.hypotheses if h.effect.id not in blocked]
    tests = sum(not h.again for h in candidates)
    level = alpha / max(tests, 1)
    model, joint, noise = fitted(start)
    first = tuple(_scored(model, contest, candidates, {}, None).values())
    return grown(Chosen(model, joint, noise, (), tests, first), contest, level, candidates)


def grown(chosen: Chosen, contest: Contest, level: float, candidates: Sequence[Hypothesis] | None = None) -> Chosen:
    """A model with everything that is still significant beside it, at `level` a test."""
    candidates = contest.hypotheses if candidates is None else candidates
    model, joined, first = chosen.model, list(chosen.scores), chosen.first
    known = {} if joined else {s.hypothesis.key: s for s in first}
    scores = _scored(model, contest, candidates, known, None if joined else set())
    for _ in range(_MOST):
        largest = max((s.gain for s in joined), default=0.0)
        # Noise may have taken the place of a mean: what that gains beside it says little.
        best = _best(scores, level, 0.0 if model.noise_terms else _SEEN * MATERIAL * largest)
        if best is None:
            break
        trial, _, _ = fitted(with_score(model, best))
        joined.append(best)
        trial, joined = pruned(trial, contest, joined, level)
        changed = {view.sensor for view in trial.setting.views if best.hypothesis.touches(view)}
        model = trial
        scores = _scored(model, contest, candidates, scores, changed)
    model, joined = _material(model, contest, joined)
    model, joint, noise = fitted(model)
    return Chosen(model, joint, noise, tuple(joined), chosen.tests, first)


def with_score(model: Model, score: Score) -> Model:
    """The model with a hypothesis that was scored beside it."""
    if isinstance(score.hypothesis.effect, NoiseEffect):
        return with_term(model, NoiseTerm(score.hypothesis, score.theta))
    term = Term(score.hypothesis, score.beta, score.theta)
    return with_residual(replace(model, terms=(*model.terms, term)))


def _scored(
    model: Model,
    contest: Contest,
    candidates: Sequence[Hypothesis],
    old: dict[tuple[str, tuple[int, ...]], Score],
    changed: set[Sensor] | None,
) -> dict[tuple[str, tuple[int, ...]], Score]:
    """Scores of all candidates that are not in the model; those of sensors that did not change stay."""
    taken = {t.hypothesis.key for t in model.terms} | {t.hypothesis.key for t in model.noise_terms}
    beside = Beside(model)
    scores, stale = {}, []
    for hypothesis in candidates:
        if hypothesis.key in taken or (hypothesis.before is not None and hypothesis.before not in taken):
            continue
        moved = changed is None or hypothesis.effect.shared or hypothesis.effect.sensor in changed
        known = old.get(hypothesis.key)
        if moved or known is None:
            stale.append(hypothesis)
        else:
            scores[hypothesis.key] = known
    return {**scores, **{s.hypothesis.key: s for s in contest.scores(stale, beside)}}


def _best(scores: dict[tuple[str, tuple[int, ...]], Score], level: float, least: float) -> Score | None:
    good = [s for s in scores.values() if s.p < level and s.gain >= least]
    return max(good, key=lambda s: s.delta, default=None)


def pruned(model: Model, contest: Contest, joined: list[Score], level: float) -> tuple[Model, list[Score]]:
    """Without the terms that no longer are significant beside the others (Wald on the mean, ratio on the noise)."""
    while len(joined) > 1:
        gains = last_gains(model, contest)
        chances = {key: min(1.0, grid * float(chdtrc(df, gain))) for key, (gain, df, grid) in gains.items()}
        weak = [(key, p) for key, p in chances.items() if p > level]
        if not weak:
            break
        key = max(weak, key=lambda pair: pair[1])[0]
        model = without(model, key)
        joined = [s for s in joined if s.hypothesis.key != key]
        model, _, _ = fitted(model)
    return model, joined


def reduced(chosen: Chosen, keys: Collection[tuple[str, tuple[int, ...]]]) -> Chosen:
    """The same without the effects of those keys, everything fitted anew."""
    model = chosen.model
    for key in keys:
        model = without(model, key)
    model, joint, noise = fitted(model)
    left = tuple(s for s in chosen.scores if s.hypothesis.key not in keys)
    return replace(chosen, model=model, joint=joint, noise=noise, scores=left)


def without(model: Model, key: tuple[str, tuple[int, ...]]) -> Model:
    """The model without the term of that key."""
    for term in model.noise_terms:
        if term.hypothesis.key == key:
            return without_term(model, term)
    left = tuple(t for t in model.terms if t.hypothesis.key != key)
    return with_residual(replace(model, terms=left))


def last_gains(model: Model, contest: Contest) -> dict[tuple[str, tuple[int, ...]], tuple[float, int, int]]:
    """By term: what it gains beside all the others, its degrees of freedom, and the size of its grid."""
    found = {}
    for i, term in enumerate(model.terms):
        beside = Beside(restored(model, i), omit=(i,))
        columns = contest.columns(term.hypothesis, term.theta, model)
        if term.effect.fixed:
            found[term.hypothesis.key] = (max(beside.fixed_gain(columns), 0.0), 1, 1)
        else:
            gained = beside.gain(columns)
            found[term.hypothesis.key] = (gained.gain, gained.df, 1)
    for noise in model.noise_terms:
        bare = refitted(without_term(model, noise), [noise.hypothesis.effect.sensor])
        full = refitted(model, [noise.hypothesis.effect.sensor])
        gain = sum(bare.deviance.values()) - sum(full.deviance.values())
        found[noise.hypothesis.key] = (max(gain, 0.0), len(noise.hypothesis.effect.parameters), 1)
    return found


def restored(model: Model, i: int) -> Model:
    """The model with what term `i` explains given back to the residual; the term stays listed."""
    others = replace(model, terms=tuple(t for j, t in enumerate(model.terms) if j != i))
    back = with_residual(others)
    return replace(model, residual=back.residual, y=back.y)


def _material(model: Model, contest: Contest, joined: list[Score]) -> tuple[Model, list[Score]]:
    gains = {key: gain for key, (gain, _, _) in last_gains(model, contest).items()} if len(joined) > 1 else {}
    largest = max(gains.values(), default=0.0)
    # A mean of one sensor is no second order of another's.
    means = {
        s.hypothesis.key: s.hypothesis.effect.sensor for s in joined if isinstance(s.hypothesis.effect, MeanEffect)
    }
    most = {key: max(gains[k] for k in means if means[k] is means[key]) for key in means if key in gains}
    small = [key for key, gain in gains.items() if gain < MATERIAL * most.get(key, largest)]
    for key in small:
        model = without(model, key)
    return model, [s for s in joined if s.hypothesis.key not in small]


def objective(chosen: Chosen) -> float:
    """``-2 log L`` with the price of every effect: smaller is better."""
    return sum(chosen.noise.deviance.values()) + sum(s.price for s in chosen.scores)


def undrifted(chosen: Chosen, contest: Contest, start: Model, alpha: float) -> Chosen:
    """The model, or a better one without drifting noise.

    A walk can take the place of two effects on the mean at once, neither of which is better alone.
    """
    drifting = {t.hypothesis.effect.id for t in chosen.model.noise_terms if t.hypothesis.effect.id.endswith(DRIFTS)}
    if not drifting:
        return chosen
    sensors = {h.effect.sensor for h in contest.hypotheses if h.effect.id in drifting}
    blocked = [f"{sensor.value}{kind}" for sensor in sensors for kind in DRIFTS]
    other = select(start, contest, alpha, blocked=blocked)
    return other if objective(other) < objective(chosen) else chosen
