"""From a problem to its report: lattice first, then all effects in one contest, then what the answer is worth."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.gap.attribution import TEMPERATURE, Attribution, settled, steadily
from calib.gap.bands import assembled, split
from calib.gap.contest import Contest
from calib.gap.doubts import nameless, not_following, without_sensors
from calib.gap.effects import catalogue
from calib.gap.effects.base import Effect, LatticeEffect, LatticeEvidence
from calib.gap.estimates import estimates_of
from calib.gap.hypotheses import hypotheses_of
from calib.gap.locate import located
from calib.gap.louder import unsteady_line
from calib.gap.model import Model, NoiseTerm, Term, predicted, setting_of, starting_model
from calib.gap.noise_fit import refitted, starting_noise
from calib.gap.power import powers_of
from calib.gap.problem import Problem
from calib.gap.quieter import quieter
from calib.gap.schema import (
    EffectEstimate,
    Estimate,
    Evidence,
    GapReport,
    Gates,
    Inputs,
    MultipleTesting,
    NotTestable,
    SeriesFit,
    Unknown,
    Verdict,
)
from calib.gap.selection import Chosen, reduced, select
from calib.gap.shrink import dose_of, held_out, shrink_of
from calib.gap.strangers import NOT_LASTING, strangers_in, unknown_of
from calib.gap.transitions import Transition, passing, transitions, without_transitions
from calib.gap.unknown import explained
from calib.gap.usual import usual_samples, usual_tone
from calib.gap.views import View, views_of
from calib.gap.wander import Wander, rms_rotation, sees, wandering
from calib.recording import Sensor

Array = NDArray[np.float64]

_FIRST = 1
"""Instances count from 1 in a report."""
REFERENCE = "reference_attitude"


def diagnose(
    problem: Problem,
    *,
    effects: tuple[Effect, ...] | None = None,
    alpha: float = 0.005,
    nested: bool = True,
    rounds: int = 3,
    left_out: tuple[Transition, ...] = (),
) -> GapReport:
    """Where the sensors of `problem` differ from their references, which effects explain it, and how far.

    Parameters
    ----------
    problem
        Sensors beside their references.
    effects
        That take part; None: the whole catalogue.
    alpha
        Chance that anything is reported where there is no gap.
    nested
        Whether the shrink repeats the selection inside the folds.
    rounds
        Times that samples during events that take time (:mod:`calib.gap.transitions`) are left out.
    left_out
        Those that are left out already.
    """
    effects = catalogue() if effects is None else effects
    lattice = lattice_of(problem, effects)
    masked = {i: found.masked for i, found in lattice.masks.items()}
    views = split(views_of(problem, masked, lattice.variance))
    setting = setting_of(views)
    inputs = _inputs(problem)
    if not views:
        return _nothing(problem, inputs)
    hypotheses, missing = hypotheses_of(effects, views)
    start = refitted(starting_model(setting, starting_noise(setting))).model
    contest = Contest(hypotheses, floor=problem.floor)
    bare = start
    chosen = select(start, contest, alpha)
    if lost := not_following(chosen.model):
        problem, again = without_sensors(problem, lost), rounds
    elif rounds and (taking := transitions(chosen.model, {s.hypothesis.key: s.gain for s in chosen.scores})):
        problem, again, left_out = without_transitions(problem, taking), rounds - 1, (*left_out, *taking)
    else:
        again = None
    if again is not None:
        return diagnose(problem, effects=effects, alpha=alpha, nested=nested, rounds=again, left_out=left_out)
    wander = wandering(chosen, contest, start, alpha) if any(e.id == REFERENCE for e in effects) else None
    if wander is not None:
        chosen = wander.chosen
        contest = wander.contest
        start = starting_model(chosen.model.setting, wander.noise, chosen.model.ridge)
    else:
        chosen = steadily(chosen, start, contest, alpha)
    chosen, attributions = settled(chosen, contest, alpha)
    best = explained(chosen, contest, start, alpha)
    if best.contest is not contest:
        contest = best.contest
        chosen, attributions = settled(best.chosen, contest, alpha)
    heldout = held_out(chosen, contest, alpha, nested=nested)
    gates = {} if heldout is None else {gate.key: gate.passed for gate in heldout.gates}
    failed = [key for key, passed in gates.items() if passed is False]
    withdrawn = 0.5 * sum(s.gain for s in chosen.scores if s.hypothesis.key in failed)
    if failed:
        chosen = reduced(chosen, failed)
        heldout = held_out(chosen, contest, alpha, nested=nested)
        chosen, attributions = settled(chosen, contest, 0.0)
    strangers = (*strangers_in(chosen.model, attributions), *nameless(attributions, withdrawn))
    denied = {key for stranger in strangers for key in stranger.keys}
    denied |= {t.hypothesis.key for t in chosen.model.terms if usual_tone(t, problem.nominal)}
    denied |= {t.hypothesis.key for t in chosen.model.noise_terms if unsteady_line(t, chosen.model)}
    found = tuple(_effect(chosen, a, gates.get(a.key)) for a in attributions if a.key not in denied)
    bandwidth, floor = problem.reference.bandwidth_hz, problem.floor
    passed = () if wander is not None else passing(left_out, chosen.model)  # a reference that turns looks like that
    without_name = [(withdrawn, NOT_LASTING), *((one.nats, one.text) for one in passed)]
    unknown = unknown_of(chosen.model, attributions, strangers, without_name, bandwidth, floor)
    effects_found = (*lattice.effects, *(() if wander is None else (_wandering(wander, attributions),)), *found)
    return GapReport(
        inputs,
        _verdict(effects_found, unknown),
        located(bare, alpha),
        effects_found,
        unknown,
        shrink=None if heldout is None else shrink_of(chosen, heldout, nested=nested),
        not_testable=_untestable(problem, missing, {h.effect.id for h in hypotheses}),
        power=powers_of(chosen, contest, alpha),
        multiple_testing=MultipleTesting(chosen.tests, alpha),
        warnings=(*problem.warnings, *quieter(chosen.model)),
        series=_series(chosen.model),
    )


@dataclass(frozen=True, eq=False)
class Lattice:
    """What the samples themselves show, by index of the trace where it matters to the rest."""

    effects: tuple[EffectEstimate, ...]
    masks: Mapping[int, LatticeEvidence]
    variance: Mapping[int, float]


def lattice_of(problem: Problem, effects: Iterable[Effect]) -> Lattice:
    """Lattice effects of every trace."""
    found: list[EffectEstimate] = []
    masks: dict[int, LatticeEvidence] = {}
    variance: dict[int, float] = {}
    for i, trace in enumerate(problem.traces):
        if trace.against is not None:
            continue
        for effect in effects:
            if not isinstance(effect, LatticeEffect) or effect.sensor is not trace.sensor:
                continue
            evidence = effect.detect(trace)
            if evidence is None or usual_samples(effect, evidence, problem.nominal):
                continue
            found.append(_from_lattice(effect, trace.instances, evidence))
            if evidence.masked.any():
                masks[i] = evidence if i not in masks else _both(masks[i], evidence)
            if effect.id.endswith("_quantisation"):
                variance[i] = max(float(np.mean(np.square(evidence.values[:3]))) - trace.quantum**2, 0.0) / 12.0
    return Lattice(tuple(found), masks, variance)


def _both(one: LatticeEvidence, other: LatticeEvidence) -> LatticeEvidence:
    masked = one.masked | other.masked
    return LatticeEvidence(one.values, one.se, one.two_delta_loglik, masked, one.text)


def _from_lattice(effect: LatticeEffect, instances: tuple[int, ...], evidence: LatticeEvidence) -> EffectEstimate:
    params = tuple(
        Estimate(p.name, value, se, (value - 1.96 * se, value + 1.96 * se), p.unit)
        for p, value, se in zip(effect.parameters, evidence.values, evidence.se, strict=True)
    )
    sure = Evidence(evidence.two_delta_loglik, len(params), 0.0, 0.999, 0.0)
    return EffectEstimate(effect.id, effect.sensor, tuple(i + _FIRST for i in instances), params, sure)


def _effect(chosen: Chosen, found: Attribution, passed: bool | None) -> EffectEstimate:
    term, dose = _term(chosen.model, found), dose_of(chosen, found.key)
    p = next((s.p for s in chosen.scores if s.hypothesis.key == found.key), 1.0)
    return EffectEstimate(
        term.hypothesis.effect.id,
        term.hypothesis.effect.sensor,
        tuple(i + _FIRST for i in found.key[1]),
        estimates_of(chosen, term, dose.widening),
        Evidence(found.gain, found.df, min(1.0, p * chosen.tests), found.probability, found.share),
        found.rivals,
        Gates(passed, None, dose.agrees),
    )


def _wandering(wander: Wander, attributions: tuple[Attribution, ...]) -> EffectEstimate:
    """The reference's own error as an effect: its size on each axis."""
    model = wander.chosen.model
    instances = sorted({i + _FIRST for view in model.setting.views if sees(view) for i in view.weights})
    others = sum(a.gain for a in attributions)
    sure = Evidence(
        wander.gain,
        2,
        float(np.exp(-0.5 * min(wander.gain, 1400.0))),
        float(1.0 / (1.0 + np.exp(-0.5 * min(wander.gain, 1400.0) / TEMPERATURE))),
        wander.gain / (wander.gain + others),
    )
    return EffectEstimate(REFERENCE, Sensor.ACCEL, tuple(instances), rms_rotation(model), sure)


