"""How far the gap shrinks on stretches held out of the fit; only reported, without influence on the answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.airframe.answer import Rollout
from mavcal.calib.airframe.effects import BODY_DRAG
from mavcal.calib.airframe.fit import FlightLikelihood, expanded
from mavcal.calib.airframe.found import FoundEffect, HeldOut
from mavcal.calib.airframe.pair import PairEvidence, Side, by_itself
from mavcal.calib.airframe.rollout import Predicted, folds, rollouts
from mavcal.calib.inference.model import Model
from mavcal.calib.inference.search import Answer

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

RUNS_M_S: Final = 3.0
"""Speed over ground, m/s, above which a stretch is a run, a kind of manoeuvre that is held out as a whole. Source:
AIRFRAME 5.8, where drag shows."""
_REFITTED: Final = 3
_LEAST: Final = 0.1
"""Least fraction of the flight of a manoeuvre that is held out. Chosen, not measured."""


@dataclass(frozen=True, eq=False)
class Parted:
    """Rollouts and nats on held-out stretches; `nats` is None without effects."""

    rollouts: tuple[Rollout, ...]
    nats: HeldOut | None


def held_out(answer: Answer, evidence: PairEvidence, found: Sequence[FoundEffect]) -> Parted:
    """Errors of the predicted flight with the simulator's airframe, and after each further effect."""
    model = answer.best.model
    side = evidence.side_of(model)
    steps = _steps(evidence, model, found)
    airframe = side.likelihood.airframe
    torque = side.likelihood.torque
    made = [_fold(evidence, side, model, steps, rows) for rows in folds(airframe)]
    blocks = rollouts(airframe, [(m.rows, m.predictions) for m in made], torque=torque)
    speed = np.hypot(airframe.flight.velocity[:, 0], airframe.flight.velocity[:, 1])
    runs = speed > RUNS_M_S
    if _LEAST < runs[airframe.flight.usable].mean() < 1.0 - _LEAST:
        apart = _fold(evidence, side, model, steps, runs)
        blocks += rollouts(airframe, [(runs, apart.predictions)], torque=torque, part="runs")
    return Parted(blocks, _nats(made, steps))


_TERMS: Final = (
    ("thrust", ("k", "expo", "sag", "tau", "delay")),
    ("drag", ("c1", *BODY_DRAG, "wind_north", "wind_east")),
    ("inflow", ("cz", "ch", "climb")),
)
"""Parameters of an airframe in the order in which they are added to a hover. Source: AIRFRAME 5.7, log171."""


def alone(side: Side) -> tuple[Rollout, ...]:
    """Errors of the predicted flight, from hover thrust alone to the whole airframe; predicted rows are held out."""
    airframe, place = side.likelihood.airframe, side.fit.layout.place
    made = []
    for rows in folds(airframe):
        theta = by_itself(_on(side, ~rows), side.fit.theta, _REFITTED)
        own = [
            n for n in side.fit.layout.names if n.startswith(("bias", "scale", "lever", "gain", "damping", "torque"))
        ]
        last = airframe.hovering(theta, own)
        predictions = [Predicted("", *airframe.predicted(last))]
        for name, terms in _TERMS:
            for term in terms:
                last[place[term]] = theta[place[term]]
            predictions.append(Predicted(name, *airframe.predicted(last)))
        made.append((rows, predictions))
    return rollouts(airframe, made, torque=False)


@dataclass(frozen=True, eq=False)
class _Fold:
    """Held-out rows, predictions fitted without them, and nats per sample of each prediction and of a free fit."""

    rows: Mask
    predictions: tuple[Predicted, ...]
    nats: tuple[float, ...]
    samples: int


def _steps(evidence: PairEvidence, model: Model, found: Sequence[FoundEffect]) -> tuple[tuple[str, Model], ...]:
    """Models from the simulator's airframe on, each with one more effect; effects of the air are in all of them."""
    air = frozenset(e.block for e in evidence.chosen(model) if e.domain == "environment")
    steps: list[tuple[str, Model]] = [("", air)]
    for effect in found:
        own = frozenset(
            e.block for e in evidence.chosen(model)
            if e.id == effect.id and (not effect.motors or e.motor in effect.motors)
        )  # fmt: skip
        if own and not own <= steps[-1][1]:
            steps.append((effect.id, steps[-1][1] | own))
    rest = model - steps[-1][1]
    if rest:
        steps.append(("unknown", steps[-1][1] | rest))
    return tuple(steps)


def _fold(evidence: PairEvidence, side: Side, model: Model, steps: Sequence[tuple[str, Model]], rows: Mask) -> _Fold:
    """The models fitted again without `rows`, with the noise of the whole flight."""
    inside, outside = (_on(side, kept) for kept in (~rows, rows))
    fit = expanded(inside, side.fit.theta, inside.possible, list(side.fit.spectra))
    apart = replace(evidence, real=Side(inside, fit)) if side is evidence.real else replace(
        evidence, slewed=Side(inside, fit)
    )  # fmt: skip
    posterior = apart.posterior(model)
    predictions, nats = [], []
    spectra = side.fit.spectra
    free = outside.loglik(side.fit.theta, spectra)
    samples = max(int((rows & side.likelihood.usable).sum()) * (6 if side.likelihood.torque else 3), 1)
    for name, some in steps:
        theta = _with(apart, side, model, some, posterior.amplitudes)
        slewed = any(e.slew for e in evidence.chosen(some))
        likelihood = outside if slewed or side is evidence.real else _on(evidence.real, rows)
        predictions.append(Predicted(name, *likelihood.airframe.predicted(theta)))
        nats.append((free - likelihood.loglik(theta, spectra)) / samples)
    return _Fold(rows, tuple(predictions), tuple(nats), samples)


def _on(side: Side, rows: Mask) -> FlightLikelihood:
    return FlightLikelihood(side.likelihood.airframe, side.likelihood.usable & rows, torque=side.likelihood.torque)


def _with(evidence: PairEvidence, side: Side, model: Model, some: Model, amplitudes: Array) -> Array:
    """Parameters of the real flight with only `some` of the model's effects at their amplitudes."""
    chosen = evidence.chosen(model)
    kept = amplitudes.copy()
    at = len(amplitudes) - sum(len(e.names) for e in chosen)
    for effect in chosen:
        if effect.block not in some:
            kept[at : at + len(effect.names)] = 0.0
        at += len(effect.names)
    real, _ = evidence.parameters(model, replace(evidence.posterior(model), amplitudes=kept))
    own = side.own
    return np.where(own, side.fit.theta, real)


def _nats(made: Sequence[_Fold], steps: Sequence[tuple[str, Model]]) -> HeldOut | None:
    if len(steps) < 2:
        return None
    total = sum(m.samples for m in made)
    each = [sum(m.nats[k] * m.samples for m in made) / total for k in range(len(steps))]
    return HeldOut(each[0], each[-1], tuple((steps[k][0], each[k]) for k in range(1, len(steps))))
