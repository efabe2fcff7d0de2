"""What a simulated flight reads beside its own ideal: part of the simulator, and no gap."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.reference.noise import learned
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_SURE = 5.0  # standard errors from which a mean counts


def deviations(single: Sequence[Trace]) -> dict[tuple[Sensor, int], Array]:
    """Mean (3,) of the simulator's residuals by sensor and instance; axes on which it could be chance are zero.

    The firmware's own calibration makes one: a simulated sensor without errors reads off by what it corrects.
    """
    found: dict[tuple[Sensor, int], Array] = {}
    for trace in single:
        noise = learned(trace)
        if noise is None:
            continue
        mean = trace.residual[trace.observed].mean(axis=0)
        error = np.sqrt(noise.psd[0] / trace.observed.sum())
        found[trace.sensor, trace.instances[0]] = np.where(np.abs(mean) > _SURE * error, mean, 0.0)
    return found


def simulated_ideal(trace: Trace, found: Mapping[tuple[Sensor, int], Array]) -> Trace:
    """`trace` against what the simulator's sensor would have read; its first instance stands for one that it lacks."""
    offset = found.get((trace.sensor, trace.instances[0]), found.get((trace.sensor, 0)))
    if offset is None or trace.against is not None or not offset.any():
        return trace
    measured = np.where(trace.observed[:, None], trace.measured, trace.measured + offset)
    return dataclasses.replace(trace, ideal=trace.ideal + offset, measured=measured)