def _term(model: Model, found: Attribution) -> Term | NoiseTerm:
    return next(t for t in model.members if t.hypothesis.key == found.key)


def _verdict(effects: tuple[EffectEstimate, ...], unknown: Unknown) -> Verdict:
    if unknown.flag:
        return Verdict.PARTLY_EXPLAINED if effects else Verdict.UNKNOWN
    if not effects:
        return Verdict.NO_GAP
    return Verdict.REFERENCE if all(e.id == REFERENCE for e in effects) else Verdict.EXPLAINED


def _untestable(problem: Problem, missing: Iterable[tuple[str, str, str]], tested: set[str]) -> tuple[NotTestable, ...]:
    entries = [*problem.not_testable, *(m for m in missing if m[0] not in tested)]
    return tuple(NotTestable(*entry) for entry in {e[0]: e for e in entries}.values())


def _nothing(problem: Problem, inputs: Inputs) -> GapReport:
    entries = problem.not_testable or (("all", "no sensor has enough samples beside a reference", "a longer overlap"),)
    return GapReport(
        inputs,
        Verdict.NOT_TESTABLE,
        not_testable=tuple(NotTestable(*e) for e in entries),
        warnings=problem.warnings,
    )


def _inputs(problem: Problem) -> Inputs:
    reference = problem.reference
    noise = {
        f"{t.sensor.value}{t.instances[0] + _FIRST}": tuple(map(float, t.sigma))
        for t in problem.traces
        if t.sigma is not None and t.against is None
    }
    return Inputs(
        problem.inputs.get("real"),
        problem.inputs.get("sim"),
        max((t.fs for t in problem.traces), default=0.0),
        problem.duration_s,
        reference.kind.value,
        reference.att_sigma_deg,
        reference.text,
        noise,
        diagnoser_sha256(),
    )


