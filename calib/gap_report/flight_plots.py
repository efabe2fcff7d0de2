"""Pictures of the flight: force and torque of real, simulated and patched, and the error of the predicted flight."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from mavcal.calib.airframe.answer import AirframeTrace, Rollout
from mavcal.calib.drawing import Chart, limits_of, svg, text
from mavcal.calib.fit import AXES
from mavcal.calib.gap_report.airframe_words import closed_words, part_name, quantity_name, sized
from mavcal.calib.gap_report.colours import AFTER, BEFORE, FLOOR, MODEL

Array = NDArray[np.float64]

LEGEND = (("real", BEFORE), ("simulated", FLOOR), ("simulated with the effects", AFTER))
"""Names and colours of the traces, in the order in which they are drawn."""
_WINDOW = 15.0
"""Time, s, of a flight that is drawn. Chosen, not measured: a manoeuvre and the hover before it, at a width of 300
pixels."""
_POINTS = 300
"""Points of a line: more than the picture has pixels."""
_LEAST = 16  # samples for a picture
_WIDTH, _HEIGHT = 294, 190
_LEFT, _BARS, _TALL, _TOP = 120.0, 122.0, 21.0, 42.0
_NAME_LETTERS = 19


def trace_plots(trace: AirframeTrace) -> list[Markup]:
    """One chart for each axis, over the seconds that the effects change most; none without data."""
    if len(trace.t) < _LEAST:
        return []
    rows = busiest(trace)
    t = trace.t[rows]
    drawn = []
    for axis, name in enumerate(AXES):
        lines = [binned(t, values[rows, axis]) for values in (trace.real, trace.sim, trace.patched)]
        if not any(np.isfinite(values).any() for _, values in lines):
            continue
        chart = Chart(
            f"{trace.kind.capitalize()} {name}", "time, s", trace.unit, (float(t[0]), float(t[-1])),
            limits_of(*(values for _, values in lines)), _WIDTH, _HEIGHT,
        )  # fmt: skip
        for (x, values), (_, colour) in zip(lines, LEGEND, strict=True):
            chart.line(x, values, colour, thin=colour == BEFORE)
        drawn.append(chart.drawn())
    return drawn


def busiest(trace: AirframeTrace) -> slice:
    """Rows of the window in which the effects change the prediction most."""
    change = np.nan_to_num(trace.patched - trace.sim)
    change /= np.maximum(np.sqrt(np.mean(change**2, axis=0)), 1e-12)  # every axis counts alike
    last = np.searchsorted(trace.t, trace.t + _WINDOW)
    sums = np.concatenate([[0.0], np.cumsum((change**2).sum(axis=1))])
    whole = trace.t + _WINDOW <= trace.t[-1]
    whole[0] = True
    start = int(np.argmax(np.where(whole, sums[last] - sums[:-1], -1.0)))
    return slice(start, int(last[start]))


def binned(t: Array, values: Array) -> tuple[Array, Array]:
    """Times and means of at most some hundreds of even bins; nan where a bin has no sample."""
    if len(t) <= _POINTS:
        return t, values
    edges = np.linspace(t[0], t[-1], _POINTS + 1)
    where = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, _POINTS - 1)
    there = np.isfinite(values)
    count = np.bincount(where[there], minlength=_POINTS)
    total = np.bincount(where[there], weights=values[there], minlength=_POINTS)
    return 0.5 * (edges[1:] + edges[:-1]), np.where(count > 0, total / np.maximum(count, 1), np.nan)


def rollout_plots(rollouts: Sequence[Rollout]) -> list[Markup]:
    """A waterfall chart for each horizon with a finite, positive error."""
    return [rollout_plot(one) for one in rollouts if math.isfinite(one.before) and one.before > 0.0]


def rollout_plot(rollout: Rollout) -> Markup:
    """Bars, in the unit of the error: error before, reduction by each effect, error after, and floor."""
    steps = list(_steps(rollout))
    top = max(max(begin, end) for _, begin, end, _ in steps)
    legend = ", ".join(filter(None, (closed_words(rollout), part_name(rollout))))
    title = f"{quantity_name(rollout).capitalize()}, {rollout.unit}"
    out = [text(4, 14, title, kind="title"), text(4, 30, legend, kind="legend")]
    for k, (name, begin, end, colour) in enumerate(steps):
        left, right = (_LEFT + _BARS * v / top for v in sorted((begin, end)))
        y = _TOP + k * _TALL
        out.append(text(_LEFT - 6, y + 12, _short(name), anchor="end"))
        bar = Markup('<rect class="bar" x="{:.2f}" y="{:.1f}" width="{:.2f}" height="15" style="fill:{}"/>')
        out.append(bar.format(left, y, max(right - left, 1.5), colour))
        out.append(text(right + 5, y + 12, sized(rollout, end)))
    return svg(_WIDTH, _TOP + _TALL * len(steps) + 6, out, f"Error of the predicted {quantity_name(rollout)}")


def _steps(rollout: Rollout) -> Iterator[tuple[str, float, float, str]]:
    """Name, start, end and colour of each bar; a reduction extends from one level to the next, others from zero."""
    yield "simulator as it is", 0.0, rollout.before, BEFORE
    level = rollout.before
    for step in rollout.sequence:
        if math.isfinite(step.error):
            yield step.add.replace("_", " "), level, step.error, MODEL
            level = step.error
    if rollout.sequence:
        yield "with all effects", 0.0, rollout.after, AFTER
    yield "floor", 0.0, rollout.floor, FLOOR


def _short(name: str) -> str:
    return name if len(name) <= _NAME_LETTERS else f"{name[: _NAME_LETTERS - 1]}…"
