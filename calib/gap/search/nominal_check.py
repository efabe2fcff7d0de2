"""What a recording without an effect shows as well: no gap, although an effect describes it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.base import LatticeEffect, LatticeEvidence
from mavcal.calib.gap.model.joint import Term
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.search import prices

Array = NDArray[np.float64]


def nominal_has_samples(effect: LatticeEffect, evidence: LatticeEvidence, nominal: Iterable[Trace]) -> bool:
    """Whether a nominal recording shows the same in its samples: then its noise knows of it."""
    for trace in nominal:
        other = effect.detect(trace) if trace.sensor is effect.sensor else None
        if other is not None and len(other.values) == len(evidence.values):
            mine, its = np.array(evidence.values), np.array(other.values)
            if (np.abs(mine - its) <= prices.SAMPLE_DIFFERENCE * np.maximum(np.abs(mine), np.abs(its))).all():
                return True
    return False


def nominal_has_tone(term: Term, nominal: Iterable[Trace]) -> bool:
    """Whether a nominal recording has a line at the frequency of a tone: the mains, a converter's clock.

    A learned spectrum holds means over bands and does not show it.
    """
    if not term.effect.tonal:
        return False
    size = float(np.sqrt((term.beta**2).sum()))
    return any(
        trace.sensor is term.hypothesis.effect.sensor
        and term.theta < 0.5 * trace.fs
        and _amplitude(trace, term.theta) > prices.NOMINAL_TONE_SHARE * size
        and _line(trace, term.theta) > prices.LINE_TO_NEIGHBOURS
        for trace in nominal
    )


def _amplitude(trace: Trace, hz: float) -> float:
    """Amplitude of the wave of that frequency in the residual of `trace`, over all axes."""
    return float(np.sqrt((_projected(trace, hz) ** 2).sum()))


def _line(trace: Trace, hz: float) -> float:
    """Energy at `hz` over the median about it."""
    step = trace.fs / len(trace.t)
    near = [
        _amplitude(trace, hz + k * step)
        for k in range(-prices.LINE_NEIGHBOURS, prices.LINE_NEIGHBOURS + 1)
        if abs(k) > 2
    ]
    return float((_amplitude(trace, hz) / max(np.median(near), 1e-300)) ** 2)


def _projected(trace: Trace, hz: float) -> Array:
    rows = trace.observed
    left = trace.residual[rows] - trace.residual[rows].mean(axis=0)
    angle = 2.0 * np.pi * hz * trace.t[rows]
    return np.asarray(2.0 / len(left) * np.vstack([np.cos(angle) @ left, np.sin(angle) @ left]))
