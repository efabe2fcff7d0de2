"""A recording at a glance: every sensor over time, and its spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.plots.canvas import SHADES, PlottedChannel, density, figure_of, name_of, shown, thinned

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_ROWS = 8
"""Channels in one figure."""
_HEIGHT = 2.1


def plotted(channels: Sequence[PlottedChannel], title: str) -> Figure:
    """The figure of :meth:`calib.recording.Recording.plot`: one row a channel, times left, spectra right."""
    channels = channels[:MOST_ROWS]
    if not channels:
        raise InvalidInputError("the recording has no samples of these sensors to plot")
    figure = figure_of(2, len(channels), height=_HEIGHT)
    figure.suptitle(title)
    start = min(float(channel.t[0]) for channel in channels)
    for row, channel in enumerate(channels):
        _over_time(figure.add_subplot(len(channels), 2, 2 * row + 1), channel, start, last=row == len(channels) - 1)
        _spectrum(figure.add_subplot(len(channels), 2, 2 * row + 2), channel, last=row == len(channels) - 1)
    return figure


def _over_time(axes: Axes, channel: PlottedChannel, start: float, *, last: bool) -> None:
    unit, factor = shown(channel.unit)
    every = thinned(len(channel.t))
    for axis, (name, shade) in enumerate(zip("xyz", SHADES, strict=True)):
        if axis < channel.values.shape[1]:
            values = factor * channel.values[every, axis]
            axes.plot(channel.t[every] - start, values, linewidth=0.7, color=shade, label=name)
    axes.set_ylabel(f"{name_of(channel.sensor, channel.instance)}\n{unit}")
    if channel.values.shape[1] > 1:
        axes.legend(fontsize="x-small", ncols=3, loc="upper right")
    if last:
        axes.set_xlabel("time, s")


def _spectrum(axes: Axes, channel: PlottedChannel, *, last: bool) -> None:
    unit, factor = shown(channel.unit)
    if channel.values.shape[1] == 1:  # a thermometer moves slowly: its spectrum says nothing
        axes.set_axis_off()
        return
    found = density(channel.t, channel.values)
    if found is None:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "too few samples for a spectrum", ha="center", transform=axes.transAxes)
        return
    hz, root = found
    for axis in range(min(3, root.shape[1])):
        if np.any(root[:, axis] > 0.0):
            axes.loglog(hz, factor * root[:, axis], linewidth=0.8, color=SHADES[axis])
    axes.set_ylabel(f"{unit} / √Hz")
    if last:
        axes.set_xlabel("frequency, Hz")
