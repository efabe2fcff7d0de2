"""What the noise says of a filter: a sensor's own filter passes its noise as it passes the movement (GAP 3.1).

Over the little band in which vehicles move, a filter is a delay; beyond it the noise tells them apart. Rounding comes
after the filter and is not shaped. Only the form counts, not the level: a quieter sensor is no filter.
"""

from __future__ import annotations

import math

import numpy as np

from calib.gap.effects.base import MeanEffect
from calib.gap.hypotheses import Hypothesis
from calib.gap.model import Model
from calib.gap.noise_fit import is_declared
from calib.recording import Sensor

_ABOVE = 0.25
"""Share of the Nyquist frequency below which what is left may be movement."""
_LEAST = 1e-6
"""Part of the noise that any filter leaves: digits."""


def shaped(model: Model, sensor: Sensor) -> float:
    """Twice the log-likelihood of what the filters of a model have done to the noise of a sensor.

    The model's noise does not have that form: an effect on the noise gains as much by imitating it.
    """
    own = [t for t in model.terms if t.effect.sensor is sensor]
    return sum(max(told_by_noise(t.hypothesis, t.theta, model), 0.0) for t in own)


def told_by_noise(hypothesis: Hypothesis, theta: float, model: Model) -> float:
    """Twice the log-likelihood that is gained if the noise went through a filter as well; 0 where none is declared.

    Noise that was learned from this recording alone has the filter in it already, and differences of instances have
    the noise of both.
    """
    effect = hypothesis.effect
    if not isinstance(effect, MeanEffect) or effect.noise_gain is None:
        return 0.0
    sums: dict[tuple[str, int], list[tuple[float, float, float, float]]] = {}
    for v, view in enumerate(model.setting.views):
        if view.sensor is not effect.sensor or tuple(view.weights) != hypothesis.instances or not is_declared(view):
            continue
        bins, trace = model.setting.bins[v], view.whole.any_trace
        fast = bins.mean(view.omega) > _ABOVE * np.pi
        if not fast.any():
            continue
        gain = np.maximum(effect.noise_gain(trace, view.omega, theta), _LEAST)
        rounding = view.gain * trace.quantum**2 / 12.0
        for c in range(3):
            power = model.noise[3 * v + c].power
            plain = bins.mean(power)[fast]
            shaped = bins.mean(np.maximum(power - rounding, 0.0) * gain + np.minimum(rounding, power))[fast]
            squares, count = model.periodogram(3 * v + c)[fast], bins.counts[fast]
            sums.setdefault((view.label, c), []).append(
                (
                    float(count.sum()),
                    float(count @ np.log(plain / shaped)),
                    float((squares / plain).sum()),
                    float((squares / shaped).sum()),
                )
            )
    total = 0.0
    for pieces in sums.values():
        count, logs, before, after = np.sum(pieces, axis=0)
        total += float(logs + count * math.log(before / after))
    return total
