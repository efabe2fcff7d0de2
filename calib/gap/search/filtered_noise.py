"""Evidence for a filter in the noise: a sensor's filter shapes its noise as it shapes the movement (GAP 3.1).

In the narrow band of vehicle movement a filter looks like a delay; the noise above it distinguishes them. Quantisation
comes after the filter and is not shaped. Only the shape of the spectrum counts, not its level: a quieter sensor is not
a filter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.base import MeanEffect
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import Model
from mavcal.calib.gap.model.noise_fit import is_declared
from mavcal.calib.gap.search import prices
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_LEAST = 1e-6
"""Noise that passes any filter, relative to the unfiltered noise: rounding. Chosen, not measured: 60 dB below it."""
_TINY = 1e-300
"""Replaces zero power. Source: it guards a logarithm; the least normal double is 2e-308."""


def evidence_of_filters(model: Model, sensor: Sensor) -> float:
    """Twice the log-likelihood that the filters of a model gain in the noise of a sensor.

    The model's noise is not filtered, so an effect on the noise could gain as much by imitating it.
    """
    own = [t for t in model.terms if t.effect.sensor is sensor]
    return sum(max(filter_evidence(t.hypothesis, t.theta, model), 0.0) for t in own)


def filter_evidence(hypothesis: Hypothesis, theta: float, model: Model) -> float:
    """Twice the log-likelihood gained if the noise went through the filter too; 0 without declared noise.

    The likeliest of the noise forms counts. Noise that was learned from this recording already contains the filter, and
    differences of instances contain the noise of both.
    """
    effect = hypothesis.effect
    if not isinstance(effect, MeanEffect) or effect.noise_gain is None:
        return 0.0
    pieces: dict[tuple[str, int], list[Array]] = {}
    for v, view in enumerate(model.setting.views):
        if view.sensor is not effect.sensor or tuple(view.weights) != hypothesis.instances or not is_declared(view):
            continue
        gains = np.maximum(effect.noise_gain(view.whole.any_trace, view.omega, theta), _LEAST)
        for c in range(3):
            pieces.setdefault((view.label, c), []).append(_filter_statistics(model, v, c, gains))
    ratios = [_log_ratio(np.sum(parts, axis=0)) for parts in pieces.values()]
    return float(np.sum(ratios, axis=0).max()) if ratios else 0.0


def _filter_statistics(model: Model, v: int, c: int, gains: Array) -> Array:
    """Statistics (R, 4) of axis `c` of series `v` for filters (R, K): count, log ratios, misfit without and with."""
    view, bins = model.setting.views[v], model.setting.bins[v]
    fast = bins.mean(view.omega) > prices.FILTER_BAND_SHARE * np.pi
    power = model.noise[3 * v + c].power
    rounding = view.gain * view.whole.any_trace.quantum**2 / 12.0
    filtered = np.maximum(power - rounding, 0.0) * gains + np.minimum(rounding, power)
    plain, shaped = bins.mean(power)[fast], bins.mean(filtered)[:, fast]
    squares, count = model.periodogram(3 * v + c)[fast], bins.counts[fast]
    rows = np.ones(len(gains))
    logs, after = np.log(plain / shaped) @ count, (squares / shaped).sum(axis=1)
    return np.stack([count.sum() * rows, logs, (squares / plain).sum() * rows, after], axis=1)


def _log_ratio(compared: Array) -> Array:
    """Twice the log-likelihood ratio (R,), with a free noise level on either side."""
    count, logs, before, after = compared.T
    return np.where(count > 0.0, logs + count * np.log(np.maximum(before, _TINY) / np.maximum(after, _TINY)), 0.0)