@cache
def diagnoser_sha256() -> str:
    """Over the sources of this package: which diagnoser spoke."""
    root = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _drawn(term: Term, band: View) -> Array:
    """The prediction of a term at the own rate of a series; what is slow is drawn between the samples of its band."""
    if band.fine is None or term.hypothesis.fast:
        return predicted(term, band.whole)
    slow = predicted(term, band)
    return np.column_stack([np.interp(band.whole.t, band.t, column) for column in slow.T])


def _series(model: Model) -> tuple[SeriesFit, ...]:
    made = []
    for v, band in enumerate(model.setting.views):
        if band.first:
            continue
        view = band.whole
        parts: dict[str, Array] = {}
        for term in model.terms:
            if term.hypothesis.touches(band):
                name = term.hypothesis.effect.id  # what happens more than once is shown as one
                parts[name] = parts.get(name, 0.0) + _drawn(term, band)
        modelled = np.add.reduce([np.zeros_like(view.residual), *parts.values()])
        power = np.column_stack(
            [assembled(model.setting.views, [n.power for n in model.noise], v, c) for c in range(3)]
        )
        sigma = np.sqrt(power.mean(axis=0))
        instances = tuple(i + _FIRST for i in view.weights)
        trace, keep = view.any_trace, view.keep
        ideal = trace.ideal[keep] if len(view.weights) == 1 else None
        about = {"temperature": trace.temperature, "current": trace.current, "throttle": trace.throttle}
        covariates = {name: values[keep] for name, values in about.items() if values is not None}
        made.append(
            SeriesFit(
                *(view.sensor, instances, view.t, view.residual, modelled, sigma, trace.unit, parts),
                ideal=ideal,
                covariates=covariates,
                power=power,
            )
        )
    return tuple(made)
