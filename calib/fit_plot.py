"""Before and after a fit as a figure of matplotlib: of the samples where they are given, of the parameters else.

The figure belongs to no window and no back end: save it, or show it in a notebook.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError, MissingExtraError
from mavcal.calib.recording import Channel, Sensor
from mavcal.calib.triad import TriadModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

BEFORE: Final = "#b3261e"
AFTER: Final = "#14713a"
SHADES: Final = ("#1f6fb2", "#c9731f", "#7a4fb5")
"""Axes of the sensor."""
MOST: Final = 4000
"""Samples that are drawn; a recording has many more than a picture has dots."""
WIDTH, HEIGHT = 5.2, 3.8
"""Size of one panel, inches."""
NAMES: Final = {Sensor.GYRO: "Gyro", Sensor.ACCEL: "Accelerometer", Sensor.MAG: "Compass"}
FACES: Final = ("+x", "+y", "+z", "-x", "-y", "-z")


class PlottedFit(Protocol):
    """Pictures of a :class:`calib.fit.FitResult`."""

    @property
    def method(self) -> str: ...  # noqa: D102 - as there
    @property
    def sensor(self) -> Sensor: ...  # noqa: D102
    @property
    def instance(self) -> int: ...  # noqa: D102
    @property
    def unit(self) -> str: ...  # noqa: D102
    @property
    def model(self) -> TriadModel: ...  # noqa: D102
    @property
    def quality(self) -> Mapping[str, Any]: ...  # noqa: D102

    def corrected_sd(self, truths: Array) -> Array: ...  # noqa: D102

    def drift_sd(self, temperatures: Array) -> Array: ...  # noqa: D102


def plotted(fit: PlottedFit, channel: Channel | None, temperature: ArrayLike | None) -> Figure:
    """The figure of :meth:`calib.fit.FitResult.plot`."""
    measured = None if channel is None else _samples(fit, channel, temperature)
    drift, compass = fit.model.polynomial is not None, fit.sensor == Sensor.MAG
    figure = _figure(columns := 2 if measured is not None and (drift or compass) else 1)
    name = f"{NAMES.get(fit.sensor, str(fit.sensor).capitalize())} {fit.instance + 1}"
    figure.suptitle(f"{name} by {fit.method}: before and after")
    first = figure.add_subplot(1, columns, 1)
    if measured is None:
        (_drift if drift else _by_direction)(first, fit)
    elif drift:
        _drift(first, fit)
        _residuals(figure.add_subplot(1, columns, 2), fit, *measured)
    else:
        _residuals(first, fit, *measured)
        if compass:
            _sphere(figure.add_subplot(1, columns, 2, projection="3d"), *measured[1:])
    return figure


def _figure(columns: int) -> Figure:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("a plot needs matplotlib: pip install 'mavcal[plot]'") from error
    return Figure(figsize=(WIDTH * columns, HEIGHT), layout="constrained")


def _samples(fit: PlottedFit, channel: Channel, temperature: ArrayLike | None) -> tuple[Array, Array, Array]:
    """Times from the first one (N,), raw and corrected values (N, 3), thinned to what can be seen."""
    if (channel.sensor, channel.instance) != (fit.sensor, fit.instance):
        theirs, ours = f"{channel.sensor} {channel.instance + 1}", f"{fit.sensor} {fit.instance + 1}"
        raise InvalidInputError(f"these are samples of {theirs}, the fit is of {ours}: give the channel of the fit")
    if channel.unit != fit.unit:
        raise InvalidInputError(f"these samples are in {channel.unit}, the fit in {fit.unit}: convert them")
    if not len(channel):
        raise InvalidInputError(f"there are no samples of {fit.sensor} {fit.instance + 1} to plot")
    every = slice(None, None, math.ceil(len(channel) / MOST))
    at = None if temperature is None else np.asarray(temperature, dtype=np.float64)
    if at is not None and at.shape != channel.t.shape:
        raise InvalidInputError(f"{len(channel)} samples need as many temperatures, not an array of {at.shape}")
    raw = channel.values[every]
    corrected = fit.model.apply(raw, None if at is None else at[every])
    return channel.t[every] - channel.t[0], raw, corrected


def _residuals(axes: Axes, fit: PlottedFit, t: Array, raw: Array, corrected: Array) -> None:
    """What a sample is off: its length, or the rate of a gyro at rest; over time."""
    axes.set_xlabel("time, s")
    if fit.sensor == Sensor.GYRO:
        unit, factor = _shown(fit.unit)
        for axis, (name, shade) in enumerate(zip("xyz", SHADES, strict=True)):
            before, after = factor * raw[:, axis], factor * corrected[:, axis]
            axes.plot(t, before, ".", markersize=2, color=shade, alpha=0.35, label=f"{name} before")
            axes.plot(t, after, linewidth=0.8, color=shade, label=f"{name} after")
        axes.set_ylabel(f"rate, {unit}")
        axes.legend(fontsize="small", ncols=3)
        return
    symbol, expected = ("|B|", _field(fit, corrected)) if fit.sensor == Sensor.MAG else ("|f|", STANDARD_GRAVITY)
    for values, colour, when in ((raw, BEFORE, "before"), (corrected, AFTER, "after")):
        lengths = np.linalg.norm(values, axis=1)
        spread = float(np.sqrt(np.mean((lengths - expected) ** 2)))
        axes.plot(t, lengths, ".", markersize=2, color=colour, label=f"{when}, off by {spread:.2g} rms")
    axes.axhline(expected, color="0.4", linewidth=0.8, linestyle="--", label=f"expected {expected:.4g}")
    axes.set_ylabel(f"{symbol}, {_shown(fit.unit)[0]}")
    axes.legend(fontsize="small")


def _field(fit: PlottedFit, corrected: Array | None) -> float:
    """Strength of the field to which the fit corrects; from the samples where the fit does not tell."""
    radius, ratio = fit.quality.get("radius"), fit.quality.get("field_ratio")
    if radius is not None:
        return float(radius) / float(ratio or 1.0)
    if corrected is None:
        raise InvalidInputError(f"{fit.method} does not tell the strength of the field: plot it with its samples")
    return float(np.median(np.linalg.norm(corrected, axis=1)))


def _sphere(axes: Any, raw: Array, corrected: Array) -> None:
    """Where the tips of the measured vectors lie: a sphere about the origin once they are corrected."""
    axes.scatter(*raw.T, s=2, color=BEFORE, label="before")
    axes.scatter(*corrected.T, s=2, color=AFTER, label="after")
    axes.scatter(0.0, 0.0, 0.0, s=30, color="0.2", marker="+")
    axes.set(xlabel="x", ylabel="y", zlabel="z", title="Samples before and after")
    axes.set_aspect("equal")
    axes.legend(fontsize="small")


def _drift(axes: Axes, fit: PlottedFit) -> None:
    """The fitted change of the offset with temperature, which is what is off before; the band is left afterwards."""
    curve = fit.model.polynomial
    assert curve is not None
    at = np.linspace(curve.t_min, curve.t_max, 121)
    unit, factor = _shown(fit.unit)
    values, sd = factor * curve(at), factor * fit.drift_sd(at)
    for axis, shade in enumerate(SHADES):
        axes.plot(at, values[:, axis], color=shade, label="xyz"[axis])
        axes.fill_between(at, values[:, axis] - sd[:, axis], values[:, axis] + sd[:, axis], color=shade, alpha=0.25)
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    axes.set(xlabel="temperature, °C", ylabel=f"drift, {unit}", title=f"Drift from {curve.t_ref:.0f} °C, with its sd")
    axes.legend(fontsize="small")


def _by_direction(axes: Axes, fit: PlottedFit) -> None:
    """What the parameters correct, without samples: in six directions of the true vector, or at rest."""
    gyro = fit.sensor == Sensor.GYRO
    strength = 0.0 if gyro else STANDARD_GRAVITY if fit.sensor == Sensor.ACCEL else _field(fit, None)
    truths = np.zeros((1, 3)) if gyro else strength * np.vstack([np.eye(3), -np.eye(3)])
    unit, factor = _shown(fit.unit)
    errors, sds = fit.model.invert(truths) - truths, fit.corrected_sd(truths)
    before = errors[0] if gyro else np.linalg.norm(truths + errors, axis=1) - strength
    left = sds[0] if gyro else np.linalg.norm(sds, axis=1)
    places = np.arange(len(before))
    axes.bar(places, factor * before, width=0.5, color=BEFORE, label="before")
    axes.errorbar(
        places + 0.35, np.zeros(len(places)), factor * left, fmt="o", color=AFTER, capsize=4, label="after, ± sd"
    )
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    axes.set_xticks(places, list("xyz") if gyro else list(FACES))
    axes.set(xlabel="axis" if gyro else "direction of the true vector", ylabel=f"error, {unit}")
    axes.legend(fontsize="small")


def _shown(unit: str) -> tuple[str, float]:
    """The unit in which a person reads it, and the factor from `unit`."""
    return ("deg/s", math.degrees(1.0)) if unit == "rad/s" else (unit.replace("m/s2", "m/s²"), 1.0)
