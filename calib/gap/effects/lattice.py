"""Exact effects in the samples: quantisation, repeats, zeros, and the end of the range (GAP 3.0).

What the ideal reading shows too, or the recording declares, is not a gap.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.optimize import brentq

from mavcal.calib.gap.effects.base import CatalogueEffect, EffectParameter, LatticeEffect, LatticeEvidence
from mavcal.calib.gap.effects.parts import AXES, TRIADS
from mavcal.calib.gap.effects.traits import SensorTerm, Trait
from mavcal.calib.gap.problem import UNIT, Trace
from mavcal.calib.gap.reference.resolution import EQUAL, levels_of, noise_of
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_EVIDENCE = 30.0
"""Twice the log-likelihood above which a pattern of samples counts. Chosen, not measured: odds of exp(15), three
million to one."""
_FEWEST = 5
"""Least number of equal samples at a limit, in a zero band or in a hold. Chosen, not measured: fewer are common by
chance."""
_FINEST = 0.03
"""Least reported step, relative to the noise. Source: a rounding error has the variance q^2/12, here less than 1e-4 of
the noise."""
_STEPS = 5
"""Rows over which the movement of an ideal reading is averaged, so that jitter does not count. Chosen, not measured:
two on either side."""
_SURROUNDINGS = 51
"""Rows over which the noise is taken as constant. Chosen, not measured: a variance of so many is known to 20 %
(sqrt(2/51))."""
_CERTAIN = 10.0
"""Most standard errors that one stay at the limit contributes. Chosen, not measured: noise has heavy tails."""
_SAFETY = 1.5
"""Safety factor on the number of chance repeats, which depends on estimated noise. Chosen, not measured: more than the
error of that estimate."""
_INFORMATIVE_CHANCE = 0.2
"""Chance of a repeat above which a row is ignored: the outcome depends on the position in its bin. Chosen, not
measured: a chance of one in five is no evidence."""
_LEAST_CHANCE = 1e-5
"""Least chance of a repeat during a movement, which is not known exactly. Chosen, not measured: far below the chance
with noise of a step's size."""
_AT_REST_SHARE = 0.5  # of the rows in which the sensor moves on while the ideal reading does not: it is at rest
"""Chosen, not measured: more than half of them."""


def quantisation(trace: Trace) -> LatticeEvidence | None:
    """Evidence of levels coarser than declared and than the ideal reading's. Values: step on x, y, z (0: none)."""
    steps, two_delta = [0.0] * 3, 0.0
    for axis in range(3):
        values, ideal = trace.measured[trace.observed, axis], trace.ideal[trace.observed, axis]
        found = levels_of(values)
        if found is None or found.step <= max(1.5 * trace.quantum, _FINEST * noise_of(values - ideal)):
            continue
        simulated = levels_of(ideal)
        if simulated is not None and simulated.step >= 0.7 * found.step:
            continue
        steps[axis] = found.step
        # A continuous reading is this near to a level by chance: the share of the line that the levels cover.
        two_delta -= 2.0 * len(values) * math.log(2.0 * max(found.error, 1e-6))
    if two_delta < _EVIDENCE:
        return None
    where = ", ".join(f"{a} {s:.4g}" for a, s in zip(AXES, steps, strict=True) if s)
    text = f"values lie on levels: {where} {trace.unit}"
    return _evidence(trace, steps, [1e-6 * s for s in steps], two_delta, text)


def saturation(trace: Trace) -> LatticeEvidence | None:
    """Evidence of samples at a limit that the ideal reading exceeds. Value: the limit."""
    limits, two_delta, masked = [], 0.0, np.zeros(trace.measured.shape, dtype=np.bool_)
    for axis in range(3):
        for side in (1.0, -1.0):
            readings = side * trace.measured[:, axis], side * trace.ideal[:, axis]
            pile, gain = _samples_at_limit(*readings, trace.observed, trace.quantum)
            if gain >= _EVIDENCE:
                limits.append(float(np.abs(trace.measured[pile, axis]).max()))
                two_delta += gain
                masked[:, axis] |= pile
    if not limits:
        return None
    rows = np.asarray(masked.any(axis=1), dtype=np.bool_)
    text = f"{int(rows.sum())} samples stand at the end of the range, {max(limits):.4g} {trace.unit}"
    spread = float(np.ptp(limits)) / 2.0
    return _evidence(trace, [float(np.median(limits))], [spread], two_delta, text, rows)


