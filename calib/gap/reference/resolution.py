"""The lattice of quantised numbers: the step of a converter or of rounding."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.problem import Trace
from mavcal.calib.recording import Channel, Sensor

Array = NDArray[np.float64]

_ON_LEVEL = 0.05
"""Largest distance of a level from the lattice, relative to the step. Chosen, not measured: calibrations and units
round by less."""
_FRACTION = 0.99
"""Fraction of the gaps between values that must be whole steps. Chosen, not measured: one in a hundred may be
damaged."""
_GAPS = 8
"""Number of different gaps that prove a lattice; fewer suffice if levels occur often. Chosen, not measured: so many are
whole steps by chance once in 1e8 (`_ON_LEVEL`)."""
_REPEATED = 3
"""Mean number of samples per level that proves a lattice of few gaps. Chosen, not measured: continuous values hardly
repeat."""
EQUAL = 1e-9
"""Relative difference of equal numbers. Source: rounding of double precision, 1e-16, with a margin for sums."""


@dataclass(frozen=True)
class Levels:
    """A lattice of step `step` on which values lie up to `error` of a step."""

    step: float
    error: float


def noise_of(values: Array) -> float:
    """Noise of one sample of `values` (N,) from nonzero successive differences; 0 without any."""
    steps = np.diff(values)
    steps = steps[steps != 0.0]
    return float(1.4826 * np.median(np.abs(steps)) / math.sqrt(2.0)) if len(steps) else 0.0


def levels_of(values: Array) -> Levels | None:
    """The lattice of `values` (N,), None if there is none or they never change."""
    distinct = np.unique(values)
    size = float(np.abs(distinct).max(initial=0.0))
    gaps = np.diff(distinct)
    gaps = gaps[gaps > EQUAL * size]
    if not len(gaps) or (len(gaps) < _GAPS and len(values) < _REPEATED * (len(gaps) + 1)):
        return None
    step = float(gaps.min())
    for _ in range(2):
        counts = np.round(gaps / step)
        step = float((gaps @ counts) / (counts @ counts))
    error = np.abs(gaps / step - np.round(gaps / step))
    if (error < _ON_LEVEL).mean() < _FRACTION or (np.round(gaps / step) < 1.0).any():
        return None
    return Levels(step, float(np.quantile(error, _FRACTION)))


def step_of(values: Array) -> float:
    """Coarsest step of the columns of `values` (N, k), 0 without a lattice."""
    return max((found.step for column in values.T if (found := levels_of(column)) is not None), default=0.0)


def steps_of(channels: Iterable[Channel]) -> dict[Sensor, float]:
    """By sensor, the coarsest step of the readings of any of `channels`."""
    found: dict[Sensor, float] = {}
    for channel in channels:
        good = channel.values[np.isfinite(channel.values).all(axis=1)]
        found[channel.sensor] = max(found.get(channel.sensor, 0.0), step_of(good))
    return found


def with_simulated_step(trace: Trace, step: float) -> Trace:
    """`trace` with the simulator's quantisation `step` declared, if the sensor has it too."""
    quantum = max(trace.quantum, min(step, step_of(trace.measured[trace.observed])) if step else 0.0)
    return trace if quantum == trace.quantum else replace(trace, quantum=quantum)
