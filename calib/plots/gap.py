"""A gap at a glance: each sensor's residual over time, its spectrum, and how far the effects close the gap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.plots.canvas import AFTER, BEFORE, density, figure_of, shown, thinned

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

MOST_ROWS = 4
"""Sensors in one figure: those whose effects are largest."""
_HEIGHT = 2.4
_NOISE = "#6b7a86"


class PlottedSeries(Protocol):
    """What a figure needs of a :class:`calib.gap.schema.SeriesFit`."""

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


def plotted(series: Sequence[PlottedSeries], title: str) -> Figure:
    """The figure of :meth:`calib.gap.schema.GapReport.plot`: one row a sensor, times left, spectra right."""
    if not series:
        raise InvalidInputError("the report has no residuals to plot: diagnose the recordings again")
    rows = sorted(series, key=_explained, reverse=True)[:MOST_ROWS]
    figure = figure_of(2, len(rows), height=_HEIGHT)
    figure.suptitle(title)
    for row, one in enumerate(rows):
        last = row == len(rows) - 1
        _over_time(figure.add_subplot(len(rows), 2, 2 * row + 1), one, last=last)
        _spectrum(figure.add_subplot(len(rows), 2, 2 * row + 2), one, last=last)
    return figure


def _explained(series: PlottedSeries) -> float:
    """Energy that the effects explain, in variances of one sample."""
    return float((series.modelled**2 / np.maximum(series.sigma, 1e-30) ** 2).mean())


def _axis(series: PlottedSeries) -> int:
    """The axis on which the effects are largest, or the residual where there is no effect."""
    moved = series.modelled if series.modelled.any() else series.residual
    return int(np.argmax((moved**2).mean(axis=0) / np.maximum(series.sigma, 1e-30) ** 2))


def _over_time(axes: Axes, series: PlottedSeries, *, last: bool) -> None:
    unit, factor = shown(series.unit)
    axis, every = _axis(series), thinned(len(series.t))
    t = series.t[every] - series.t[0]
    before, after = series.residual[:, axis], (series.residual - series.modelled)[:, axis]
    for values, colour, when in ((before, BEFORE, "before"), (after, AFTER, "with the effects")):
        rms = factor * float(np.sqrt(np.mean(values**2)))
        label = f"{when}, {rms:.2g} {unit} rms"
        axes.plot(t, factor * values[every], ".", markersize=1.5, color=colour, label=label)
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    numbers = "+".join(map(str, series.instances))
    axes.set_ylabel(f"{series.sensor} {numbers} {'xyz'[axis]}\nreal less ideal, {unit}")
    axes.set_title(", ".join(series.parts) or "no effect", fontsize="small")
    axes.legend(fontsize="x-small", loc="upper right")
    if last:
        axes.set_xlabel("time, s")


def _spectrum(axes: Axes, series: PlottedSeries, *, last: bool) -> None:
    unit, factor = shown(series.unit)
    axis = _axis(series)
    found = density(series.t, np.stack([series.residual, series.residual - series.modelled])[:, :, axis].T)
    if found is None:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "too few samples for a spectrum", ha="center", transform=axes.transAxes)
        return
    hz, root = found
    axes.loglog(hz, factor * root[:, 0], linewidth=0.8, color=BEFORE, label="before")
    axes.loglog(hz, factor * root[:, 1], linewidth=0.8, color=AFTER, label="with the effects")
    if series.power is not None:
        half = 0.5 * (len(series.t) - 1) / (series.t[-1] - series.t[0])
        own = half * np.arange(len(series.power)) / len(series.power)
        noise = np.sqrt(np.interp(hz, own, series.power[:, axis]) / half)
        axes.loglog(hz, factor * noise, linewidth=1.0, linestyle="--", color=_NOISE, label="noise of the model")
    axes.set_ylabel(f"{unit} / √Hz")
    axes.legend(fontsize="x-small")
    if last:
        axes.set_xlabel("frequency, Hz")