def _samples_at_limit(measured: Array, ideal: Array, observed: Mask, quantum: float) -> tuple[Mask, float]:
    """Rows at the largest value, and the evidence for a limit: more rows than just below, with the ideal beyond."""
    top = float(measured[observed].max(initial=-np.inf))
    near = EQUAL * abs(top)
    pile = observed & (measured >= top - near)
    count = int(pile.sum())
    if count < _FEWEST or top == 0.0:
        return pile, 0.0
    others, repeats = np.unique(measured[observed & ~pile], return_counts=True)
    if not len(others):
        return pile, 0.0  # a sensor that never changes shows no end
    chance = max(float(repeats[-3:].max()), 0.5)
    if count <= 3.0 * chance:
        return pile, 0.0
    gain = 2.0 * (count * math.log(count / chance) - count + chance)
    # Without a shortfall it is no limit: the reference is clipped too, or the level is common.
    return pile, gain if _shortfall_evidence(measured - ideal, pile, observed, quantum) >= _EVIDENCE else 0.0


def _shortfall_evidence(residual: Array, pile: Mask, observed: Mask, quantum: float) -> float:
    """Squared standard errors by which readings at the limit fall short of those around; 0 if they do not.

    The error is that of each stay's mean, since an error of the reference is common to all rows of a stay.
    """
    rows, elsewhere = np.flatnonzero(pile), observed & ~pile
    stays = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    lengths = np.minimum([len(stay) for stay in stays], _SURROUNDINGS)
    filled = np.where(elsewhere, residual, np.median(residual[elsewhere]))
    errors = {n: _error_of_mean(filled, elsewhere, n) for n in set(lengths.tolist())}
    short = np.empty(len(stays))
    for k, stay in enumerate(stays):
        beside = slice(max(stay[0] - _SURROUNDINGS, 0), stay[-1] + _SURROUNDINGS)
        level = min(float(np.median(filled[beside])), 0.0)  # of a reading that is as ideal nothing is missing
        short[k] = min((level - float(residual[stay].mean()) - 0.5 * quantum) / errors[int(lengths[k])], _CERTAIN)
    return max(float(short @ np.sqrt(lengths)), 0.0) ** 2 / float(lengths.sum())


def _error_of_mean(residual: Array, rows: Mask, count: int) -> float:
    """Standard error of a mean of `count` residuals (N,) relative to those around, estimated at `rows` (N,)."""
    apart = np.abs(uniform_filter1d(residual, count) - uniform_filter1d(residual, count + 2 * _SURROUNDINGS))[rows]
    return 1.4826 * float(np.median(apart)) + EQUAL * float(np.abs(residual[rows]).max())


def dead_band(trace: Trace) -> LatticeEvidence | None:
    """Evidence of small readings that are exactly zero. Values: half width on x, y, z (0: none)."""
    widths, errors, two_delta = [0.0] * 3, [0.0] * 3, 0.0
    masked = np.zeros(len(trace.t), dtype=np.bool_)
    for axis in range(3):
        found = _zero_band(trace, axis)
        if found is not None:
            widths[axis], errors[axis], gain, zero = found
            two_delta += gain
            masked |= zero
    if two_delta < _EVIDENCE:
        return None
    where = ", ".join(f"{a} {w:.3g}" for a, w in zip(AXES, widths, strict=True) if w)
    return _evidence(trace, widths, errors, two_delta, f"zero where smaller than {where} {trace.unit}", masked)


