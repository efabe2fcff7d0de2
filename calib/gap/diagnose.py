"""From a problem to its report: lattice effects, one contest of all other effects, held-out blocks, and the report."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from mavcal.calib.gap.companion.level_shifts import with_level_shifts
from mavcal.calib.gap.companion.nuisance_gain import above_nuisance
from mavcal.calib.gap.effects import by_id, catalogue
from mavcal.calib.gap.effects.base import CatalogueEffect, NoiseEffect
from mavcal.calib.gap.effects.reference_attitude import REFERENCE
from mavcal.calib.gap.heldout.consistency import inconsistent_effects
from mavcal.calib.gap.heldout.shrink import Heldout, held_out, shrink_of, with_nested_selection
from mavcal.calib.gap.model.bands import split
from mavcal.calib.gap.model.hypotheses import Key, hypotheses_of
from mavcal.calib.gap.model.joint import Model, setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects, noise_fitted
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.problem import GapProblem, ReferenceInfo, ReferenceKind
from mavcal.calib.gap.progress import GapPace, GapStage, with_limit
from mavcal.calib.gap.remembered import one_diagnosis
from mavcal.calib.gap.schema import (
    FIRST,
    EffectEstimate,
    GapReport,
    GapVerdict,
    LocatedGap,
    MultipleTesting,
    NotTestable,
    Unknown,
)
from mavcal.calib.gap.search.added_noise import is_line_unsteadiness, nominal_has_tone
from mavcal.calib.gap.search.contest import Contest, ContestScore
from mavcal.calib.gap.search.exchange import StableModel, stable_model, without_drift_noise
from mavcal.calib.gap.search.lattice_effects import Lattice, covered_by, lattice_of
from mavcal.calib.gap.search.power import powers_of
from mavcal.calib.gap.search.selection import ChosenModel, refitted_without, select
from mavcal.calib.gap.search.terms import member_of
from mavcal.calib.gap.search.thresholds import GainThresholds
from mavcal.calib.gap.search.wander import WanderFit, fit_wander
from mavcal.calib.gap.telling.effect_report import (
    attitude_error_effect,
    delay_on_late_unit,
    effect_of,
    with_other_unit_as_rival,
)
from mavcal.calib.gap.telling.identifiability import (
    inseparable,
    inseparable_notice,
    is_bounded,
    unbounded_causes,
    unbounded_parameters,
    with_equal_effects,
)
from mavcal.calib.gap.telling.locate import located
from mavcal.calib.gap.telling.recordings import inputs_of, overstated_noise, series_of
from mavcal.calib.gap.unknown.misattributed_noise import Unexplained
from mavcal.calib.gap.unknown.shape_search import with_shapes
from mavcal.calib.gap.unknown.transitions import JumpSpan, transient_events, transitions, without_transitions
from mavcal.calib.gap.unknown.unresponsive import unresponsive_sensors, without_sensors
from mavcal.calib.gap.unknown.verdict import (
    NOT_LASTING,
    UnnamedCause,
    improbable_effects,
    unknown_of,
    unnamed_causes_in,
)
from mavcal.calib.gap.worth.attitude_error import below_reference, on_uncertain_unit
from mavcal.calib.gap.worth.attribution import Attribution, attributions
from mavcal.calib.recording import Sensor

_ROUNDS = 3
"""Most rounds of leaving out samples during events; the selection is then final. Chosen, not measured: it bounds the
time of a selection that alternates."""


@dataclass(frozen=True, eq=False)
class _Setup:
    """A problem ready for the search: lattice effects, the model without effects, and the competing hypotheses.

    `missing` lists effects that cannot be tested (id, reason, need); `left_out` are events whose samples were removed.
    """

    problem: GapProblem
    lattice: Lattice
    bare: Model
    contest: Contest
    missing: tuple[tuple[str, str, str], ...]
    left_out: tuple[JumpSpan, ...] = ()


@dataclass(frozen=True, eq=False)
class _Answer:
    """A model, the attributions of its effects, and the contest that it comes from.

    `wander` is the reference's own attitude error, None if it is negligible. `heldout` is None if no block can be held
    out. `gates` state by effect whether held-out blocks confirm it (None: undecided); `withdrawn` are the gains of
    effects that they refute. `inseparable` effects cannot be told from the reference's error.
    """

    stable: StableModel
    attributions: tuple[Attribution, ...]
    contest: Contest
    wander: WanderFit | None
    heldout: Heldout | None = None
    gates: Mapping[Key, bool | None] = field(default_factory=dict)
    withdrawn: tuple[Unexplained, ...] = ()
    inseparable: frozenset[Key] = frozenset()
    foreign: frozenset[Key] = frozenset()

    @property
    def chosen(self) -> ChosenModel:
        """The model with its fit."""
        return self.stable.chosen

    @cached_property
    def tolerated(self) -> frozenset[Key]:
        """Effects not reported, as differences between any two recordings or as errors of the reference."""
        thresholds, gains = self.contest.thresholds, {a.key: a.gain for a in self.attributions}
        members = (t.hypothesis for t in self.chosen.model.members)
        small = frozenset(h.key for h in members if gains.get(h.key, math.inf) < thresholds.to_report(h))
        return self.inseparable | small | below_reference(self.chosen.model, self.chosen.joint)

    @property
    def reported(self) -> tuple[Attribution, ...]:
        """Attributions of the reported effects, with shares of their common gain."""
        reported = tuple(a for a in self.attributions if a.key not in self.tolerated)
        whole = sum(a.share for a in reported) if len(reported) < len(self.attributions) else 1.0
        return tuple(replace(a, share=a.share / (whole or 1.0)) for a in reported)


@one_diagnosis()
def diagnose(
    problem: GapProblem,
    *,
    effects: tuple[CatalogueEffect, ...] | None = None,
    alpha: float = 0.005,
    nested: bool = True,
    pace: GapPace | None = None,
    foreign: Callable[[GapReport], Collection[EffectEstimate]] = lambda _: (),
) -> GapReport:
    """Report on where the sensors of `problem` differ from their references, and which effects explain it how far.

    Parameters
    ----------
    problem
        Sensors beside their references.
    effects
        Candidate effects; None: the whole catalogue.
    alpha
        Chance that anything is reported where there is no gap.
    nested
        Whether the shrink repeats the selection inside the folds.
    pace
        How long it may take, and who hears how far it is; None: as long as it takes.
    foreign
        Finds the effects of a report that are not a sensor's, from other evidence in the recordings. They stay in the
        report.
    """
    effects, pace = catalogue() if effects is None else effects, pace or GapPace()
    pace.begin(GapStage.SELECTION)
    left_out: tuple[JumpSpan, ...] = ()
    rounds = 0
    while True:
        task = _setup_of(problem, effects, pace)
        if task is None:
            return _empty_report(problem)
        chosen = _with_steps(task, select(task.bare, task.contest, alpha), alpha)
        problem, events = _without_unusable(task, chosen, rounds)
        if problem is task.problem:
            break
        left_out, rounds = (*left_out, *events), rounds + bool(events)
    task = replace(task, left_out=left_out)
    pace.begin(GapStage.RIVALS)
    answer = _stable_answer(task, chosen, alpha, frozenset(e.id for e in effects))
    answer = replace(answer, foreign=frozenset(map(_key_of, foreign(_before_blocks(task, answer)))))
    pace.begin(GapStage.HELD_OUT)
    confirmed = _confirmed_by_blocks(answer, alpha, nested=nested and not task.problem.alone)
    if task.problem.alone:
        confirmed = _consistent_answer(task, confirmed, alpha, nested=nested)
    pace.begin(GapStage.REPORT)
    return with_limit(_report(task, confirmed, alpha, nested=nested and GapStage.BLOCKS not in pace.left_out), pace)


def _with_steps(task: _Setup, chosen: ChosenModel, alpha: float) -> ChosenModel:
    """The selected model with level shifts, unless the error of a re-estimated attitude looks like them."""
    if any(view.att_sd > 0.0 for view in task.bare.setting.views):
        return chosen
    problem = task.problem
    return with_level_shifts(chosen, task.contest, problem.traces, problem.nominal, alpha / max(chosen.tests, 1))


def _without_unusable(task: _Setup, chosen: ChosenModel, rounds: int) -> tuple[GapProblem, tuple[JumpSpan, ...]]:
    """The problem without unresponsive sensors or, if there are none, without samples during events; and these events.

    The problem of `task` itself if everything in it is usable, time is over, or `rounds` of removal were made.
    """
    pace = task.contest.pace
    if (unresponsive := unresponsive_sensors(chosen.model)) and not pace.ended:
        return without_sensors(task.problem, unresponsive), ()
    if rounds < _ROUNDS and (events := transitions(chosen.model, _gains(chosen))) and not pace.ends():
        return without_transitions(task.problem, events), events
    return task.problem, ()


def _setup_of(problem: GapProblem, effects: tuple[CatalogueEffect, ...], pace: GapPace | None = None) -> _Setup | None:
    """Everything that a selection needs; None if no sensor has enough samples beside a reference."""
    lattice = lattice_of(problem, effects)
    views = split(views_of(problem, lattice.masked, lattice.variance))
    if not views:
        return None
    setting = setting_of(views)
    hypotheses, missing = hypotheses_of(effects, views, problem.worse)
    start = model_without_effects(setting)
    bare = noise_fitted(start).model
    contest = Contest(hypotheses, thresholds=GainThresholds(problem.minimum_gain), pace=pace)
    contest = above_nuisance(contest, start, problem.nuisance)
    return _Setup(problem, lattice, bare, contest, missing)


def _gains(chosen: ChosenModel) -> dict[Key, float]:
    return {s.hypothesis.key: s.gain for s in chosen.scores}


def _stable_answer(task: _Setup, chosen: ChosenModel, alpha: float, named: Collection[str]) -> _Answer:
    """The model after the wandering reference, exchanges of effects and unnamed shapes were tried."""
    contest, start = task.contest, task.bare
    wander = fit_wander(chosen, contest, start, alpha) if REFERENCE in named else None
    if wander is None:
        chosen = without_drift_noise(chosen, start, contest, alpha)
    else:
        chosen, contest, start = wander.chosen, wander.contest, wander.start
    found = stable_model(chosen, contest, alpha)
    best = with_shapes(found.chosen, contest, start, alpha, named)
    found = stable_model(best.chosen, best.contest, alpha, found)
    small = inseparable(found.chosen, task.problem.reference)
    return _Answer(found, attributions(found, best.contest), best.contest, wander, inseparable=small)


def _confirmed_by_blocks(answer: _Answer, alpha: float, *, nested: bool) -> _Answer:
    """The answer without the effects that held-out blocks refute.

    The weakest effect of each kind is removed first: either of two similar ones seems superfluous beside the other.
    """
    chosen, contest = answer.chosen, answer.contest
    heldout = held_out(chosen, contest, answer.tolerated | answer.foreign)
    gates, excluded = _gate_results(heldout), []
    while failed := [s for s in chosen.scores if gates.get(s.hypothesis.key) is False]:
        kinds = {s.hypothesis.effect.id for s in failed}
        weakest = [min((s for s in failed if s.hypothesis.effect.id == k), key=lambda s: s.gain) for k in sorted(kinds)]
        weakest = failed if contest.pace.ends() else weakest
        excluded += weakest
        chosen = refitted_without(chosen, [s.hypothesis.key for s in weakest])
        known = None if heldout is None or not contest.pace.ended else heldout.gates
        heldout = held_out(chosen, contest, answer.tolerated | answer.foreign, known)
        if len(weakest) == len(failed) or contest.pace.ended:
            break
        gates = _gate_results(heldout)
    if nested and heldout is not None:
        heldout = with_nested_selection(heldout, chosen, contest, alpha)
    if not excluded:
        return replace(answer, heldout=heldout, gates=gates)
    found = stable_model(chosen, contest, 0.0, answer.stable)
    return replace(
        answer,
        stable=found,
        attributions=attributions(found, contest),
        heldout=heldout,
        gates=gates,
        withdrawn=_withdrawn_gains(s for s in excluded if s.hypothesis.key not in answer.tolerated),
    )


def _consistent_answer(task: _Setup, answer: _Answer, alpha: float, *, nested: bool) -> _Answer:
    """The answer of a flight without a companion: only effects that hold on every block and along either attitude."""
    denied = inconsistent_effects(task.problem, task.lattice, answer.chosen, answer.heldout)
    before = answer.tolerated
    answer = replace(answer, inseparable=answer.inseparable | denied | unbounded_parameters(answer.chosen).keys())
    heldout = answer.heldout
    if heldout is not None and answer.tolerated != before:
        heldout = held_out(answer.chosen, answer.contest, answer.tolerated | answer.foreign, heldout.gates)
    if nested and heldout is not None:
        heldout = with_nested_selection(heldout, answer.chosen, answer.contest, alpha)
    return replace(answer, heldout=heldout)


def _before_blocks(task: _Setup, answer: _Answer) -> GapReport:
    """Effects and series of an answer for which no block was held out."""
    named = (a for a in answer.reported if a.key[0] in by_id())
    effects = tuple(effect_of(answer.chosen, a, None, beside_unknown=False) for a in named)
    series = series_of(answer.chosen.model, answer.tolerated)
    return GapReport(inputs_of(task.problem), GapVerdict.NO_GAP, effects=effects, series=series)


def _key_of(effect: EffectEstimate) -> Key:
    return effect.id, tuple(i - FIRST for i in effect.instances)


def _gate_results(heldout: Heldout | None) -> Mapping[Key, bool | None]:
    return {} if heldout is None else {gate.key: gate.passed for gate in heldout.gates}


def _withdrawn_gains(scores: Iterable[ContestScore]) -> tuple[Unexplained, ...]:
    """Nats of the withdrawn effects on the mean, by sensor; noise stays in the residual, whose power is tested."""
    nats: dict[Sensor, float] = {}
    for score in scores:
        if isinstance(score.hypothesis.effect, NoiseEffect):
            continue
        sensor = score.hypothesis.effect.sensor
        nats[sensor] = nats.get(sensor, 0.0) + 0.5 * score.gain
    return tuple(Unexplained(n, NOT_LASTING, sensor) for sensor, n in nats.items())


def _report(task: _Setup, answer: _Answer, alpha: float, *, nested: bool) -> GapReport:
    """The report of a problem and its answer."""
    chosen, model = answer.chosen, answer.chosen.model
    found = unnamed_causes_in(model, answer.reported, task.problem.minimum_gain.steady_report)
    unnamed = (s for s in found if not answer.tolerated.issuperset(s.keys))
    members = {t.hypothesis.key: t.hypothesis.effect for t in model.members}
    causes = (
        *unnamed,
        *improbable_effects(answer.reported, members, beside_withdrawn=bool(answer.withdrawn)),
        *unbounded_causes(chosen, {a.key for a in answer.reported}),
    )
    unknown = _unexplained_part(task, answer, causes)
    effects = _effects(task, answer, causes, beside_unknown=unknown.flag)
    return GapReport(
        inputs_of(task.problem),
        _verdict(task, effects, unknown, small=bool(answer.inseparable)),
        _locations(task, effects, unknown, alpha),
        effects,
        unknown,
        shrink=None if answer.heldout is None else shrink_of(chosen, answer.heldout, nested=nested),
        not_testable=_untestable(task),
        power=powers_of(chosen, answer.contest, alpha),
        multiple_testing=MultipleTesting(chosen.tests, alpha),
        warnings=(*task.problem.warnings, *_tolerated_notices(answer), *_noise_notices(task, model)),
        series=series_of(model, answer.tolerated),
    )


def _noise_notices(task: _Setup, model: Model) -> Iterable[str]:
    """Notices of series with less noise than declared.

    None where a trajectory's error, which grows with the movement, is part of the declared noise.
    """
    return overstated_noise(model) if math.isinf(task.problem.reference.bandwidth_hz) else ()


def _tolerated_notices(answer: _Answer) -> tuple[str, ...]:
    """Notices of the effects that are in the model but not reported."""
    known = [t.hypothesis for t in answer.chosen.model.members if not t.hypothesis.effect.nameless]
    accepted = dict.fromkeys(h.effect.id for h in known if h.key in answer.tolerated - answer.inseparable)
    said = (f"two recordings differ by as much anyway: {', '.join(accepted)} are no gap here",) if accepted else ()
    return (*said, *inseparable_notice([h.effect.id for h in known if h.key in answer.inseparable]))


def _locations(
    task: _Setup, effects: Iterable[EffectEstimate], unknown: Unknown, alpha: float
) -> tuple[LocatedGap, ...]:
    """Location of the gap; if two recordings always differ, only on the sensors of the reported effects."""
    found = located(task.bare, alpha)
    shared = any(by_id()[effect.id].shared for effect in effects)
    if unknown.flag or not task.problem.minimum_gain.steady_report or shared:
        return found
    named = {effect.sensor.value for effect in effects if effect.sensor is not None}
    return tuple(one for one in found if one.channel.partition(".")[0] in named)


def _unexplained_part(task: _Setup, answer: _Answer, causes: Iterable[UnnamedCause]) -> Unknown:
    """What no effect of the catalogue explains, inside the model and beside it."""
    model, reference = answer.chosen.model, task.problem.reference
    # A wandering reference looks like transient events.
    passed = () if answer.wander is not None else transient_events(task.left_out, model, _gains(answer.chosen))
    unexplained = [*answer.withdrawn, *(Unexplained(one.nats, one.text, one.sensor) for one in passed)]
    return unknown_of(
        model,
        answer.reported,
        tuple(causes),
        unexplained,
        reference.bandwidth_hz,
        task.problem.minimum_gain.steady_report,
        outside=reference.kind is ReferenceKind.POSE,
    )


def _effects(
    task: _Setup, answer: _Answer, causes: Iterable[UnnamedCause], *, beside_unknown: bool
) -> tuple[EffectEstimate, ...]:
    """Estimates of all named effects: of the lattice, of the reference's attitude, and of the model."""
    model = answer.chosen.model
    denied = {key for cause in causes for key in cause.keys}
    denied |= {t.hypothesis.key for t in model.terms if nominal_has_tone(t, task.problem.nominal)}
    denied |= {t.hypothesis.key for t in model.noise_terms if is_line_unsteadiness(t, model)}
    doubtful = on_uncertain_unit(model)
    found = (
        _effect(task, answer, a, beside_unknown=beside_unknown, sure=doubtful.get(a.key))
        for a in answer.reported
        if a.key not in denied
    )
    wander = _reported_wander(task, answer)
    own = () if wander is None else (attitude_error_effect(wander, answer.attributions),)
    return (
        *(e for e in task.lattice.effects if is_bounded(e.params)),
        *own,
        *(e for e in found if not covered_by(task.lattice, e)),
    )


