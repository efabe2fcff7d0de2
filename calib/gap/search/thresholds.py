"""Minimum gains of effects, above the usual difference of two recordings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mavcal.calib.gap.effects.base import NoiseEffect
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.model.hypotheses import Hypothesis, Key
from mavcal.calib.gap.problem import GapProblem, MinimumGain
from mavcal.calib.recording import Sensor


@dataclass(frozen=True)
class GainThresholds:
    """Minimum gains of hypotheses, in twice the log-likelihood.

    `own` holds, by hypothesis, the gain from the uncertainty of nuisance effects
    (:mod:`calib.gap.companion.nuisance_gain`).
    """

    minimum_gain: MinimumGain = field(default_factory=MinimumGain)
    own: Mapping[Key, float] = field(default_factory=dict)

    def to_enter(self, hypothesis: Hypothesis) -> float:
        """Gain below which a hypothesis does not enter the model."""
        effect = hypothesis.effect
        if isinstance(effect, NoiseEffect):
            unsteady = effect.drifts or effect.variance is not None
            least = self.minimum_gain.drift_entry if unsteady else self.minimum_gain.noise_entry
            return least.get(effect.sensor, 0.0)
        if Trait.LEVEL in effect.traits:
            return self.minimum_gain.level.get(effect.sensor, 0.0) + self.own.get(hypothesis.key, 0.0)
        return self.minimum_gain.steady_entry.get(effect.sensor, 0.0)

    def to_report(self, hypothesis: Hypothesis) -> float:
        """Gain below which a hypothesis is not reported; drift noise may have absorbed part of a level shift."""
        effect = hypothesis.effect
        if isinstance(effect, NoiseEffect):
            return self.minimum_gain.noise_report.get(effect.sensor, 0.0)
        if Trait.LEVEL in effect.traits:
            return min(
                self.minimum_gain.level.get(effect.sensor, 0.0), self.minimum_gain.steady_entry.get(effect.sensor, 0.0)
            )
        return self.minimum_gain.steady_report.get(effect.sensor, 0.0) + self.own.get(hypothesis.key, 0.0)

    def lasting(self, sensor: Sensor) -> float:
        """Gain below which the residual of a sensor is not reported."""
        return self.minimum_gain.steady_report.get(sensor, 0.0)


def accepted_difference(problem: GapProblem, each: float) -> dict[Sensor, float]:
    """By sensor, the gain by which any two recordings differ, with `each` for every sample of an axis."""
    return {s: each * sum(3 * len(t.t) for t in problem.traces if t.sensor is s) for s in Sensor}