def _zero_band(trace: Trace, axis: int) -> tuple[float, float, float, Mask] | None:
    values, ideal = trace.measured[:, axis], trace.ideal[:, axis]
    empty = (trace.measured == 0.0).all(axis=1) & (np.abs(trace.ideal).max(axis=1) > 10.0 * noise_of(values))
    seen = trace.observed & ~empty
    zero = seen & (values == 0.0)
    other = np.abs(values[seen & ~zero])
    count = int(zero.sum())
    if count < _FEWEST or len(other) < _FEWEST or (seen & (ideal == 0.0)).sum() > 0.5 * count:
        return None
    levels = levels_of(values[seen & ~zero])
    step = max(levels.step if levels is not None else 0.0, trace.quantum)
    if step > 0.0 and count <= 3.0 * max(float((other < 1.5 * step).sum()), 1.0):
        return None  # zero is a level like others, or truncation's, which is twice as wide
    shift, se = _shift_towards_zero(values, ideal, seen & ~zero & (np.abs(values) < np.median(other)))
    width, width_se = float(other.min()), step
    beside = float((other < 2.0 * width).sum())  # in two bands as wide as the empty one on either side
    if shift > max(5.0 * se, 3.0 * width, 1.5 * step):
        width, width_se = shift, se  # the band was cut out and its edges joined
    elif width <= 1.5 * step or beside < 1.0:
        return None
    else:
        width_se = max(width / (beside + 1.0), step)
    gain = 2.0 * count * math.log(1.0 / EQUAL if step == 0.0 else width / (0.5 * step))
    return width, width_se, gain, zero


def _shift_towards_zero(values: Array, ideal: Array, rows: Mask) -> tuple[float, float]:
    """Mean reduction of readings of either sign towards zero, without their common bias, and its standard error."""
    missing = ideal[rows] - values[rows]
    up = values[rows] > 0.0
    if min(up.sum(), (~up).sum()) < _FEWEST:
        return 0.0, math.inf
    above, below = missing[up], -missing[~up]
    se = 0.5 * math.sqrt(float(above.var()) / len(above) + float(below.var()) / len(below))
    return 0.5 * float(above.mean() + below.mean()), se


def hold(trace: Trace) -> LatticeEvidence | None:
    """Evidence of rows that repeat the previous one on all axes. Values: mean hold time (s), fraction of repeats."""
    both = trace.observed[1:] & trace.observed[:-1]
    same = trace.measured[1:] == trace.measured[:-1]
    unchanged = (trace.ideal[1:] == trace.ideal[:-1]).all(axis=1)
    moved = both & ~same.all(axis=1)
    if unchanged[moved].sum() > _AT_REST_SHARE * moved.sum():
        unchanged = np.zeros_like(unchanged)  # an ideal reading that stands still, not one that is held
    standing = unchanged | (trace.measured[1:] == 0.0).all(axis=1)
    by_chance = _repeats_by_chance(trace, same)
    telling = both & ~standing & (by_chance < _INFORMATIVE_CHANCE)
    repeat = telling & same.all(axis=1)
    count, n = int(repeat.sum()), int(telling.sum())
    chance = np.maximum(_SAFETY * by_chance[telling], max(_LEAST_CHANCE, 0.1 / max(n, 1)))
    if count < _FEWEST:
        return None
    two_delta = _repeat_evidence(repeat[telling], chance)
    if two_delta < _EVIDENCE:
        return None
    share = count / n
    held = 1.0 / (trace.fs * max(1.0 - share, 1.0 / n))
    se = math.sqrt(share * (1.0 - share) / n)
    text = f"{count} of {n} rows repeat the one before: each is held for {1000.0 * held:.3g} ms on average"
    masked = np.concatenate([[False], repeat])
    return _evidence(trace, [held, share], [held * se / max(1.0 - share, 1.0 / n), se], two_delta, text, masked)


def _repeat_evidence(repeat: Mask, chance: Array) -> float:
    """Twice the log-likelihood ratio of repeats with a chance h added to each row's `chance` (N,), against h = 0.

    With small chances both are Poisson: the best h solves ``sum over repeats of 1 / (h + chance) = N``. A repeat where
    the movement forbids one has more weight than one of a sensor at rest.
    """
    own, n = chance[repeat], len(chance)

    def excess(h: float) -> float:
        return float((1.0 / (h + own)).sum()) - n

    if excess(0.0) <= 0.0:
        return 0.0
    h = float(brentq(excess, 0.0, len(own) / n))
    return 2.0 * (float(np.log1p(h / own).sum()) - n * h)