def _effect(
    task: _Setup, answer: _Answer, attribution: Attribution, *, beside_unknown: bool, sure: float | None
) -> EffectEstimate:
    """One effect of the model; `sure` is the probability that its unit has it, not the other of two; None: certain."""
    passed = answer.gates.get(attribution.key)
    effect = effect_of(answer.chosen, attribution, passed, beside_unknown=beside_unknown)
    effect = with_equal_effects(effect, answer.chosen.model, member_of(answer.chosen.model, attribution.key))
    views = answer.chosen.model.setting.views
    units = {i + FIRST for view in views if view.sensor is effect.sensor for i in view.weights}
    if task.problem.reference.kind is ReferenceKind.ESTIMATOR:
        effect = delay_on_late_unit(effect, units)
    return effect if sure is None else with_other_unit_as_rival(effect, units, sure)


def _reported_wander(task: _Setup, answer: _Answer) -> WanderFit | None:
    """The reference's attitude error, unless a re-estimated trajectory already states one as large."""
    wander, reference = answer.wander, task.problem.reference
    if wander is None or reference.kind is not ReferenceKind.ESTIMATOR:
        return wander
    return wander if wander.size_deg > reference.att_sigma_deg else None


def _verdict(task: _Setup, effects: tuple[EffectEstimate, ...], unknown: Unknown, *, small: bool) -> GapVerdict:
    if task.problem.reference.useless:
        return GapVerdict.REFERENCE
    if unknown.flag:
        return GapVerdict.PARTLY_EXPLAINED if effects else GapVerdict.UNKNOWN
    if not effects:
        if task.problem.alone and small:
            return GapVerdict.REFERENCE
        return GapVerdict.NO_GAP if task.contest.hypotheses else GapVerdict.NOT_TESTABLE
    return GapVerdict.REFERENCE if all(e.id == REFERENCE for e in effects) else GapVerdict.EXPLAINED


def _untestable(task: _Setup) -> tuple[NotTestable, ...]:
    tested = {h.effect.id for h in task.contest.hypotheses}
    entries = [*task.problem.not_testable, *(m for m in task.missing if m[0] not in tested)]
    return tuple(NotTestable(*entry) for entry in {e[0]: e for e in entries}.values())


def untestable(reason: str, need: str, inputs: dict[str, str]) -> GapReport:
    """The report of recordings that cannot be compared; `inputs` are digests by role."""
    reference = ReferenceInfo(ReferenceKind.REDUNDANT, text=f"None: {reason}.")
    return _empty_report(GapProblem((), reference, 0.0, inputs=inputs, not_testable=(("all", reason, need),)))


def _empty_report(problem: GapProblem) -> GapReport:
    entries = problem.not_testable or (("all", "no sensor has enough samples beside a reference", "a longer overlap"),)
    return GapReport(
        inputs_of(problem),
        GapVerdict.REFERENCE if problem.reference.useless else GapVerdict.NOT_TESTABLE,
        not_testable=tuple(NotTestable(*e) for e in entries),
        warnings=problem.warnings,
    )
