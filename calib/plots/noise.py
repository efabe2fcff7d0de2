"""The Allan deviation of a fit by the method ``allan``, beside the model of white noise, bias instability and walk."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mavcal.calib.plots.canvas import SHADES, PlottedChannel, density, shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def allan(axes: Axes, native: Mapping[str, Any], unit: str) -> None:
    """Measured deviation with its standard deviation as bars, the model as a line; an axis each."""
    unit, factor = shown(unit)
    tau = np.asarray(native["tau"], dtype=np.float64)
    for axis, (name, shade) in enumerate(zip("xyz", SHADES, strict=True)):
        adev = factor * np.asarray(native["adev"][axis], dtype=np.float64)
        model, spread = native["model_adev"][axis], native["adev_relative_sd"][axis]
        bars = None if spread is None else adev * np.asarray(spread)
        axes.errorbar(tau, adev, bars, fmt=".", markersize=4, color=shade, elinewidth=0.8, label=f"{name} measured")
        if model is not None:
            axes.plot(tau, factor * np.asarray(model), linewidth=1.0, color=shade, label=f"{name} model")
    axes.set_xscale("log")
    axes.set_yscale("log", nonpositive="clip")
    axes.set(xlabel="averaging time, s", ylabel=f"Allan deviation, {unit}", title="Allan deviation")
    axes.legend(fontsize="x-small", ncols=3)


def spectrum(axes: Axes, channel: PlottedChannel, native: Mapping[str, Any]) -> None:
    """Root power density of the samples, and the fitted white noise as dashes."""
    unit, factor = shown(channel.unit)
    if (found := density(channel.t, channel.values)) is not None:
        hz, root = found
        for axis, (name, shade) in enumerate(zip("xyz", SHADES, strict=True)):
            axes.loglog(hz, factor * root[:, axis], linewidth=0.7, color=shade, label=name)
            if (white := native["N"][axis]) is not None:  # N counts half a spectrum's sides
                axes.axhline(factor * white * np.sqrt(2.0), linewidth=1.0, linestyle="--", color=shade)
    axes.set(xlabel="frequency, Hz", ylabel=f"{unit} / √Hz", title="Spectrum; dashes: white noise of the fit")
    axes.legend(fontsize="x-small")
