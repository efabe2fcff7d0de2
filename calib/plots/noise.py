"""The Allan deviation of a fit by the method ``allan``, beside the model of white noise, bias instability and walk."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mavcal.calib.drawing import Blank, Chart, Picture, limits_of
from mavcal.calib.plots.canvas import HEIGHT, SHADES, TOO_FEW, WIDTH, PlottedChannel, density, shown


def allan(native: Mapping[str, Any], unit: str) -> Chart:
    """Measured deviation with its standard deviation as bars, the model as a line; an axis each."""
    unit, factor = shown(unit)
    tau, adev = np.asarray(native["tau"], dtype=np.float64), factor * np.asarray(native["adev"], dtype=np.float64)
    models = [None if model is None else factor * np.asarray(model) for model in native["model_adev"]]
    chart = Chart(
        "Allan deviation", "averaging time, s", f"Allan deviation, {unit}", limits_of(tau, log=True),
        limits_of(adev, *(model for model in models if model is not None), log=True), WIDTH, HEIGHT,
        log_x=True, log_y=True, legend_rows=2,
    )  # fmt: skip
    for name, shade, measured, spread in zip("xyz", SHADES, adev, native["adev_relative_sd"], strict=True):
        half = 0.0 if spread is None else np.asarray(spread)
        chart.bars(tau, measured, measured * half, shade, f"{name} measured")
    for name, shade, model in zip("xyz", SHADES, models, strict=True):
        if model is not None:
            chart.line(tau, model, shade, f"{name} model")
    return chart


def spectrum(channel: PlottedChannel, native: Mapping[str, Any]) -> Picture:
    """Root power density of the samples, and the fitted white noise as dashes."""
    unit, factor = shown(channel.unit)
    if (found := density(channel.t, channel.values)) is None:
        return Blank(TOO_FEW, WIDTH, HEIGHT)
    hz, root = found[0], factor * found[1]
    # N counts half a spectrum's sides
    floors = [None if white is None else factor * white * np.sqrt(2.0) for white in native["N"]]
    title, y = "Spectrum; dashes: white noise of the fit", limits_of(root, [f for f in floors if f], log=True)
    x = limits_of(hz, log=True)
    chart = Chart(title, "frequency, Hz", f"{unit} / √Hz", x, y, WIDTH, HEIGHT, log_x=True, log_y=True)
    for name, shade, column in zip("xyz", SHADES, root.T, strict=True):
        chart.line(hz, column, shade, name, thin=True)
    for shade, floor in zip(SHADES, floors, strict=True):
        if floor is not None:
            chart.line(x, [floor, floor], shade, dashed=True)
    return chart
