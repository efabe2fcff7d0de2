"""Events with a duration: while a magnet is put on, a sensor is on neither the old nor the new level.

A step has no duration. An event has one if it takes several consecutive steps to describe it, or if readings beside a
step deviate from the levels. These samples are removed, and one step then is the difference of the levels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from mavcal.calib.gap.effects.events import RAMP_S
from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.model.joint import Model, Term
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.problem import GapProblem
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]
ONE_EVENT_S = 2.0
"""Longest time, s, between successive jumps of one event. Chosen, not measured: a person takes a second or two to
change something."""
_ONE_MOMENT = 1.5
"""Samples within which jumps are simultaneous, with a separate size on each instance. Source: decision 12."""
_MARGIN_S = 0.3
"""Margin, s, before the first and after the last jump. Chosen, not measured: filters of a vehicle settle within as
long."""
_WINDOW_S = 0.25
"""Averaging time, s, of readings that are compared with a level. Chosen, not measured: shorter than an event, and noise
averages out."""
_LEVEL = 33
"""Windows whose median is a level: some eight seconds. Chosen, not measured: four times an event, so that the median is
not its own."""
_RAMP = 0.3
"""Least fraction of a ramp's samples that must exist. Chosen, not measured: with fewer, the hole would determine the
fit."""
_FAR = 6.0
"""Standard deviations beyond which a window deviates from its level. Chosen, not measured: flights have many windows,
and their noise is not normal."""


@dataclass(frozen=True)
class JumpSpan:
    """The readings of a sensor from `start` to `end`, s, are unusable; `nats` is the gain of its jumps."""

    sensor: Sensor
    start: float
    end: float
    nats: float = 0.0

    @property
    def text(self) -> str:
        """Description of an event after which the level is unchanged."""
        return f"a change that passes on {self.sensor.value} from {self.start:.1f} to {self.end:.1f} s"


def events_of(model: Model, sensor: Sensor) -> list[list[Term]]:
    """The jumps of a sensor in a model in order of time, grouped by event."""
    jumps = [t for t in model.terms if t.effect.jumps and t.effect.sensor is sensor]
    events: list[list[Term]] = []
    for term in sorted(jumps, key=lambda t: t.theta):
        if events and term.theta - events[-1][-1].theta < ONE_EVENT_S:
            events[-1].append(term)
        else:
            events.append([term])
    return events


def transitions(model: Model, gains: Mapping[Key, float] | None = None) -> tuple[JumpSpan, ...]:
    """Events of a model with a duration: several jumps, a ramp, or readings off the levels beside a jump.

    `gains` of its effects are in twice the log-likelihood.
    """
    found = []
    for sensor in dict.fromkeys(view.sensor for view in model.setting.views):
        for event in events_of(model, sensor):
            start, end = event[0].theta, event[-1].theta
            views = [v for v, view in enumerate(model.setting.views) if event[0].hypothesis.touches(view)]
            reached = [span_off_level(model.setting.views[v], model.residual[v], start, end) for v in views]
            early, late = min(r[0] for r in reached), max(r[1] for r in reached)
            slow = bool(event[0].effect.form) and any(_ramp_is_sampled(event[0], model.setting.views[v]) for v in views)
            apart = end - start > _ONE_MOMENT / max(model.setting.views[v].fs for v in views)
            if apart or slow or early < start or late > end:
                early, late = min(early, start - _margin_of(event[0])), max(late, end + _margin_of(event[-1]))
                nats = 0.5 * sum((gains or {}).get(jump.hypothesis.key, 0.0) for jump in event)
                found.append(JumpSpan(sensor, early, late, nats))
    return tuple(found)


def _ramp_is_sampled(term: Term, view: View) -> bool:
    """Whether a ramp has samples; in a hole of the recording only its two levels are known."""
    during = (view.t > term.theta - 0.5 * RAMP_S) & (view.t < term.theta + 0.5 * RAMP_S)
    return int(during.sum()) > _RAMP * RAMP_S * view.fs


def transient_events(
    left_out: Sequence[JumpSpan], model: Model, gains: Mapping[Key, float] | None = None
) -> tuple[JumpSpan, ...]:
    """Removed events after which the level is unchanged, so that no effect of the model describes them.

    Drift noise with a larger gain than the jumps explains them. Overlapping spans of a sensor count as one.
    """
    jumps = [(t.effect.sensor, t.theta) for t in model.terms if t.effect.jumps]
    drifts = {t.hypothesis.effect.sensor: t.hypothesis.key for t in model.noise_terms if t.hypothesis.effect.drifts}

    def lasts(one: JumpSpan) -> bool:
        return any(s is one.sensor and one.start - ONE_EVENT_S < at < one.end + ONE_EVENT_S for s, at in jumps)

    def drifted(one: JumpSpan) -> bool:
        return one.sensor in drifts and one.nats < 0.5 * (gains or {}).get(drifts[one.sensor], 0.0)

    return _without_overlap([one for one in left_out if one.nats > 0.0 and not lasts(one) and not drifted(one)])


def _without_overlap(spans: Sequence[JumpSpan]) -> tuple[JumpSpan, ...]:
    """Spans with overlapping ones merged, by sensor and time."""
    found: list[JumpSpan] = []
    for one in sorted(spans, key=lambda span: (span.sensor.value, span.start)):
        if found and found[-1].sensor is one.sensor and one.start <= found[-1].end:
            last = found[-1]
            found[-1] = replace(last, end=max(last.end, one.end), nats=last.nats + one.nats)
        else:
            found.append(one)
    return tuple(found)


def span_off_level(view: View, residual: Array, start: float, end: float) -> tuple[float, float]:
    """Start and end of the deviation of a series (n, 3) from the levels before and after an event.

    Window means are compared with their median over some seconds on that side. Their scatter about such medians
    elsewhere sets the limit, for any kind of noise. Holes end the span.
    """
    width = max(1, round(_WINDOW_S * view.fs))
    if view.first or len(residual) < 3 * _LEVEL * width:
        return start, end
    means = _window_means(residual, width)
    smooth = median_filter(means, size=(_LEVEL, 1), mode="nearest")
    scatter = 1.4826 * np.median(np.abs(means - smooth), axis=0) + np.finfo(float).tiny
    # Windows begin at the event: one across it would hide the readings that are furthest off.
    near = _ONE_MOMENT / view.fs
    before, after = np.flatnonzero(view.t < start - near)[::-1], np.flatnonzero(view.t > end + near)
    first = width * _count_off_level(_window_means(residual[before], width), scatter)
    last = width * _count_off_level(_window_means(residual[after], width), scatter)
    early = float(view.t[before[first - 1]]) - _MARGIN_S if first else start
    late = float(view.t[after[last - 1]]) + _MARGIN_S if last else end
    return early, late


def _window_means(residual: Array, width: int) -> Array:
    """Means (m, 3) of `residual` (n, 3) over windows of `width` samples; an incomplete last one is dropped."""
    count = len(residual) // width
    return np.asarray(residual[: count * width].reshape(count, width, 3).mean(axis=1))


def _count_off_level(means: Array, scatter: Array) -> int:
    """Count of `means` (m, 3), nearest to the event first, before two in a row that are on the level."""
    if len(means) < _LEVEL:
        return 0
    level = np.median(means[:_LEVEL], axis=0)
    on = np.asarray((np.abs(means[:_LEVEL] - level) < _FAR * scatter).all(axis=1))
    calm = np.flatnonzero(on[:-1] & on[1:])
    return int(calm[0]) if len(calm) else 0


def level_mismatch(model: Model, term: Term) -> Array:
    """Difference (3,) of the residual levels before and after a step; zero if its size is right.

    The larger of two estimates: over some seconds beside it, and over all the time to its neighbours.
    """
    seen = [v for v, view in enumerate(model.setting.views) if term.hypothesis.touches(view) and not view.first]
    weights = [_weight_in(term, model.setting.views[v]) for v in seen]
    v, weight = max(zip(seen, weights, strict=True), key=lambda pair: abs(pair[1]))
    near = _ONE_MOMENT / model.setting.views[v].fs
    others = (t.theta for event in events_of(model, term.effect.sensor) for t in event)
    moments = [other for other in others if abs(other - term.theta) > near]
    start = max((m for m in moments if m < term.theta), default=-np.inf)
    end = min((m for m in moments if m > term.theta), default=np.inf)
    t, residual = model.setting.views[v].t, model.residual[v]
    apart = np.zeros(3)
    for reach in (_LEVEL * _WINDOW_S, np.inf):
        before = (t > max(start, term.theta - reach)) & (t < term.theta)
        after = (t > term.theta) & (t < min(end, term.theta + reach))
        if before.any() and after.any():
            step = np.abs(residual[after].mean(axis=0) - residual[before].mean(axis=0))
            apart = np.maximum(apart, step / abs(weight))
    return apart


def jump_moment(model: Model, term: Term) -> tuple[float, float]:
    """The moment of a jump, s, between two samples, and its standard error."""
    spans = []
    for view in {id(view.whole): view.whole for view in model.setting.views if term.hypothesis.touches(view)}.values():
        k = int(np.clip(np.searchsorted(view.t, term.theta - 0.5 / view.fs), 1, len(view.t) - 1))
        spans.append((float(view.t[k] - view.t[k - 1]), float(view.t[k])))
    length, end = min(spans)
    return end - 0.5 * length, length / np.sqrt(12.0)


def _weight_in(term: Term, view: View) -> float:
    """Weight of a term in a series."""
    return sum(w for i, w in view.weights.items() if i in term.hypothesis.instances)


def _margin_of(term: Term) -> float:
    """Seconds to remove on either side of a jump."""
    return _MARGIN_S + (0.5 * RAMP_S if term.effect.form else 0.0)


def without_transitions(problem: GapProblem, found: Sequence[JumpSpan]) -> GapProblem:
    """`problem` without the samples of transitions."""
    traces = list(problem.traces)
    for one in found:
        for i, trace in enumerate(traces):
            if trace.sensor is one.sensor:
                during = (trace.t > one.start) & (trace.t < one.end)
                traces[i] = replace(trace, observed=trace.observed & ~during)
    return replace(problem, traces=tuple(traces))
