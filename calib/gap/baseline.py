"""What a simulated flight already shows against its own ideal: flaws of the reference and traits of the simulator.

Where the simulator flew another flight (GAP 3.5b c), both logs are held against an ideal sensor, and the gap is what
the real one has and the simulated one has not: what the simulated one shows is put into the ideal reading of the real.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from calib.gap.bands import split
from calib.gap.contest import Contest
from calib.gap.effects import catalogue
from calib.gap.effects.base import Effect, MeanEffect
from calib.gap.estimates import estimates_of
from calib.gap.hypotheses import hypotheses_of
from calib.gap.model import setting_of, starting_model
from calib.gap.noise_fit import refitted, starting_noise
from calib.gap.problem import Problem, Trace
from calib.gap.replay import with_effects, with_effects_in
from calib.gap.schema import EffectEstimate, Evidence
from calib.gap.selection import last_gains, select
from calib.gap.views import views_of
from calib.recording import Sensor

_CARRIED = (
    *("_bias", "_scale", "_misalignment", "_rotation", "_lever_arm", "_delay", "_low_pass", "clock_drift"),
    *("_hard_iron", "_soft_iron", "_earth_field", "reference_attitude"),
)
"""Ends of the ids of what another flight shows alike; what depends on temperature, current or an event is not."""
_DIFFERENT = 0.1
"""Part of the evidence of a simulated flight's own flaws that a real one must have beyond them."""
_SMALL = 0.03
"""Evidence a number below which two flights differ anyway: a re-estimated ideal sensor is not surer of itself."""


@dataclass(frozen=True, eq=False)
class Baseline:
    """Effects of a simulated flight, and by sensor: the gain of the largest of them, what all of them change (the sum
    of squares over the flight), and the gain below which they were not asked for.
    """

    effects: tuple[EffectEstimate, ...]
    gains: Mapping[Sensor, float]
    changes: Mapping[Sensor, float]
    indifferent: Mapping[Sensor, float]

    def in_ideal(self, traces: Sequence[Trace]) -> tuple[Trace, ...]:
        """`traces` of the simulator beside what it reads with its flaws: what is left is its noise."""
        return with_effects_in(traces, self.effects)[0]


def baseline_of(problem: Problem, alpha: float) -> Baseline:
    """What of the mean a simulated flight shows beside its own ideal; what happens once is not carried over.

    The noise that was learned from this flight has in it what is looked for: it is fitted anew beside it.
    """
    problem = replace(problem, traces=tuple(map(_undeclared, problem.traces)))
    views = split(views_of(problem, {}, {}))
    steady = [e for e in catalogue() if _carried(e)]
    hypotheses, _ = hypotheses_of(steady, views)
    setting = setting_of(views)
    if not views or not hypotheses:
        return Baseline((), {}, {}, {})
    contest = Contest(hypotheses, floor=_indifferent(problem))
    chosen = select(refitted(starting_model(setting, starting_noise(setting))).model, contest, alpha)
    gains = {key: gain for key, (gain, _, _) in last_gains(chosen.model, contest).items()}
    found, largest = [], dict.fromkeys((view.sensor for view in views), 0.0)
    for term in chosen.model.terms:
        effect = term.hypothesis.effect
        gain = gains[term.hypothesis.key]
        for sensor in largest:
            if effect.shared or sensor is effect.sensor:
                largest[sensor] = max(largest[sensor], gain)
        instances = tuple(i + 1 for i in term.hypothesis.instances)
        evidence = Evidence(gain, len(term.values), 0.0, 1.0, 0.0)
        found.append(EffectEstimate(effect.id, effect.sensor, instances, estimates_of(chosen, term), evidence))
    changed, _ = with_effects(problem, found, shared=True)
    return Baseline(tuple(found), largest, _changes(problem, changed), _indifferent(problem))


def _undeclared(trace: Trace) -> Trace:
    """Without noise that was learned; what is declared for certain stays."""
    if trace.psd is None and math.isinf(trace.sigma_dof):
        return trace
    return replace(trace, sigma=None, sigma_dof=math.inf, psd=None, psd_hz=None, own_psd=None)


def beside(problem: Problem, baseline: Baseline) -> Problem:
    """`problem` held against a simulator that has what its own flight shows."""
    changed, _ = with_effects(problem, baseline.effects, shared=True)
    livelier = _changes(problem, changed)
    small = _indifferent(problem)
    floor = {s: max(small[s], _flaws(problem, baseline, livelier, s)) for s in small}
    return replace(changed, floor=floor)


def _carried(effect: Effect) -> bool:
    return isinstance(effect, MeanEffect) and effect.id.endswith(_CARRIED) and "_temp" not in effect.id


def _flaws(problem: Problem, baseline: Baseline, livelier: Mapping[Sensor, float], sensor: Sensor) -> float:
    """Twice the log-likelihood that what a simulated flight's flaws leave open has in this one.

    A livelier flight shows more of them. Their parameters are as uncertain as a part of their own evidence, and as what
    was too little to be asked for beside them. They are common to all instances; noise that is fitted anew grows to
    meet them, so that evidence counts as ``n log(1 + gain / n)``.
    """
    there = baseline.changes.get(sensor, 0.0)
    if there == 0.0:
        return 0.0
    part = max(_DIFFERENT * baseline.gains.get(sensor, 0.0), baseline.indifferent.get(sensor, 0.0))
    gain = max(1.0, livelier.get(sensor, 0.0) / there) * part
    numbers = max(3 * len(t.t) for t in problem.traces if t.sensor is sensor)
    return numbers * math.log1p(gain / numbers)


def _changes(problem: Problem, changed: Problem) -> dict[Sensor, float]:
    """By sensor, sum of squares of what effects change of the ideal readings."""
    total: dict[Sensor, float] = {}
    for before, after in zip(problem.traces, changed.traces, strict=True):
        step = (after.ideal - before.ideal)[before.observed]
        total[before.sensor] = total.get(before.sensor, 0.0) + float((step**2).sum())
    return total


def _indifferent(problem: Problem) -> dict[Sensor, float]:
    """Twice the log-likelihood by sensor that two flights differ by anyway."""
    return {s: _SMALL * sum(3 * len(t.t) for t in problem.traces if t.sensor is s) for s in Sensor}
