"""Consistency of effects in a flight without a companion: on each of its blocks, and along either attitude.

Such a flight has no simulated or nominal companion and no external reference. The usual difference between two flights
is unknown, and the trajectory was estimated from the sensors in question. Its errors look like effects that exist only
in a part of the flight, or only along this trajectory. The vehicle's estimator logged a second trajectory.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.heldout.folds import contest_of, with_joined_term
from mavcal.calib.gap.heldout.gates import Gate
from mavcal.calib.gap.heldout.shrink import Heldout
from mavcal.calib.gap.model.bands import split
from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.model.joint import Model, NoiseTerm, Term, setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects, noise_fitted
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.problem import GapProblem, Trace
from mavcal.calib.gap.reference.posed import rotation
from mavcal.calib.gap.search.lattice_effects import Lattice
from mavcal.calib.gap.search.selection import ChosenModel
from mavcal.calib.gap.search.terms import marginal_gains
from mavcal.calib.gap.search.thresholds import GainThresholds
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_CHANCE_LOSS = 3.0
"""Nats that an effect may lose on a block by chance, since the other blocks do not determine it exactly. Source:
decision 32."""
_LEAST_GAIN = 30.0
"""Least gain along the other attitude, in twice the log-likelihood. Source: decision 32."""
_SIZE_RATIOS = (0.5, 2.0)
"""Allowed ratios of an effect's size along the other attitude to that along the first, in the direction of the first.
Source: decision 32."""
_ATTITUDE_SENSORS = (Sensor.ACCEL, Sensor.MAG)
"""Sensors whose ideal readings turn with the attitude; a rate of turn does not depend on it."""


def inconsistent_effects(
    problem: GapProblem, lattice: Lattice, chosen: ChosenModel, heldout: Heldout | None
) -> frozenset[Key]:
    """Effects and shapes of `chosen` that a block or the logged attitude refutes, or that no block can test."""
    named = chosen.model.members
    denied = {t.hypothesis.key for t in named} - set(confirmed_on_every_block(() if heldout is None else heldout.gates))
    other = along_logged_attitude(problem)
    left = [t for t in named if t.hypothesis.key not in denied]
    if other is not None and left:
        denied |= set(_denied_along(other, lattice, chosen, left))
    return frozenset(denied)


def confirmed_on_every_block(gates: Iterable[Gate]) -> Iterator[Key]:
    """Keys of effects that held-out blocks confirm and none refutes."""
    for gate in gates:
        if gate.passed and (gate.gains > -_CHANCE_LOSS).all():
            yield gate.key


def along_logged_attitude(problem: GapProblem) -> GapProblem | None:
    """`problem` with ideal readings along the logged attitude; None without one."""
    if problem.own_attitude is None:
        return None
    return replace(problem, traces=tuple(_with_attitude(t, *problem.own_attitude) for t in problem.traces))


def _with_attitude(trace: Trace, t: Array, q: Array) -> Trace:
    if trace.against is not None or trace.attitude is None or trace.sensor not in _ATTITUDE_SENSORS:
        return trace
    own = rotation(np.column_stack([np.interp(trace.t, t, c) for c in q.T]))
    turn = own.inv() * rotation(trace.attitude)
    ideal = turn.apply(trace.ideal)
    # rows without a sample keep a zero residual
    measured = np.where(trace.observed[:, None], trace.measured, trace.measured + ideal - trace.ideal)
    force = None if trace.force is None else turn.apply(trace.force)
    field = None if trace.field is None else turn.apply(trace.field)
    attitude = own.as_quat()[:, [3, 0, 1, 2]]
    return replace(trace, ideal=ideal, measured=measured, attitude=attitude, force=force, field=field)


def _denied_along(
    other: GapProblem, lattice: Lattice, chosen: ChosenModel, asked: Collection[Term | NoiseTerm]
) -> Iterator[Key]:
    setting = setting_of(split(views_of(other, lattice.masked, lattice.variance)))
    model = noise_fitted(model_without_effects(setting)).model
    members = {t.hypothesis.key: t for t in chosen.model.members}
    for score in chosen.scores:
        if score.hypothesis.key in members:
            model = with_joined_term(model, members[score.hypothesis.key])
    gains = marginal_gains(model, contest_of([t.hypothesis for t in model.members], GainThresholds()))
    for term in asked:
        key = term.hypothesis.key
        if gains[key][0] < _LEAST_GAIN or not _agrees_in_size(term, model):
            yield key


def _agrees_in_size(term: Term | NoiseTerm, other: Model) -> bool:
    """Whether the effect has the same direction and about the same size; noise is judged by its gain."""
    if isinstance(term, NoiseTerm):
        return True
    again = next(t for t in other.terms if t.hypothesis.key == term.hypothesis.key)
    here, there = (t.values if t.effect.fixed or not len(t.beta) else t.beta for t in (term, again))
    ratio = float(here @ there) / max(float(here @ here), 1e-300)
    return _SIZE_RATIOS[0] < ratio < _SIZE_RATIOS[1]
