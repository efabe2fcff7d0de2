"""Differences of a simulated flight from its own ideal: errors of the reference and traits of the simulator.

Where the simulator flew another flight (GAP 3.5b c), both logs are compared with an ideal sensor. The gap is what only
the real one has: what the simulated one shows is put into the ideal reading of the real.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from mavcal.calib.gap.companion.steady_effects import steady_effects
from mavcal.calib.gap.effects.replay import with_effects, with_effects_in
from mavcal.calib.gap.problem import GapProblem, MinimumGain, ReferenceInfo, Trace
from mavcal.calib.gap.progress import GapPace
from mavcal.calib.gap.schema import EffectEstimate
from mavcal.calib.gap.search import prices
from mavcal.calib.gap.search.thresholds import GainThresholds, accepted_difference
from mavcal.calib.recording import Sensor

_CALM = 3.0
"""Times as much movement (rms) as in the simulated flight, beyond which a report says so. Chosen, not measured: two
flights of one mission differ by less."""
_DIFFERENT = 0.1
"""Part of the evidence of a simulated flight's own nuisance effects that a real one must have beyond them. Chosen, not
measured: a tenth is small beside the effect itself."""


@dataclass(frozen=True, eq=False)
class Baseline:
    """Effects found in a simulated flight, and the `reference` that it was compared with.

    `effects` are expected in another flight too. All that were `found` say how far two flights differ.

    By sensor: `gains` of the largest effect; `changes` by all that were found, as a sum of squares over the flight;
    `movement`, the mean square of the ideal readings about their mean. Effects that gain less than
    `accepted_difference` were not looked for.
    """

    effects: tuple[EffectEstimate, ...]
    found: tuple[EffectEstimate, ...]
    gains: Mapping[Sensor, float]
    changes: Mapping[Sensor, float]
    movement: Mapping[Sensor, float]
    accepted_difference: Mapping[Sensor, float]
    reference: ReferenceInfo

    def in_ideal(self, traces: Sequence[Trace]) -> tuple[Trace, ...]:
        """`traces` of the simulator beside what it reads with its nuisance effects: what is left is its noise."""
        return with_effects_in(traces, self.effects)[0]


def baseline_of(problem: GapProblem, alpha: float, pace: GapPace | None = None) -> Baseline:
    """What of the mean a simulated flight shows beside its own ideal; what happens once is not carried over.

    The noise that was learned from this flight has in it what is looked for: it is fitted again beside it.
    """
    problem = replace(problem, traces=tuple(map(_undeclared, problem.traces)))
    small = accepted_difference(problem, prices.FLIGHT_DIFFERENCE)
    found = steady_effects(problem, alpha, GainThresholds(MinimumGain(small, small, small, small)), pace=pace)
    largest = {t.sensor: 0.0 for t in problem.traces}
    for one in found.found:
        for sensor in one.sensors:
            largest[sensor] = max(largest[sensor], one.gain)
    effects, every = (tuple(one.effect for one in which) for which in (found.supported, found.found))
    changes = _changes(problem, every)
    return Baseline(effects, every, largest, changes, _movement(problem), small, problem.reference)


def _undeclared(trace: Trace) -> Trace:
    """Without noise that was learned; what is declared for certain stays."""
    if trace.psd is None and math.isinf(trace.sigma_dof):
        return trace
    return replace(trace, sigma=None, sigma_dof=math.inf, psd=None, psd_hz=None, own_psd=None)


def beside(problem: GapProblem, baseline: Baseline) -> GapProblem:
    """`problem` compared with a simulator that has what its own flight shows."""
    changed, _ = with_effects(problem, baseline.effects, shared=True)
    livelier = _changes(problem, baseline.found)
    small = accepted_difference(problem, prices.FLIGHT_DIFFERENCE)
    own = {s: _nuisance_gain(problem, baseline, livelier, s) for s in small}
    moves = _movement(problem)
    level = {s: max(small[s], own[s]) for s in small}
    noise = {s: _scaled_by_movement(problem, small[s], moves, baseline.movement, s) for s in small}
    least = {s: max(noise[s], own[s]) for s in small}
    reference = _of_both(problem.reference, baseline.reference)
    warnings = (*changed.warnings, *_calm_flight_warnings(moves, baseline.movement))
    minimum_gain = MinimumGain(least, least, level, noise)  # what is open of a mean makes no noise louder
    return replace(changed, minimum_gain=minimum_gain, reference=reference, warnings=warnings)


def _calm_flight_warnings(moves: Mapping[Sensor, float], before: Mapping[Sensor, float]) -> Iterator[str]:
    """Warn of each sensor that the simulated flight hardly moved."""
    for sensor, square in moves.items():
        calm = before.get(sensor, 0.0)
        if 0.0 < _CALM**2 * calm < square:
            times = math.sqrt(square / calm)
            yield (
                f"{sensor}: this flight moves {times:.2g} times as much as the other one: only a large error that goes "
                "with the movement can be found; make the simulated vehicle move as much as the real one"
            )


def _scaled_by_movement(
    problem: GapProblem, small: float, moves: Mapping[Sensor, float], before: Mapping[Sensor, float], sensor: Sensor
) -> float:
    """The accepted difference `small` of a flight that moves more than the simulated one did.

    A reference errs in proportion to the movement: by its scale, its timing and its bandwidth. Evidence grows with the
    square. A calmer flight is not expected to differ less.
    """
    calm = before.get(sensor, 0.0)
    if not 0.0 < calm < moves.get(sensor, 0.0):
        return small
    return max(small, _evidence(problem, small * moves[sensor] / calm, sensor))


def _movement(problem: GapProblem) -> dict[Sensor, float]:
    """By sensor, the mean square of what ideal sensors read about their mean; the largest of its instances."""
    found: dict[Sensor, float] = {}
    for trace in problem.traces:
        if trace.against is None:
            square = float(trace.ideal[trace.observed].var(axis=0).sum())
            found[trace.sensor] = max(found.get(trace.sensor, 0.0), square)
    return found


def _of_both(real: ReferenceInfo, simulated: ReferenceInfo) -> ReferenceInfo:
    """The reference of a real flight; the errors of what it estimated inside are those of both flights together."""
    pairs = ((real.gyro_sd, simulated.gyro_sd), (real.field_sd, simulated.field_sd))
    gyro, field = (tuple(map(math.hypot, a, b)) if len(a) == len(b) else a for a, b in pairs)
    return replace(real, gyro_sd=gyro, field_sd=field)


def _nuisance_gain(problem: GapProblem, baseline: Baseline, livelier: Mapping[Sensor, float], sensor: Sensor) -> float:
    """Twice the log-likelihood that what a simulated flight's nuisance effects leave open has in this one.

    A livelier flight shows more of them. Their parameters are as uncertain as a part of their own evidence, and as what
    was too little to be asked for beside them. They are common to all instances. Noise that is fitted again grows to
    meet them: evidence counts as ``n log(1 + gain / n)``.
    """
    there = baseline.changes.get(sensor, 0.0)
    if there == 0.0:
        return 0.0
    part = max(_DIFFERENT * baseline.gains.get(sensor, 0.0), baseline.accepted_difference.get(sensor, 0.0))
    gain = max(1.0, livelier.get(sensor, 0.0) / there) * part
    return _evidence(problem, gain, sensor)


def _evidence(problem: GapProblem, gain: float, sensor: Sensor) -> float:
    """A `gain` beside noise that is fitted again; zero for a sensor that only the other flight has."""
    numbers = max((3 * len(t.t) for t in problem.traces if t.sensor is sensor), default=0)
    return numbers * math.log1p(gain / numbers) if numbers else 0.0


def _changes(problem: GapProblem, effects: tuple[EffectEstimate, ...]) -> dict[Sensor, float]:
    """By sensor, sum of squares of what effects change of the ideal readings."""
    changed, _ = with_effects(problem, effects, shared=True)
    total: dict[Sensor, float] = {}
    for before, after in zip(problem.traces, changed.traces, strict=True):
        step = (after.ideal - before.ideal)[before.observed]
        total[before.sensor] = total.get(before.sensor, 0.0) + float((step**2).sum())
    return total
