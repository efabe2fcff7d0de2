"""What a nominal recording shows against a pose of its own is no gap of another recording (decision 0007)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from mavcal.calib.gap.companion.steady_effects import steady_effects
from mavcal.calib.gap.effects.replay import with_effects, with_effects_in
from mavcal.calib.gap.problem import GapProblem, MinimumGain, NuisanceEffect, Trace
from mavcal.calib.gap.progress import GapPace
from mavcal.calib.gap.schema import EffectEstimate, EffectEvidence, ParameterEstimate
from mavcal.calib.gap.search import prices
from mavcal.calib.gap.search.thresholds import GainThresholds, accepted_difference
from mavcal.calib.recording import Sensor

_OF_ONE_SIMULATION = ("clock_drift",)
_OF_ONE_RECORDING = (*_OF_ONE_SIMULATION, "accel_bias", "gyro_bias")
"""Two clocks may agree anywhere in a recording. A bias differs each time that a sensor is switched on, but a
simulator's is always the same.
"""
_OPEN, _OPEN_BIAS = 1.0 / 3.0, 1.5
"""Part of a nuisance effect by which two recordings against poses differ; a bias differs by all of itself, and by the
error of its estimate. Source: decision 7 for the third. The other is chosen, not measured: the bias and half as much
for the error of its estimate."""
_SMALL_LEVEL = 0.006
"""Evidence a number, beside `prices.FLIGHT_DIFFERENCE`, of level shifts: they are a few numbers of a spectrum. Chosen,
not measured: a fifth of that difference."""
_SMALL_JOINS = 0.003
"""The same of what is in the model, so that nothing else takes its place, and not reported. Chosen, not measured: a
tenth of that difference, so that it joins first."""
_LOUD = 0.3
"""Evidence a number of noise of twice the power; noise differs by as much from minute to minute. Source: deviance `r -
1 - log r` of a ratio r of powers, 1 - log 2 at r = 2."""
_ROUNDS, _SETTLED = 5, 0.1
"""Times at most that the noise is learned, first with the nuisance effects, then beside them. The second is the
share by which their gain may still change. Chosen, not measured: five bound the time, and a tenth of a gain decides
nothing."""


@dataclass(frozen=True, eq=False)
class NominalBaseline:
    """What a nominal recording shows against its own pose: effects that another one has as well, and its biases."""

    effects: tuple[EffectEstimate, ...]
    biases: tuple[EffectEstimate, ...] = ()

    def in_ideal(self, traces: Sequence[Trace]) -> tuple[Trace, ...]:
        """Traces of the nominal recording beside what it reads with them: what is left is its noise."""
        return with_effects_in(traces, self.effects)[0]


def nominal_baseline_of(
    learned: Callable[[Callable[[Sequence[Trace]], tuple[Trace, ...]]], GapProblem],
    alpha: float,
    pace: GapPace | None = None,
    *,
    simulated: bool = False,
) -> NominalBaseline:
    """What of the mean a nominal recording shows beside a pose of its own.

    Parameters
    ----------
    learned
        Makes the problem of the nominal recording, its noise learned beside the nuisance effects that are put into
        the ideal.
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
        problem = learned(baseline.in_ideal)
        found = steady_effects(problem, alpha, GainThresholds(), gone, pace).supported
        gain = sum(one.gain for one in found)
        baseline = NominalBaseline(tuple(one.effect for one in found), tuple(map(_bias_of, _single(problem.traces))))
        if abs(gain - before) <= _SETTLED * before or (pace is not None and pace.ends()):
            break
        before = gain
    return baseline


def _single(traces: Sequence[Trace]) -> list[Trace]:
    """Those of sensors that have a bias, against the pose."""
    return [t for t in traces if t.against is None and t.sensor in (Sensor.ACCEL, Sensor.GYRO)]


def _bias_of(trace: Trace) -> EffectEstimate:
    """The mean residual, whether it is significant or not."""
    mean = trace.residual[trace.observed].mean(axis=0)
    values = tuple(
        ParameterEstimate(f"bias.{a}", float(v), 0.0, (float(v), float(v)), trace.unit)
        for a, v in zip("xyz", mean, strict=True)
    )
    instances = tuple(i + 1 for i in trace.instances)
    return EffectEstimate(
        f"{trace.sensor}_bias", trace.sensor, instances, values, EffectEvidence(0.0, 3, 1.0, 0.0, 0.0)
    )


def beside_nominal(problem: GapProblem, baseline: NominalBaseline) -> GapProblem:
    """`problem` compared with a pose that has the effects that a nominal recording shows against its own.

    A bias is not carried over, but one as large is no gap.
    """
    changed, _ = with_effects(problem, baseline.effects, shared=True)
    minimum_gain = MinimumGain(
        joins=accepted_difference(problem, _SMALL_JOINS),
        lasting=accepted_difference(problem, prices.FLIGHT_DIFFERENCE),
        level=accepted_difference(problem, _SMALL_LEVEL),
        loud=accepted_difference(problem, _LOUD),
    )
    nuisance = (
        *(NuisanceEffect(e, _OPEN) for e in baseline.effects),
        *(NuisanceEffect(e, _OPEN_BIAS) for e in baseline.biases),
    )
    return replace(
        changed, minimum_gain=minimum_gain, nuisance=nuisance, warnings=(*changed.warnings, *_said(baseline))
    )


def _said(baseline: NominalBaseline) -> tuple[str, ...]:
    """What was taken off, for who reads the report; nothing where nothing was."""
    if not baseline.effects:
        return ()
    named = ", ".join(
        f"{e.id} ({', '.join(f'{p.name} {p.value:.3g} {p.unit}' for p in e.params)})" for e in baseline.effects
    )
    return (f"the nominal recording shows this against its own pose, and it was taken off: {named}",)
