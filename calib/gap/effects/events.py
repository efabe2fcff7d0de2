"""Things that happen once: a bias that jumps (a knock, a magnet put on, a supply switched)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.gap.effects.base import Effect, MeanEffect, Parameter, Shape
from calib.gap.effects.parts import TRIADS, UNIT, axiswise, per_axis
from calib.gap.problem import Trace
from calib.recording import Sensor

Array = NDArray[np.float64]

_CANDIDATES = 4
_APART = 0.02  # of the recording, between candidates
_EDGE = 0.01  # of the recording: a step this near to an end is a bias


def after(trace: Trace, moment: float) -> Array:
    """One signal: zero before `moment` (s), one from then on; in between at the sample before it: it can be refined."""
    return np.clip((trace.t - moment) * trace.fs + 1.0, 0.0, 1.0)[None]


def moments(trace: Trace) -> Array:
    """Every moment at which a step could lie, s."""
    margin = max(2, int(_EDGE * len(trace.t)))
    return np.asarray(trace.t[margin:-margin] if len(trace.t) > 3 * margin else trace.t, dtype=np.float64)


def likeliest(trace: Trace, residual: Array) -> Array:
    """The moments with the largest standardised change of the mean of `residual` (N, 3), well apart, ascending.

    The noise is taken from successive differences, so a slow drift does not hide a jump.
    """
    grid = moments(trace)
    y = np.where(trace.observed[:, None], residual, 0.0)
    count = np.cumsum(trace.observed.astype(np.float64))
    total, n = np.cumsum(y, axis=0), count[-1]
    bridge = total - count[:, None] / max(n, 1.0) * total[-1]
    weight = np.maximum(count * (n - count) / max(n, 1.0), 1.0)
    noise = np.maximum(np.diff(y, axis=0).var(axis=0), np.finfo(float).tiny)
    gain = (bridge**2 / noise).sum(axis=1) / weight
    first = int(np.searchsorted(trace.t, grid[0]))
    gain = gain[first - 1 : first - 1 + len(grid)] if first else gain[: len(grid)]
    reach = max(1, int(_APART * len(grid)))
    found = []
    for _ in range(min(_CANDIDATES, len(grid))):
        best = int(np.argmax(gain))
        if not np.isfinite(gain[best]):
            break
        found.append(float(grid[best]))
        gain[max(best - reach, 0) : best + reach + 1] = -np.inf
    return np.sort(np.array(found))


def _of(sensor: Sensor) -> Effect:
    return MeanEffect(
        f"{sensor}_step",
        sensor,
        per_axis("step", UNIT[sensor]),
        "the event itself",
        "the same movement before and after; a log without the event",
        shape=Shape(Parameter("time_s", "s"), moments, likeliest),
        columns=axiswise(after),
        signals=after,
        rivals=(f"{sensor}_random_walk", f"{sensor}_temp_linear"),
    )


EFFECTS: tuple[Effect, ...] = tuple(_of(sensor) for sensor in TRIADS)
