"""A model with one effect more or less, fitted again, and the gain of each effect beside the others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mavcal.calib.gap.effects.base import NoiseEffect
from mavcal.calib.gap.model.hypotheses import Hypothesis, Key
from mavcal.calib.gap.model.joint import Joint, Model, NoiseTerm, Term, jacobian, normal_equations, with_residual
from mavcal.calib.gap.model.noise_fit import FittedNoise, noise_fitted, with_term, without_term
from mavcal.calib.gap.model.normal_equations import solved
from mavcal.calib.gap.model.refinement import coupled_sensors, coupled_terms, refined
from mavcal.calib.gap.search.contest import Contest, ContestScore
from mavcal.calib.gap.search.projection import independent_directions
from mavcal.calib.recording import Sensor

Gains = Mapping[Key, tuple[float, int, int]]
"""By effect: gain beside all others, degrees of freedom, size of the grid."""


def jointly_fitted(model: Model) -> tuple[Model, Joint, FittedNoise]:
    """Mean and noise of a model fitted in turn."""
    model, _ = refined(model)
    noise = noise_fitted(model)
    model, joint = refined(noise.model)
    return model, joint, replace(noise, model=model)


def locally_fitted(model: Model, hypothesis: Hypothesis, *, hold: bool = False) -> Model:
    """Mean and noise fitted in turn, for the sensors that `hypothesis` acts on and those coupled with them.

    With `hold` shapes stay where they are, which takes a fraction of the time.
    """
    own = {view.sensor for view in model.setting.views if hypothesis.touches(view)}
    near = coupled_sensors(model, own)
    members = coupled_terms(model, near)
    noise = noise_fitted(refined(model, members, hold=hold)[0], sorted(near))
    return refined(noise.model, members, hold=hold)[0]


def with_score(model: Model, score: ContestScore) -> Model:
    """The model with the hypothesis of a score."""
    if isinstance(score.hypothesis.effect, NoiseEffect):
        return with_member(model, NoiseTerm(score.hypothesis, score.theta))
    return with_member(model, Term(score.hypothesis, score.beta, score.theta))


def with_member(model: Model, term: Term | NoiseTerm) -> Model:
    """The model with one more term, not fitted again."""
    if isinstance(term, NoiseTerm):
        return with_term(model, term)
    return with_residual(replace(model, terms=(*model.terms, term)))


def without_effect(model: Model, key: Key) -> Model:
    """The model without the term of that key, not fitted again."""
    for term in model.noise_terms:
        if term.hypothesis.key == key:
            return without_term(model, term)
    left = tuple(t for t in model.terms if t.hypothesis.key != key)
    return with_residual(replace(model, terms=left))


def with_term_in_residual(model: Model, i: int) -> Model:
    """The model with the contribution of term `i` added back to the residual; the term stays listed."""
    others = replace(model, terms=tuple(t for j, t in enumerate(model.terms) if j != i))
    back = with_residual(others)
    return replace(model, residual=back.residual, y=back.y)


def marginal_gains(model: Model, contest: Contest) -> dict[Key, tuple[float, int, int]]:
    """By term, its gain beside all others, degrees of freedom, and size of the grid."""
    found = _mean_marginal_gains(model, contest)
    full: dict[Sensor, float] = {}
    for noise in model.noise_terms:
        sensor = noise.hypothesis.effect.sensor
        bare = noise_fitted(without_term(model, noise), [sensor])
        if sensor not in full:
            full[sensor] = sum(noise_fitted(model, [sensor]).deviance.values())
        gain = sum(bare.deviance.values()) - full[sensor]
        found[noise.hypothesis.key] = (max(gain, 0.0), len(noise.hypothesis.effect.parameters), 1)
    return found


def _mean_marginal_gains(model: Model, contest: Contest) -> dict[Key, tuple[float, int, int]]:
    """Marginal gains of the terms on the mean, from one set of normal equations.

    A term is added back to the residual and fitted by its own columns, beside everything that the others estimate.
    """
    if not model.terms:
        return {}
    own = [contest.columns.of(term.hypothesis, term.theta, model.setting) for term in model.terms]
    others = [jacobian(term, model.setting) for term in model.terms]
    normal = normal_equations([*own, *others], model.y, model.weight, model.ridge)
    count, size = len(own), len(normal.right)
    found = {}
    for i, term in enumerate(model.terms):
        mine = normal.slices[i]
        start = normal.slices[count].start
        own_rows = normal.slices[count + i]
        beside = np.array([*range(start, own_rows.start), *range(own_rows.stop, size)], np.intp)
        values = np.ones(1) if term.effect.fixed else term.beta
        right = normal.right + normal.gram[:, mine] @ values
        cross = normal.gram[mine][:, beside]
        held, covariance, _ = solved(normal.gram[beside[:, None], beside], right[beside])
        gram = normal.gram[mine, mine] - cross @ covariance @ cross.T
        left = right[mine] - cross @ held
        if term.effect.fixed:
            found[term.hypothesis.key] = (max(float(2.0 * left[0] - gram[0, 0]), 0.0), 1, 1)
        else:
            basis = independent_directions(gram, np.diag(normal.gram)[mine])
            found[term.hypothesis.key] = (float(((basis.T @ left) ** 2).sum()), basis.shape[1], 1)
    return found


def member_of(model: Model, key: Key) -> Term | NoiseTerm:
    """The term of that key."""
    return next(term for term in model.members if term.hypothesis.key == key)
