"""Level shifts of a compass, beside a nominal recording whose noise drifts.

A spectrum learned from a drifting recording allows the same power at low frequencies in every other one. The steps of a
magnet put on and taken off have their power there, so neither is significant alone. A drifting nominal recording has no
large step between two levels, though: steps are compared with its largest one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.model.joint import NoiseTerm, Term
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.search.contest import Contest
from mavcal.calib.gap.search.selection import ChosenModel, extended, refitted_without
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_STEP_S = 0.5
"""Seconds over which readings are averaged first. Chosen, not measured: noise averages out, and no level is as
short."""
_LEVEL_S, _PAUSE_S = 8.0, 2.0
"""Shortest level, s, on either side of a step, and time, s, left out between the levels. Chosen, not measured: a person
takes a second or two to change something."""
_LEAST_COVERAGE = 0.5
"""Least fraction of a level's averages that must exist. Chosen, not measured: with less than half, a hole would decide
the level."""
_LARGEST_RATIO = 1.5
"""Ratio to the largest step of a nominal recording, above which a step is an effect. Source: decision 34; the ratio is
chosen, not measured: the largest of a few steps varies by as much."""


@dataclass(frozen=True, eq=False)
class Steps:
    """Difference `size` (K,) of the levels before and after each moment `t` (K,); NaN where a level is unknown."""

    t: Array
    size: Array

    @property
    def largest(self) -> float:
        """The largest step; zero if no level is known."""
        return float(np.nanmax(self.size)) if np.isfinite(self.size).any() else 0.0

    def largest_near(self, moment: float) -> float:
        """The largest step whose pause contains the moment."""
        near = np.abs(self.t - moment) <= _PAUSE_S
        return Steps(self.t[near], self.size[near]).largest if near.any() else 0.0


def level_steps(trace: Trace) -> Steps:
    """Steps of the residual of a trace, every half second."""
    width = max(1, round(_STEP_S * trace.fs))
    count = len(trace.t) // width
    rows = count * width
    seen = trace.observed[:rows].reshape(count, width)
    summed = np.where(trace.observed[:rows, None], trace.residual[:rows], 0.0).reshape(count, width, 3).sum(axis=1)
    means = summed / np.maximum(seen.sum(axis=1), 1)[:, None]
    known: NDArray[np.bool_] = np.asarray(seen.any(axis=1))
    length, pause = round(_LEVEL_S / _STEP_S), round(0.5 * _PAUSE_S / _STEP_S)
    total = np.vstack([np.zeros(3), np.cumsum(np.where(known[:, None], means, 0.0), axis=0)])
    number = np.append(0, np.cumsum(known))
    k = np.arange(length + pause, count - length - pause)
    if not len(k):
        return Steps(np.zeros(0), np.zeros(0))

    def level(start: NDArray[np.intp], end: NDArray[np.intp]) -> Array:
        n = number[end] - number[start]
        mean = (total[end] - total[start]) / np.maximum(n, 1)[:, None]
        mean[n < _LEAST_COVERAGE * length] = np.nan
        return np.asarray(mean)

    apart = level(k + pause, k + pause + length) - level(k - pause - length, k - pause)
    return Steps(trace.t[k * width], np.linalg.norm(apart, axis=1))


def with_level_shifts(
    chosen: ChosenModel, contest: Contest, traces: Sequence[Trace], nominal: Sequence[Trace], level: float
) -> ChosenModel:
    """The model with steps instead of drift noise, on compasses with larger steps than `nominal` ones; else unchanged.

    All steps of a sensor together need the minimum gain of one. Only compasses are tested: levels of the other sensors
    change with the movement, and a calm nominal recording moves less.

    Parameters
    ----------
    chosen, contest
        A model, and what competes.
    traces, nominal
        Sensors beside their references: of the recording, and of nominal ones.
    level
        Probability of a false step, per test.
    """
    for sensor in dict.fromkeys(view.sensor for view in chosen.model.setting.views):
        if sensor is not Sensor.MAG or _jump_terms(chosen, sensor):
            continue
        nominal_step = max((level_steps(t).largest for t in nominal if _is_single(t, sensor)), default=0.0)
        own = [level_steps(t) for t in traces if _is_single(t, sensor)]
        if nominal_step > 0.0 and max((steps.largest for steps in own), default=0.0) > _LARGEST_RATIO * nominal_step:
            chosen = _with_added_steps(chosen, contest, sensor, own, _LARGEST_RATIO * nominal_step, level)
    return chosen


def _is_single(trace: Trace, sensor: Sensor) -> bool:
    return trace.sensor is sensor and trace.against is None


def _with_added_steps(
    chosen: ChosenModel, contest: Contest, sensor: Sensor, own: Sequence[Steps], least: float, level: float
) -> ChosenModel:
    """The model with steps of a sensor, at moments where `own` steps are at least as large as `least`."""
    jumps = [h for h in contest.hypotheses if h.effect.jumps and h.effect.sensor is sensor]
    drifts = [t.hypothesis.key for t in chosen.model.noise_terms if _is_drift_on(t, sensor)]
    bare = refitted_without(chosen, drifts) if drifts else chosen
    found = extended(bare, contest.restricted_to(jumps).without_thresholds(), level)
    small = [t.hypothesis.key for t in _jump_terms(found, sensor) if max(s.largest_near(t.theta) for s in own) < least]
    found = refitted_without(found, small) if small else found
    steps = [t.hypothesis for t in _jump_terms(found, sensor)]
    if not steps:
        return chosen
    without = refitted_without(found, [h.key for h in steps])
    gain = sum(without.noise.deviance.values()) - sum(found.noise.deviance.values())
    return found if gain > min(map(contest.thresholds.to_enter, steps)) else chosen


def _jump_terms(chosen: ChosenModel, sensor: Sensor) -> list[Term]:
    return [t for t in chosen.model.terms if t.effect.jumps and t.effect.sensor is sensor]


def _is_drift_on(term: NoiseTerm, sensor: Sensor) -> bool:
    return term.hypothesis.effect.drifts and term.hypothesis.effect.sensor is sensor
