"""A recording at a glance: every sensor over time, and its spectrum."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mavcal.calib.drawing import Blank, Chart, Drawing, Picture, limits_of, sheet
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.plots.canvas import (
    ROW_HEIGHT,
    SHADES,
    TOO_FEW,
    WIDTH,
    PlottedChannel,
    density,
    name_of,
    shown,
    thinned,
)

MOST_ROWS = 8
"""Channels in one picture."""


def plotted(channels: Sequence[PlottedChannel], title: str) -> Drawing:
    """The picture of :meth:`calib.recording.Recording.plot`: one row a channel, times left, spectra right."""
    channels = channels[:MOST_ROWS]
    if not channels:
        raise InvalidInputError("the recording has no samples of these sensors to plot")
    start = min(float(channel.t[0]) for channel in channels)
    end = max(float(channel.t[-1]) for channel in channels)
    panels: list[Picture] = []
    for channel in channels:
        panels += [_over_time(channel, start, end), _spectrum(channel)]
    return sheet(panels, title, columns=2)


def _over_time(channel: PlottedChannel, start: float, end: float) -> Chart:
    unit, factor = shown(channel.unit)
    every = thinned(len(channel.t))
    values, name = factor * channel.values[every, :3], name_of(channel.sensor, channel.instance)
    limits = limits_of([0.0, end - start]) if end > start else (-0.5, 0.5)
    chart = Chart(name, "time, s", unit, limits, limits_of(values), WIDTH, ROW_HEIGHT)
    for axis, column in enumerate(values.T):
        named = "xyz"[axis] if channel.values.shape[1] > 1 else ""
        chart.line(channel.t[every] - start, column, SHADES[axis], named, thin=True)
    return chart


def _spectrum(channel: PlottedChannel) -> Picture:
    unit, factor = shown(channel.unit)
    if channel.values.shape[1] == 1:  # a thermometer moves slowly: its spectrum says nothing
        return Blank("", WIDTH, ROW_HEIGHT)
    found = density(channel.t, channel.values)
    if found is None:
        return Blank(TOO_FEW, WIDTH, ROW_HEIGHT)
    hz, root = found[0], factor * found[1][:, :3]
    chart = Chart(
        "", "frequency, Hz", f"{unit} / √Hz", limits_of(hz, log=True), limits_of(root, log=True), WIDTH, ROW_HEIGHT,
        log_x=True, log_y=True,
    )  # fmt: skip
    for axis, column in enumerate(root.T):
        if np.any(column > 0.0):
            chart.line(hz, column, SHADES[axis], thin=True)
    return chart
