"""Differences of a simulated flight from its own ideal: errors of the reference and traits of the simulator.

Where the simulator flew another flight (GAP 3.5b c), both logs are compared with an ideal sensor. The gap is what only
the real one has: what the simulated one shows is put into the ideal reading of the real.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from mavcal.calib.gap.companion.steady_effects import steady_effects
from mavcal.calib.gap.effects.replay import with_effects, with_effects_in
from mavcal.calib.gap.problem import GapProblem, MinimumGain, ReferenceInfo, Trace
from mavcal.calib.gap.schema import EffectEstimate
from mavcal.calib.gap.search import prices
from mavcal.calib.gap.search.thresholds import GainThresholds, accepted_difference
from mavcal.calib.recording import Sensor

_DIFFERENT = 0.1
"""Part of the evidence of a simulated flight's own nuisance effects that a real one must have beyond them."""


@dataclass(frozen=True, eq=False)
class Baseline:
    """Effects of a simulated flight, and the `reference` that it was compared with.

    By sensor: `gains` of the largest effect, and `changes` by all of them, as a sum of squares over the flight. Effects
    that gain less than `accepted_difference` were not looked for.
    """

    effects: tuple[EffectEstimate, ...]
    gains: Mapping[Sensor, float]
    changes: Mapping[Sensor, float]
    accepted_difference: Mapping[Sensor, float]
    reference: ReferenceInfo

    def in_ideal(self, traces: Sequence[Trace]) -> tuple[Trace, ...]:
        """`traces` of the simulator beside what it reads with its nuisance effects: what is left is its noise."""
        return with_effects_in(traces, self.effects)[0]


def baseline_of(problem: GapProblem, alpha: float) -> Baseline:
    """What of the mean a simulated flight shows beside its own ideal; what happens once is not carried over.

    The noise that was learned from this flight has in it what is looked for: it is fitted again beside it.
    """
    problem = replace(problem, traces=tuple(map(_undeclared, problem.traces)))
    small = accepted_difference(problem, prices.FLIGHT_DIFFERENCE)
    found = steady_effects(problem, alpha, GainThresholds(MinimumGain(small, small, small, small)))
    largest = {t.sensor: 0.0 for t in problem.traces}
    for one in found:
        for sensor in one.sensors:
            largest[sensor] = max(largest[sensor], one.gain)
    effects = tuple(one.effect for one in found)
    changed, _ = with_effects(problem, effects, shared=True)
    return Baseline(effects, largest, _changes(problem, changed), small, problem.reference)


def _undeclared(trace: Trace) -> Trace:
    """Without noise that was learned; what is declared for certain stays."""
    if trace.psd is None and math.isinf(trace.sigma_dof):
        return trace
    return replace(trace, sigma=None, sigma_dof=math.inf, psd=None, psd_hz=None, own_psd=None)


def beside(problem: GapProblem, baseline: Baseline) -> GapProblem:
    """`problem` compared with a simulator that has what its own flight shows."""
    changed, _ = with_effects(problem, baseline.effects, shared=True)
    livelier = _changes(problem, changed)
    small = accepted_difference(problem, prices.FLIGHT_DIFFERENCE)
    least = {s: max(small[s], _nuisance_gain(problem, baseline, livelier, s)) for s in small}
    reference = _of_both(problem.reference, baseline.reference)
    return replace(changed, minimum_gain=MinimumGain(least, least, least, least), reference=reference)


def _of_both(real: ReferenceInfo, simulated: ReferenceInfo) -> ReferenceInfo:
    """The reference of a real flight; the errors of what it estimated inside are those of both flights together."""
    pairs = ((real.gyro_sd, simulated.gyro_sd), (real.field_sd, simulated.field_sd))
    gyro, field = (tuple(map(math.hypot, a, b)) if len(a) == len(b) else a for a, b in pairs)
    return replace(real, gyro_sd=gyro, field_sd=field)


def _nuisance_gain(problem: GapProblem, baseline: Baseline, livelier: Mapping[Sensor, float], sensor: Sensor) -> float:
    """Twice the log-likelihood that what a simulated flight's nuisance effects leave open has in this one.

    A livelier flight shows more of them. Their parameters are as uncertain as a part of their own evidence, and as what
    was too little to be asked for beside them. They are common to all instances; noise that is fitted again grows to
    meet them, so that evidence counts as ``n log(1 + gain / n)``.
    """
    there = baseline.changes.get(sensor, 0.0)
    if there == 0.0:
        return 0.0
    part = max(_DIFFERENT * baseline.gains.get(sensor, 0.0), baseline.accepted_difference.get(sensor, 0.0))
    gain = max(1.0, livelier.get(sensor, 0.0) / there) * part
    numbers = max(3 * len(t.t) for t in problem.traces if t.sensor is sensor)
    return numbers * math.log1p(gain / numbers)


def _changes(problem: GapProblem, changed: GapProblem) -> dict[Sensor, float]:
    """By sensor, sum of squares of what effects change of the ideal readings."""
    total: dict[Sensor, float] = {}
    for before, after in zip(problem.traces, changed.traces, strict=True):
        step = (after.ideal - before.ideal)[before.observed]
        total[before.sensor] = total.get(before.sensor, 0.0) + float((step**2).sum())
    return total
