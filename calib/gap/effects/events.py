"""Single events: a bias that jumps (a knock, a magnet put on, a supply switched)."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.base import CatalogueEffect, EffectParameter, EffectShape, MeanEffect
from mavcal.calib.gap.effects.parts import TRIADS, axiswise, per_axis
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.problem import UNIT, Trace
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]
Screen = Callable[[Trace, Array], Array]

RAMP_S = 1.5
"""Duration, s, of a gradual step. Chosen, not measured: hands take about as long to put a magnet on."""
_CANDIDATES = 4
"""Moments that are tried. Chosen, not measured: it bounds the time; the likeliest ones are among the first."""
_SEEN = 0.7
"""Fraction of a ramp's samples that must be observed. Chosen, not measured: with fewer, the hole would determine the
fit."""
_EDGE = 0.01
"""Fraction of the recording at either end in which a step counts as a bias. Chosen, not measured: one level would rest
on a hundredth of the samples."""


def step_signal(trace: Trace, moment: float) -> Array:
    """Step (1, N) at `moment` (s), linear between the samples beside it, so that it can be refined."""
    return np.clip((trace.t - moment) * trace.fs + 1.0, 0.0, 1.0)[None]


def ramp_signal(trace: Trace, moment: float) -> Array:
    """Ramp (1, N) from zero to one over `RAMP_S` about `moment` (s)."""
    return np.clip((trace.t - moment) / RAMP_S + 0.5, 0.0, 1.0)[None]


def step_moments(trace: Trace) -> Array:
    """All possible moments of a step, s."""
    margin = max(2, int(_EDGE * len(trace.t)))
    return np.asarray(trace.t[margin:-margin] if len(trace.t) > 3 * margin else trace.t, dtype=np.float64)


def likeliest_steps(trace: Trace, residual: Array) -> Array:
    """The moments with the largest standardised change of the mean of `residual` (N, 3), ascending.

    The recording is split at the first one, then between those found, so a pulse gives both of its edges. Noise is
    estimated from successive differences, so a slow drift does not hide a jump.
    """
    n = len(trace.t)
    first = int(np.searchsorted(trace.t, step_moments(trace)[0]))
    count = np.concatenate([[0.0], np.cumsum(trace.observed.astype(np.float64))])
    y = np.where(trace.observed[:, None], residual, 0.0)
    total = np.hstack([np.zeros((3, 1)), np.cumsum(y.T, axis=1)])
    noise = np.maximum(np.diff(y, axis=0).var(axis=0), np.finfo(float).tiny)
    found: list[int] = []
    known: dict[tuple[int, int], tuple[float, int]] = {}
    for _ in range(_CANDIDATES):
        pieces = list(pairwise([0, *sorted(found), n]))
        for start, end in pieces:
            if (start, end) not in known:
                known[start, end] = _best_split(count, total, noise, start, end, max(first, 1))
        best = max(known[piece] for piece in pieces)
        if best[0] <= 0.0:
            break
        found.append(best[1])
    return np.asarray(trace.t[np.sort(found or [n // 2])], dtype=np.float64)


def likeliest_ramps(trace: Trace, residual: Array) -> Array:
    """The likeliest moments of sampled ramps; across a hole only the two levels are known, which a jump describes.

    Without any, the first possible moment, which explains nothing.
    """
    found = likeliest_steps(trace, residual)
    during = np.abs(trace.t[:, None] - found) < 0.5 * RAMP_S
    seen = (during & trace.observed[:, None]).sum(axis=0) > _SEEN * during.sum(axis=0)
    return found[seen] if seen.any() else step_moments(trace)[:1]


def _best_split(count: Array, total: Array, noise: Array, start: int, end: int, margin: int) -> tuple[float, int]:
    """Largest standardised change of the mean between rows `start` and `end`, and its row."""
    first, last = start + margin, end - margin
    n = float(count[end] - count[start])
    before = count[first:last] - count[start]
    pairs = before * (n - before)
    if first >= last or not pairs.any():
        return 0.0, start
    bridge = total[:, first:last] - total[:, start, None] - ((total[:, end] - total[:, start]) / n)[:, None] * before
    gain = (1.0 / noise) @ (bridge * bridge) * n / np.where(pairs > 0.0, pairs, np.inf)
    best = int(np.argmax(gain))
    return float(gain[best]), first + best


def _effect_of(
    sensor: Sensor, form: str, signal: Callable[[Trace, float], Array], screen: Screen, *, still: bool
) -> CatalogueEffect:
    return MeanEffect(
        f"{sensor}_step",
        sensor,
        per_axis("step", UNIT[sensor]),
        "the event itself",
        "the same movement before and after; a log without the event",
        shape=EffectShape(EffectParameter("time_s", "s"), step_moments, screen, discontinuous=still),
        columns=axiswise(signal),
        signals=signal,
        plain="an offset that comes or goes at a moment",
        rivals=(f"{sensor}_random_walk", f"{sensor}_temp_linear"),
        repeatable=True,
        form=form,
        traits=frozenset({Trait.JUMPING, Trait.LEVEL}),
    )


EFFECTS: tuple[CatalogueEffect, ...] = tuple(
    effect
    for sensor in TRIADS
    for effect in (
        _effect_of(sensor, "", step_signal, likeliest_steps, still=True),
        _effect_of(sensor, "~slow", ramp_signal, likeliest_ramps, still=False),
    )
)