def _repeats_by_chance(trace: Trace, same: Mask) -> Array:
    """Probability (N - 1,) that a row repeats the previous one on all axes because of coarse levels.

    Two samples differ by a Gaussian of sd ``sqrt(2) sigma``; its density at zero times the step q is ``q / (2 sqrt(pi)
    sigma)``. Noise below the step always repeats. The noise is estimated locally, since a sensor at rest repeats and a
    moving one does not. Only rows that do not repeat are used, or a hold would hide itself. Their mean absolute
    difference is ``2 sigma / sqrt(pi)``, minus the contribution of the levels. A change D of the ideal reading reduces
    the chance by ``exp(-D^2 / 4 sigma^2)``, with the levels counted as noise.
    """
    changed = (trace.observed[1:] & trace.observed[:-1] & ~same.all(axis=1)).astype(np.float64)
    weight = uniform_filter1d(changed, _SURROUNDINGS, mode="nearest")
    chance, movement = np.ones(len(changed)), np.zeros(len(changed))
    for axis in range(3):
        values = trace.measured[trace.observed, axis]
        levels = levels_of(values)
        step = max(levels.step if levels is not None else 0.0, trace.quantum)
        if np.ptp(values) == 0.0:
            continue
        if step == 0.0:
            return np.zeros(len(changed))
        size = uniform_filter1d(changed * np.abs(np.diff(trace.residual[:, axis])), _SURROUNDINGS, mode="nearest")
        noise = 0.5 * math.sqrt(math.pi) * size / np.maximum(weight, 0.5 / _SURROUNDINGS)
        variance = np.maximum(noise**2 - step**2 / 12.0, np.finfo(float).tiny)
        chance *= np.minimum(1.0, step / (2.0 * np.sqrt(math.pi * variance)))
        movement += _ideal_steps(trace.ideal[:, axis]) ** 2 / (4.0 * (variance + step**2))
    chance = np.where(weight * _SURROUNDINGS < 2.5, 1.0, chance)
    # If the noise is below the levels in a tenth of the recording, repeats are possible everywhere.
    return np.asarray(np.maximum(chance, float(np.quantile(chance, 0.9))) * np.exp(-movement))


def _ideal_steps(ideal: Array) -> Array:
    """Change of the ideal reading (N,) between rows, (N - 1,): the smaller of the step and its local mean.

    This excludes the jitter of an estimated reading.
    """
    steps = np.diff(ideal)
    return np.asarray(np.minimum(np.abs(steps), np.abs(uniform_filter1d(steps, _STEPS, mode="nearest"))))


def _evidence(
    trace: Trace, values: list[float], se: list[float], two_delta: float, text: str, masked: Mask | None = None
) -> LatticeEvidence:
    rows = np.zeros(len(trace.t), dtype=np.bool_) if masked is None else masked
    return LatticeEvidence(tuple(values), tuple(se), two_delta, rows, text)


def _effects_of(sensor: Sensor) -> tuple[CatalogueEffect, ...]:
    unit = UNIT[sensor]
    return (
        LatticeEffect(
            f"{sensor}_quantisation",
            sensor,
            tuple(EffectParameter(f"lsb.{axis}", unit) for axis in AXES),
            "any recording",
            "raw samples in the log",
            detect=quantisation,
            plain="coarser steps",
            rivals=(f"{sensor}_noise",),
            traits=frozenset({Trait.COARSE}),
            term=SensorTerm.RESOLUTION,
        ),
        LatticeEffect(
            f"{sensor}_saturation",
            sensor,
            (EffectParameter("limit", unit),),
            "readings up to the end of the range",
            "a larger range; less violent movement",
            detect=saturation,
            plain="a range that is too small",
            rivals=(f"{sensor}_hold",),
            term=SensorTerm.FULL_SCALE,
        ),
        LatticeEffect(
            f"{sensor}_dead_band",
            sensor,
            tuple(EffectParameter(f"half_width.{axis}", unit) for axis in AXES),
            "readings about zero",
            "raw samples in the log; slow movement through zero",
            detect=dead_band,
            plain="small values read as zero",
            traits=frozenset({Trait.DEAD_BAND}),
            rivals=(f"{sensor}_quantisation",),
        ),
        LatticeEffect(
            f"{sensor}_hold",
            sensor,
            (EffectParameter("hold_s", "s"), EffectParameter("repeated", "1")),
            "movement, or noise above the levels",
            "log every sample once, with its own time stamp",
            detect=hold,
            plain="repeated samples",
            rivals=(f"{sensor}_delay", f"{sensor}_saturation"),
        ),
    )


EFFECTS: tuple[CatalogueEffect, ...] = tuple(effect for sensor in TRIADS for effect in _effects_of(sensor))
