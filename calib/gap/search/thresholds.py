"""What an effect must gain to be a gap, where two recordings differ anyway."""

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
    """Twice the log-likelihoods of a :class:`calib.gap.problem.MinimumGain`, and what nuisance effects leave open.

    `own`: by hypothesis, what it would gain if a part of the nuisance effects were still there
    (:mod:`calib.gap.companion.nuisance_gain`).
    """

    minimum_gain: MinimumGain = field(default_factory=MinimumGain)
    own: Mapping[Key, float] = field(default_factory=dict)

    def to_enter(self, hypothesis: Hypothesis) -> float:
        """Gain below which a hypothesis stays out of the model."""
        effect = hypothesis.effect
        if isinstance(effect, NoiseEffect):
            unsteady = effect.drifts or effect.variance is not None
            least = self.minimum_gain.drift_entry if unsteady else self.minimum_gain.noise_entry
            return least.get(effect.sensor, 0.0)
        if Trait.LEVEL in effect.traits:
            return self.minimum_gain.level.get(effect.sensor, 0.0) + self.own.get(hypothesis.key, 0.0)
        return self.minimum_gain.steady_entry.get(effect.sensor, 0.0)

    def to_report(self, hypothesis: Hypothesis) -> float:
        """Gain below which a hypothesis in the model is no gap; noise that wanders has taken its part of a shift."""
        effect = hypothesis.effect
        if isinstance(effect, NoiseEffect):
            return self.minimum_gain.noise_report.get(effect.sensor, 0.0)
        if Trait.LEVEL in effect.traits:
            return min(
                self.minimum_gain.level.get(effect.sensor, 0.0), self.minimum_gain.steady_entry.get(effect.sensor, 0.0)
            )
        return self.minimum_gain.steady_report.get(effect.sensor, 0.0) + self.own.get(hypothesis.key, 0.0)

    def lasting(self, sensor: Sensor) -> float:
        """Below which what is left over on a sensor is no gap."""
        return self.minimum_gain.steady_report.get(sensor, 0.0)


def accepted_difference(problem: GapProblem, each: float) -> dict[Sensor, float]:
    """Twice the log-likelihood by sensor that two recordings differ by anyway, `each` for a number."""
    return {s: each * sum(3 * len(t.t) for t in problem.traces if t.sensor is s) for s in Sensor}
