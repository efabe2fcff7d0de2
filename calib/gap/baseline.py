"""What another recording already shows against its own ideal: flaws of the reference and traits of the simulator.

Where the simulator flew another flight (GAP 3.5b c), or a nominal recording has a pose of its own, both are held
against an ideal sensor, and the gap is what the real one has and the other has not: what the other shows is put into
the ideal reading of the real.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from calib.gap.bands import split
from calib.gap.contest import Contest
from calib.gap.effects import catalogue
from calib.gap.effects.base import Effect, MeanEffect
from calib.gap.estimates import estimates_of
from calib.gap.floors import Floors
from calib.gap.hypotheses import hypotheses_of
from calib.gap.model import setting_of, starting_model
from calib.gap.noise_fit import refitted, starting_noise
from calib.gap.problem import Flaw, Floor, Problem, Trace
from calib.gap.replay import with_effects, with_effects_in
from calib.gap.schema import EffectEstimate, Estimate, Evidence
from calib.gap.selection import last_gains, select
from calib.gap.views import views_of
from calib.recording import Sensor

_CARRIED = (
    *("_bias", "_scale", "_misalignment", "_rotation", "_lever_arm", "_delay", "_low_pass", "clock_drift"),
    *("_hard_iron", "_soft_iron", "_earth_field", "reference_attitude"),
)
"""Ends of the ids of what another flight shows alike; what depends on temperature, current or an event is not."""
_OF_ONE_RECORDING = ("clock_drift", "accel_bias", "gyro_bias")
"""Two clocks may be set alike anywhere in a recording, and a bias is another one each time that a sensor is switched
on; a simulator's is always the same.
"""
_DIFFERENT = 0.1
"""Part of the evidence of a simulated flight's own flaws that a real one must have beyond them."""
_OPEN, _OPEN_BIAS = 1.0 / 3.0, 1.5
"""Part of a flaw by which two recordings against poses differ; of a bias all, and its estimate's own error."""
_SMALL = 0.03
"""Evidence a number below which two flights differ anyway: a re-estimated ideal sensor is not surer of itself."""
_SMALL_LEVEL = 0.006
"""The same of levels of readings against a pose, which are a few numbers of a spectrum."""
_SMALL_JOINS = 0.003
"""And of what is in the model beside a pose, so that nothing else takes its place."""
_LOUD = 0.3
"""Evidence a number of noise of twice the power: 1 - log 2. It differs by as much from minute to minute."""
_ROUNDS, _SETTLED = 5, 0.1
"""Times at most that the noise is learned, first with the flaws, then beside them; and the share by which what they
gain may still change.
"""


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


@dataclass(frozen=True, eq=False)
class _Shown:
    """An effect, its gain beside all the others, and the sensors on which it is seen."""

    effect: EffectEstimate
    gain: float
    sensors: tuple[Sensor, ...]


def baseline_of(problem: Problem, alpha: float) -> Baseline:
    """What of the mean a simulated flight shows beside its own ideal; what happens once is not carried over.

    The noise that was learned from this flight has in it what is looked for: it is fitted anew beside it.
    """
    problem = replace(problem, traces=tuple(map(_undeclared, problem.traces)))
    small = _indifferent(problem, _SMALL)
    found = _shown(problem, alpha, Floors(Floor(small, small, small, small)))
    largest = {t.sensor: 0.0 for t in problem.traces}
    for one in found:
        for sensor in one.sensors:
            largest[sensor] = max(largest[sensor], one.gain)
    effects = tuple(one.effect for one in found)
    changed, _ = with_effects(problem, effects, shared=True)
    return Baseline(effects, largest, _changes(problem, changed), small)


@dataclass(frozen=True, eq=False)
class Flaws:
    """What a nominal recording shows against its own pose: effects that another one has as well, and its biases."""

    effects: tuple[EffectEstimate, ...]
    biases: tuple[EffectEstimate, ...] = ()

    def in_ideal(self, traces: Sequence[Trace]) -> tuple[Trace, ...]:
        """Traces of the nominal recording beside what it reads with them: what is left is its noise."""
        return with_effects_in(traces, self.effects)[0]


