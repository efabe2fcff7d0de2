"""The problem of a recording, without the effects that its simulated or nominal companion also shows.

Two kinds of companion are first compared with an ideal sensor: a simulator that flew another trajectory (GAP 3.5b c),
and a nominal recording with its own pose. The effects that they show are errors of the reference or properties of the
simulator (decision 0007). They are added to the ideal reading of the real recording, so that the gap is what only the
real one has.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from mavcal.calib.gap.companion.steady_effects import steady_effects
from mavcal.calib.gap.companion.touch_down import without_touch_down
from mavcal.calib.gap.effects.replay import with_effects, with_effects_in
from mavcal.calib.gap.problem import GapProblem, MinimumGain, NuisanceEffect, ReferenceInfo, Trace
from mavcal.calib.gap.progress import GapPace
from mavcal.calib.gap.reference import (
    build,
    companion_with_pose,
    have_separate_poses,
    is_another_flight,
    prepared,
    with_common_channels,
)
from mavcal.calib.gap.remembered import one_diagnosis
from mavcal.calib.gap.schema import EffectEstimate, EffectEvidence, ParameterEstimate
from mavcal.calib.gap.search import prices
from mavcal.calib.gap.search.thresholds import GainThresholds, accepted_difference
from mavcal.calib.recording import Recording, Sensor


@one_diagnosis()
def problem_of(
    real: Recording, sim: Recording | None, nominal: Sequence[Recording], alpha: float, pace: GapPace | None = None
) -> GapProblem:
    """The problem of `real`, with the effects of its companion added to the ideal readings.

    `pace` bounds the search for them. Errors are those of :func:`calib.gap.reference.build`.
    """
    if sim is not None and is_another_flight(real, sim):
        real, sim = with_common_channels(real, sim)
        baseline = simulated_baseline_of(without_touch_down(build(sim, sim, nominal), sim), alpha, pace)
        flown = without_touch_down(build(real, sim, nominal, nuisance=baseline.added_to_ideal, companion=sim), real)
        return compared_with_simulator(flown, baseline)
    apart = sim is not None and have_separate_poses(real, sim)
    companions = (sim, *nominal) if sim is not None and apart else tuple(nominal)
    if (sim is None or apart) and (other := companion_with_pose(real, companions)) is not None:
        its = prepared(other, None, companions)
        nuisance = nominal_baseline_of(lambda known: its.problem(known, other), alpha, pace, simulated=apart)
        return compared_with_nominal(
            build(real, None, companions, nuisance=nuisance.added_to_ideal, companion=other), nuisance
        )
    return build(real, sim, nominal)


_OF_ONE_SIMULATION = ("clock_drift",)
_OF_ONE_RECORDING = (*_OF_ONE_SIMULATION, "accel_bias", "gyro_bias")
"""Effects that differ from recording to recording. Two clocks may agree at any time. A bias differs after every
power-up, though a simulator's is always the same.
"""
_UNCERTAIN_SHARE, _UNCERTAIN_BIAS = 1.0 / 3.0, 1.5
"""Fraction of a nuisance effect by which two recordings against poses differ. A bias differs by all of it, plus the
error of its estimate. Source: decision 7 for the third. The other is chosen, not measured: the bias plus half of it for
the error of its estimate."""
_LEVEL_DIFFERENCE = 0.006
"""Gain per number of level shifts, instead of `prices.FLIGHT_DIFFERENCE`: they occupy few bins of a spectrum. Chosen,
not measured: a fifth of that difference."""
_ENTRY_DIFFERENCE = 0.003
"""Gain per number for an effect to enter the model unreported, so that no other effect absorbs it. Chosen, not
measured: a tenth of that difference, so that it enters first."""
_NOISE_DIFFERENCE = 0.3
"""Gain per number of noise at twice the power, by which noise varies from minute to minute. Source: deviance `r - 1 -
log r` of a ratio r of powers, 1 - log 2 at r = 2."""
_ROUNDS, _CONVERGED = 5, 0.1
"""Most iterations of learning the noise beside the nuisance effects, and the relative change of their gain at
convergence. Chosen, not measured: five bound the time, and a tenth of a gain decides nothing."""


@dataclass(frozen=True, eq=False)
class NominalBaseline:
    """Effects that a nominal recording shows against its own pose, and its mean residuals as `biases`."""

    effects: tuple[EffectEstimate, ...]
    biases: tuple[EffectEstimate, ...] = ()

    def added_to_ideal(self, traces: Sequence[Trace]) -> tuple[Trace, ...]:
        """Traces of the nominal recording with its effects in the ideal reading: the residual is its noise."""
        return with_effects_in(traces, self.effects)[0]


def nominal_baseline_of(
    learned: Callable[[Callable[[Sequence[Trace]], tuple[Trace, ...]]], GapProblem],
    alpha: float,
    pace: GapPace | None = None,
    *,
    simulated: bool = False,
) -> NominalBaseline:
    """Steady effects that a nominal recording shows against its own pose.

    Noise and effects are estimated in turn until the gain of the effects converges.

    Parameters
    ----------
    learned
        Makes the problem of the nominal recording, with noise learned beside the nuisance effects added to the ideal
        reading.
    alpha
        Chance that anything is found where there is nothing.
    pace
        How long it may take; None: as long as it takes.
    simulated
        Whether the recording is a simulator's: its biases are then taken off as well.
    """
    gone = _OF_ONE_SIMULATION if simulated else _OF_ONE_RECORDING
    baseline, before = NominalBaseline(()), 0.0
    for _ in range(_ROUNDS):
        problem = learned(baseline.added_to_ideal)
        found = steady_effects(problem, alpha, GainThresholds(), gone, pace).supported
        gain = sum(one.gain for one in found)
        baseline = NominalBaseline(
            tuple(one.effect for one in found), tuple(map(_bias_estimate, _inertial_traces(problem.traces)))
        )
        if abs(gain - before) <= _CONVERGED * before or (pace is not None and pace.ends()):
            break
        before = gain
    return baseline


def _inertial_traces(traces: Sequence[Trace]) -> list[Trace]:
    """Traces of accelerometers and gyroscopes against the pose."""
    return [t for t in traces if t.against is None and t.sensor in (Sensor.ACCEL, Sensor.GYRO)]


def _bias_estimate(trace: Trace) -> EffectEstimate:
    """The mean residual of a trace as a bias, significant or not."""
    mean = trace.residual[trace.observed].mean(axis=0)
    values = tuple(
        ParameterEstimate(f"bias.{a}", float(v), 0.0, (float(v), float(v)), trace.unit)
        for a, v in zip("xyz", mean, strict=True)
    )
    instances = tuple(i + 1 for i in trace.instances)
    return EffectEstimate(
        f"{trace.sensor}_bias", trace.sensor, instances, values, EffectEvidence(0.0, 3, 1.0, 0.0, 0.0)
    )


def compared_with_nominal(problem: GapProblem, baseline: NominalBaseline) -> GapProblem:
    """`problem` with the effects of the nominal recording in the ideal reading.

    Its biases are not added, but a bias up to that size is not reported.
    """
    changed, _ = with_effects(problem, baseline.effects, shared=True)
    minimum_gain = MinimumGain(
        steady_entry=accepted_difference(problem, _ENTRY_DIFFERENCE),
        steady_report=accepted_difference(problem, prices.FLIGHT_DIFFERENCE),
        level=accepted_difference(problem, _LEVEL_DIFFERENCE),
        noise_report=accepted_difference(problem, _NOISE_DIFFERENCE),
    )
    nuisance = (
        *(NuisanceEffect(e, _UNCERTAIN_SHARE) for e in baseline.effects),
        *(NuisanceEffect(e, _UNCERTAIN_BIAS) for e in baseline.biases),
    )
    return replace(
        changed, minimum_gain=minimum_gain, nuisance=nuisance, warnings=(*changed.warnings, *_notices(baseline))
    )


def _notices(baseline: NominalBaseline) -> tuple[str, ...]:
    """Notice of the subtracted effects for the report; empty without any."""
    if not baseline.effects:
        return ()
    named = ", ".join(
        f"{e.id} ({', '.join(f'{p.name} {p.value:.3g} {p.unit}' for p in e.params)})" for e in baseline.effects
    )
    return (f"the nominal recording shows this against its own pose, and it was taken off: {named}",)


_MOVEMENT_RATIO = 3.0
"""Ratio of the movement (rms) to that of the simulated flight, above which the report warns. Chosen, not measured: two
flights of one mission differ by less."""
_UNCERTAIN_EVIDENCE = 0.1
"""Evidence of a real effect beyond a simulated flight's own nuisance effects, as a fraction of theirs. Chosen, not
measured: a tenth is small beside the effect itself."""

_OWN_EVIDENCE = 0.04
"""The same for effects on a compass within the reference error of the simulated flight. That error is fitted in the
real flight too, but attitude errors have more forms. Chosen, not measured: such a fit is accurate to a fifth. Attitudes
known to 0.7 degrees caused a false saturation of 0.1 uT on a noiseless compass. An inertial unit errs in the same way
as its own trajectory."""


@dataclass(frozen=True, eq=False)
class SimulatedBaseline:
    """Effects that a simulated flight shows against its own ideal reading, and the `reference` of that comparison.

    `effects` are expected in another flight too. `own` effects include errors of this flight's reference, which differ
    from flight to flight. `uncertain` effects, those expected elsewhere and those that fit noise, measure how far two
    flights differ.

    By sensor: `gains` of the largest uncertain effect, and `own_gains` of the largest own one. `changes` is the sum of
    squares that all of them add to the ideal reading. `movement` is the variance of the ideal reading, and
    `accepted_difference` the gain below which no effect was searched for. `traces` are those of the flight, with
    `effects` in the ideal reading.
    """

    effects: tuple[EffectEstimate, ...]
    own: tuple[EffectEstimate, ...]
    uncertain: tuple[EffectEstimate, ...]
    gains: Mapping[Sensor, float]
    own_gains: Mapping[Sensor, float]
    changes: Mapping[Sensor, float]
    movement: Mapping[Sensor, float]
    accepted_difference: Mapping[Sensor, float]
    reference: ReferenceInfo
    traces: tuple[Trace, ...]

    def added_to_ideal(self, traces: Sequence[Trace]) -> tuple[Trace, ...]:
        """Traces of the simulator with its effects in the ideal reading: the residual is its noise."""
        return with_effects_in(traces, self.own)[0]


def simulated_baseline_of(problem: GapProblem, alpha: float, pace: GapPace | None = None) -> SimulatedBaseline:
    """Steady effects that a simulated flight shows against its own ideal reading.

    Noise learned from this flight contains these effects; it is therefore fitted again beside them.
    """
    problem = replace(problem, traces=tuple(map(_without_learned_noise, problem.traces)))
    small = accepted_difference(problem, prices.FLIGHT_DIFFERENCE)
    found = steady_effects(
        problem, alpha, GainThresholds(MinimumGain(small, small, small, small, drift_entry=small)), pace=pace
    )
    largest, within = ({t.sensor: 0.0 for t in problem.traces} for _ in range(2))
    for gains, ones in ((largest, (*found.supported, *found.doubted)), (within, found.own)):
        for one in ones:
            for sensor in one.sensors:
                gains[sensor] = max(gains[sensor], one.gain)
    effects, own, doubted = (
        tuple(one.effect for one in which) for which in (found.supported, found.own, found.doubted)
    )
    uncertain = (*effects, *doubted)
    changes = _squared_changes(problem, uncertain)
    moves = _movement_variance(problem)
    traces, _ = with_effects_in(problem.traces, effects)
    return SimulatedBaseline(effects, own, uncertain, largest, within, changes, moves, small, problem.reference, traces)


def _without_learned_noise(trace: Trace) -> Trace:
    """The trace without noise that was learned; noise that is declared as exact stays."""
    if trace.psd is None and math.isinf(trace.sigma_dof):
        return trace
    return replace(trace, sigma=None, sigma_dof=math.inf, psd=None, psd_hz=None, own_psd=None)


def compared_with_simulator(problem: GapProblem, baseline: SimulatedBaseline) -> GapProblem:
    """`problem` with the effects of the simulated flight in the ideal reading, and the corresponding minimum gains."""
    changed, _ = with_effects(problem, baseline.effects, shared=True)
    livelier = _squared_changes(problem, baseline.uncertain)
    small = accepted_difference(problem, prices.FLIGHT_DIFFERENCE)
    own = {s: _nuisance_gain(problem, baseline, livelier, s) for s in small}
    moves = _movement_variance(problem)
    level = {s: max(small[s], own[s]) for s in small}
    noise = {s: _scaled_by_movement(problem, small[s], moves, baseline.movement, s) for s in small}
    least = {s: max(noise[s], own[s]) for s in small}
    reference = _combined_reference(problem.reference, baseline.reference)
    warnings = (*changed.warnings, *_calm_flight_warnings(moves, baseline.movement))
    # The uncertain part of a mean varies with the movement: it looks like drift noise or motor noise, not like
    # stationary noise.
    minimum_gain = MinimumGain(least, least, level, noise, drift_entry=least)
    return replace(
        changed, minimum_gain=minimum_gain, reference=reference, warnings=warnings, companion=baseline.traces
    )


def _calm_flight_warnings(moves: Mapping[Sensor, float], before: Mapping[Sensor, float]) -> Iterator[str]:
    """A warning for each sensor that the simulated flight moved far less than the real one."""
    for sensor, square in moves.items():
        calm = before.get(sensor, 0.0)
        if 0.0 < _MOVEMENT_RATIO**2 * calm < square:
            times = math.sqrt(square / calm)
            yield (
                f"{sensor}: this flight moves {times:.2g} times as much as the other one: only a large error that goes "
                "with the movement can be found; make the simulated vehicle move as much as the real one"
            )


def _scaled_by_movement(
    problem: GapProblem, small: float, moves: Mapping[Sensor, float], before: Mapping[Sensor, float], sensor: Sensor
) -> float:
    """The accepted difference `small`, raised for a flight that moves more than the simulated one did.

    A reference errs in proportion to the movement: by its scale, its timing and its bandwidth. The gain grows with the
    square of that error. A calmer flight has no lower limit.
    """
    calm = before.get(sensor, 0.0)
    if not 0.0 < calm < moves.get(sensor, 0.0):
        return small
    return max(small, _gain_with_refitted_noise(problem, small * moves[sensor] / calm, sensor))


def _movement_variance(problem: GapProblem) -> dict[Sensor, float]:
    """By sensor, the variance of the ideal reading; the largest of the instances."""
    found: dict[Sensor, float] = {}
    for trace in problem.traces:
        if trace.against is None:
            square = float(trace.ideal[trace.observed].var(axis=0).sum())
            found[trace.sensor] = max(found.get(trace.sensor, 0.0), square)
    return found


def _combined_reference(real: ReferenceInfo, simulated: ReferenceInfo) -> ReferenceInfo:
    """The reference of the real flight; its internal estimates have the errors of both flights together."""
    return replace(
        real,
        gyro_sd=_combined(real.gyro_sd, simulated.gyro_sd),
        field_sd=_combined(real.field_sd, simulated.field_sd),
        accel_sd=_combined(real.accel_sd, simulated.accel_sd),
    )


def _combined(own: tuple[float, ...], other: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(map(math.hypot, own, other)) if len(own) == len(other) else own


def _nuisance_gain(
    problem: GapProblem, baseline: SimulatedBaseline, livelier: Mapping[Sensor, float], sensor: Sensor
) -> float:
    """Gain in this flight from the uncertainty of the baseline's estimates.

    The uncertainty is a share of the evidence for the baseline, at least the accepted difference. It is common to all
    instances and grows with the movement. Refitted noise absorbs a part: gains count as ``n log(1 + gain / n)``.
    """
    own = _OWN_EVIDENCE * baseline.own_gains.get(sensor, 0.0) if sensor is Sensor.MAG else 0.0
    there = baseline.changes.get(sensor, 0.0)
    if there == 0.0:
        return _gain_with_refitted_noise(problem, own, sensor)
    part = max(_UNCERTAIN_EVIDENCE * baseline.gains.get(sensor, 0.0), baseline.accepted_difference.get(sensor, 0.0))
    gain = max(1.0, livelier.get(sensor, 0.0) / there) * part
    return _gain_with_refitted_noise(problem, max(gain, own), sensor)


def _gain_with_refitted_noise(problem: GapProblem, gain: float, sensor: Sensor) -> float:
    """`gain` once the noise is fitted again; zero for a sensor that only the other flight has."""
    numbers = max((3 * len(t.t) for t in problem.traces if t.sensor is sensor), default=0)
    return numbers * math.log1p(gain / numbers) if numbers else 0.0


def _squared_changes(problem: GapProblem, effects: tuple[EffectEstimate, ...]) -> dict[Sensor, float]:
    """By sensor, the sum of squares of the change that the effects make to the ideal reading."""
    changed, _ = with_effects(problem, effects, shared=True)
    total: dict[Sensor, float] = {}
    for before, after in zip(problem.traces, changed.traces, strict=True):
        step = (after.ideal - before.ideal)[before.observed]
        total[before.sensor] = total.get(before.sensor, 0.0) + float((step**2).sum())
    return total
