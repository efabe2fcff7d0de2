"""A gap at a glance: each sensor's residual over time, its spectrum, and how far the effects close the gap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from mavcal.calib.drawing import Blank, Chart, Drawing, Picture, limits_of, sheet
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.plots.canvas import AFTER, BEFORE, ROW_HEIGHT, RULE, TOO_FEW, WIDTH, Array, density, shown, thinned

MOST_ROWS = 4
"""Most sensors in one picture: those with the largest effects."""
_LONGEST = 55
"""Most letters of effect names in a title."""


class PlottedSeries(Protocol):
    """The part of :class:`calib.gap.schema.SeriesFit` that a picture needs."""

    @property
    def sensor(self) -> str: ...  # noqa: D102 - as there
    @property
    def instances(self) -> tuple[int, ...]: ...  # noqa: D102
    @property
    def t(self) -> Array: ...  # noqa: D102
    @property
    def residual(self) -> Array: ...  # noqa: D102
    @property
    def modelled(self) -> Array: ...  # noqa: D102
    @property
    def sigma(self) -> Array: ...  # noqa: D102
    @property
    def unit(self) -> str: ...  # noqa: D102
    @property
    def parts(self) -> Mapping[str, Array]: ...  # noqa: D102
    @property
    def power(self) -> Array | None: ...  # noqa: D102


def plotted(series: Sequence[PlottedSeries], title: str) -> Drawing:
    """The picture of :meth:`calib.gap.schema.GapReport.plot`: one row a sensor, times left, spectra right."""
    if not series:
        raise InvalidInputError("the report has no residuals to plot: diagnose the recordings again")
    rows = sorted(series, key=_explained, reverse=True)[:MOST_ROWS]
    panels: list[Picture] = []
    for one in rows:
        panels += [_over_time(one), _spectrum(one)]
    return sheet(panels, title, columns=2)


def _explained(series: PlottedSeries) -> float:
    """Energy of the effects, relative to the variance of one sample."""
    return float((series.modelled**2 / np.maximum(series.sigma, 1e-30) ** 2).mean())


def _axis(series: PlottedSeries) -> int:
    """The axis with the largest effects, or with the largest residual if there are none."""
    moved = series.modelled if series.modelled.any() else series.residual
    return int(np.argmax((moved**2).mean(axis=0) / np.maximum(series.sigma, 1e-30) ** 2))


def _over_time(series: PlottedSeries) -> Chart:
    unit, factor = shown(series.unit)
    axis, every = _axis(series), thinned(len(series.t))
    t = series.t[every] - series.t[0]
    before, after = factor * series.residual[:, axis], factor * (series.residual - series.modelled)[:, axis]
    chart = Chart(
        f"{series.sensor} {'+'.join(map(str, series.instances))} {'xyz'[axis]}: {_effect_names(series)}",
        "time, s", f"real less ideal, {unit}", limits_of(t), limits_of(before[every], after[every]), WIDTH, ROW_HEIGHT,
    )  # fmt: skip
    for values, colour, when in ((before, BEFORE, "before"), (after, AFTER, "with the effects")):
        rms = float(np.sqrt(np.mean(values**2)))
        chart.dots(t, values[every], colour, f"{when}, {rms:.2g} {unit} rms", size=1.1)
    chart.line(chart.x, [0.0, 0.0], RULE, thin=True)
    return chart


def _effect_names(series: PlottedSeries) -> str:
    """Names of the effects, as many as fit into the title."""
    names = list(series.parts) or ["no effect"]
    for count in range(len(names), 1, -1):
        text = ", ".join(names[:count]) + (f" and {len(names) - count} more" if count < len(names) else "")
        if len(text) <= _LONGEST:
            return text
    return names[0] + (f" and {len(names) - 1} more" if len(names) > 1 else "")


def _spectrum(series: PlottedSeries) -> Picture:
    unit, factor = shown(series.unit)
    axis = _axis(series)
    found = density(series.t, np.stack([series.residual, series.residual - series.modelled])[:, :, axis].T)
    if found is None:
        return Blank(TOO_FEW, WIDTH, ROW_HEIGHT)
    hz, root = found
    lines = [(root[:, 0], BEFORE, "before"), (root[:, 1], AFTER, "with the effects")]
    if series.power is not None:
        half = 0.5 * (len(series.t) - 1) / (series.t[-1] - series.t[0])
        own = half * np.arange(len(series.power)) / len(series.power)
        lines.append((np.sqrt(np.interp(hz, own, series.power[:, axis]) / half), RULE, "noise of the model"))
    x, y = limits_of(hz, log=True), limits_of(*(factor * values for values, _, _ in lines), log=True)
    chart = Chart("", "frequency, Hz", f"{unit} / √Hz", x, y, WIDTH, ROW_HEIGHT, log_x=True, log_y=True)
    for values, colour, name in lines:
        chart.line(hz, factor * values, colour, name, thin=colour != RULE, dashed=colour == RULE)
    return chart