def flaws_of(learned: Callable[[Callable[[Sequence[Trace]], tuple[Trace, ...]]], Problem], alpha: float) -> Flaws:
    """What of the mean a nominal recording shows beside a pose of its own.

    Parameters
    ----------
    learned
        Makes the problem of the nominal recording, its noise learned beside the flaws that are put into the ideal.
    alpha
        Chance that anything is found where there is nothing.
    """
    flaws, before = Flaws(()), 0.0
    for _ in range(_ROUNDS):
        problem = learned(flaws.in_ideal)
        shown = _shown(problem, alpha, Floors(), _OF_ONE_RECORDING)
        gain = sum(one.gain for one in shown)
        flaws = Flaws(tuple(one.effect for one in shown), tuple(map(_bias_of, _single(problem.traces))))
        if abs(gain - before) <= _SETTLED * before:
            break
        before = gain
    return flaws


def _single(traces: Sequence[Trace]) -> list[Trace]:
    """Those of sensors that have a bias, against the pose."""
    return [t for t in traces if t.against is None and t.sensor in (Sensor.ACCEL, Sensor.GYRO)]


def _bias_of(trace: Trace) -> EffectEstimate:
    """The mean residual, whether it is significant or not."""
    mean = trace.residual[trace.observed].mean(axis=0)
    values = tuple(
        Estimate(f"bias.{a}", float(v), 0.0, (float(v), float(v)), trace.unit) for a, v in zip("xyz", mean, strict=True)
    )
    instances = tuple(i + 1 for i in trace.instances)
    return EffectEstimate(f"{trace.sensor}_bias", trace.sensor, instances, values, Evidence(0.0, 3, 1.0, 0.0, 0.0))


def _shown(problem: Problem, alpha: float, floors: Floors, without: Sequence[str] = ()) -> list[_Shown]:
    """Steady effects on the mean that are significant beside each other."""
    views = split(views_of(problem, {}, {}))
    hypotheses, _ = hypotheses_of([e for e in catalogue() if _carried(e) and e.id not in without], views)
    if not views or not hypotheses:
        return []
    setting = setting_of(views)
    contest = Contest(hypotheses, floors=floors)
    chosen = select(refitted(starting_model(setting, starting_noise(setting))).model, contest, alpha)
    gains = {key: gain for key, (gain, _, _) in last_gains(chosen.model, contest).items()}
    found = []
    for term in chosen.model.terms:
        effect, gain = term.hypothesis.effect, gains[term.hypothesis.key]
        instances = tuple(i + 1 for i in term.hypothesis.instances)
        evidence = Evidence(gain, len(term.values), 0.0, 1.0, 0.0)
        estimate = EffectEstimate(effect.id, effect.sensor, instances, estimates_of(chosen, term), evidence)
        seen = dict.fromkeys(v.sensor for v in views if effect.shared or v.sensor is effect.sensor)
        found.append(_Shown(estimate, gain, tuple(seen)))
    return found


def _undeclared(trace: Trace) -> Trace:
    """Without noise that was learned; what is declared for certain stays."""
    if trace.psd is None and math.isinf(trace.sigma_dof):
        return trace
    return replace(trace, sigma=None, sigma_dof=math.inf, psd=None, psd_hz=None, own_psd=None)


def beside(problem: Problem, baseline: Baseline) -> Problem:
    """`problem` held against a simulator that has what its own flight shows."""
    changed, _ = with_effects(problem, baseline.effects, shared=True)
    livelier = _changes(problem, changed)
    small = _indifferent(problem, _SMALL)
    floor = {s: max(small[s], _flaws(problem, baseline, livelier, s)) for s in small}
    return replace(changed, floor=Floor(floor, floor, floor, floor))


def beside_flaws(problem: Problem, flaws: Flaws) -> Problem:
    """`problem` held against a pose that has the flaws which a nominal recording shows against its own.

    A bias is not carried over, but one as large is no gap.
    """
    changed, _ = with_effects(problem, flaws.effects, shared=True)
    floor = Floor(
        joins=_indifferent(problem, _SMALL_JOINS),
        lasting=_indifferent(problem, _SMALL),
        level=_indifferent(problem, _SMALL_LEVEL),
        loud=_indifferent(problem, _LOUD),
    )
    parts = (*(Flaw(e, _OPEN) for e in flaws.effects), *(Flaw(e, _OPEN_BIAS) for e in flaws.biases))
    return replace(changed, floor=floor, flaws=parts)


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


def _indifferent(problem: Problem, each: float) -> dict[Sensor, float]:
    """Twice the log-likelihood by sensor that two flights differ by anyway, `each` for a number."""
    return {s: each * sum(3 * len(t.t) for t in problem.traces if t.sensor is s) for s in Sensor}
