"""Before and after a fit: its samples where they are given, else what the parameters say alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.plots import noise
from mavcal.calib.plots.canvas import AFTER, BEFORE, SHADES, PlottedChannel, figure_of, name_of, shown, thinned
from mavcal.calib.triad import TriadModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

FACES: Final = ("+x", "+y", "+z", "-x", "-y", "-z")
_MERIDIANS, _PARALLELS = 25, 13
"""Lines of the drawn ellipsoid."""


@dataclass(frozen=True)
class _Panel:
    """One pair of axes: how it is drawn, and on which projection."""

    draw: Callable[[Any], None]
    projection: str | None = None


_POLES: Final = ((0, 0), (90, 0), (0, 82), (172, 0), (-90, 0), (0, -82))
"""Longitude and latitude of :data:`FACES`, degrees; the outermost ones inside the frame."""


class PlottedFit(Protocol):
    """Pictures of a :class:`calib.fit.FitResult`."""

    @property
    def method(self) -> str: ...  # noqa: D102 - as there
    @property
    def sensor(self) -> str: ...  # noqa: D102
    @property
    def instance(self) -> int: ...  # noqa: D102
    @property
    def unit(self) -> str: ...  # noqa: D102
    @property
    def model(self) -> TriadModel: ...  # noqa: D102
    @property
    def quality(self) -> Mapping[str, Any]: ...  # noqa: D102
    @property
    def native(self) -> Mapping[str, Any]: ...  # noqa: D102

    def corrected_sd(self, truths: Array) -> Array: ...  # noqa: D102

    def drift_sd(self, temperatures: Array) -> Array: ...  # noqa: D102


def plotted(fit: PlottedFit, channel: PlottedChannel | None, temperature: ArrayLike | None) -> Figure:
    """The figure of :meth:`calib.fit.FitResult.plot`."""
    if channel is not None:
        _check(fit, channel)
    if "adev" in fit.native:
        panels = _noise_panels(fit, channel)
    elif channel is None:
        drift = fit.model.polynomial is not None
        panels = [_Panel(lambda axes: (_drift if drift else _by_direction)(axes, fit))]
    else:
        panels = _sample_panels(fit, *_samples(fit, channel, temperature))
    figure = figure_of(len(panels))
    said = "" if "adev" in fit.native else ": before and after"
    figure.suptitle(f"{name_of(fit.sensor, fit.instance)} by {fit.method}{said}")
    for place, panel in enumerate(panels, start=1):
        panel.draw(figure.add_subplot(1, len(panels), place, projection=panel.projection))
    return figure


def _noise_panels(fit: PlottedFit, channel: PlottedChannel | None) -> list[_Panel]:
    panels = [_Panel(lambda axes: noise.allan(axes, fit.native, fit.unit))]
    if channel is not None:
        panels.append(_Panel(lambda axes: noise.spectrum(axes, channel, fit.native)))
    return panels


def _sample_panels(fit: PlottedFit, t: Array, raw: Array, corrected: Array) -> list[_Panel]:
    """Residuals, beside what the method determines: a drift curve, the sphere, the directions that were visited."""
    panels = [_Panel(lambda axes: _residuals(axes, fit, t, raw, corrected))]
    if fit.model.polynomial is not None:
        panels.insert(0, _Panel(lambda axes: _drift(axes, fit)))
    elif fit.sensor == "mag":
        panels.append(_Panel(lambda axes: _sphere(axes, fit, raw, corrected), "3d"))
        panels.append(_Panel(lambda axes: _directions(axes, fit, corrected), "mollweide"))
    elif fit.sensor == "accel":
        panels.append(_Panel(lambda axes: _directions(axes, fit, corrected), "mollweide"))
    return panels


def _check(fit: PlottedFit, channel: PlottedChannel) -> None:
    if (channel.sensor, channel.instance) != (fit.sensor, fit.instance):
        theirs, ours = f"{channel.sensor} {channel.instance + 1}", f"{fit.sensor} {fit.instance + 1}"
        raise InvalidInputError(f"these are samples of {theirs}, the fit is of {ours}: give the channel of the fit")
    if channel.unit != fit.unit:
        raise InvalidInputError(f"these samples are in {channel.unit}, the fit in {fit.unit}: convert them")
    if not len(channel.t):
        raise InvalidInputError(f"there are no samples of {fit.sensor} {fit.instance + 1} to plot")


def _samples(fit: PlottedFit, channel: PlottedChannel, temperature: ArrayLike | None) -> tuple[Array, Array, Array]:
    """Times from the first one (N,), raw and corrected values (N, 3), thinned to what can be seen."""
    every = thinned(len(channel.t))
    at = None if temperature is None else np.asarray(temperature, dtype=np.float64)
    if at is not None and at.shape != channel.t.shape:
        raise InvalidInputError(f"{len(channel.t)} samples need as many temperatures, not an array of {at.shape}")
    raw = channel.values[every]
    corrected = fit.model.apply(raw, None if at is None else at[every])
    return channel.t[every] - channel.t[0], raw, corrected


def _residuals(axes: Axes, fit: PlottedFit, t: Array, raw: Array, corrected: Array) -> None:
    """What a sample is off: its length, or the rate of a gyro at rest; over time."""
    axes.set_xlabel("time, s")
    if fit.sensor == "gyro":
        unit, factor = shown(fit.unit)
        for axis, (name, shade) in enumerate(zip("xyz", SHADES, strict=True)):
            before, after = factor * raw[:, axis], factor * corrected[:, axis]
            axes.plot(t, before, ".", markersize=2, color=shade, alpha=0.35, label=f"{name} before")
            axes.plot(t, after, linewidth=0.8, color=shade, label=f"{name} after")
        axes.set_ylabel(f"rate, {unit}")
        axes.legend(fontsize="small", ncols=3)
        return
    symbol, expected = ("|B|", _field(fit, corrected)) if fit.sensor == "mag" else ("|f|", STANDARD_GRAVITY)
    for values, colour, when in ((raw, BEFORE, "before"), (corrected, AFTER, "after")):
        lengths = np.linalg.norm(values, axis=1)
        spread = float(np.sqrt(np.mean((lengths - expected) ** 2)))
        axes.plot(t, lengths, ".", markersize=2, color=colour, label=f"{when}, off by {spread:.2g} rms")
    axes.axhline(expected, color="0.4", linewidth=0.8, linestyle="--", label=f"expected {expected:.4g}")
    axes.set_ylabel(f"{symbol}, {shown(fit.unit)[0]}")
    axes.legend(fontsize="small")


def _field(fit: PlottedFit, corrected: Array | None) -> float:
    """Strength of the field to which the fit corrects; from the samples where the fit does not tell."""
    radius, ratio = fit.quality.get("radius"), fit.quality.get("field_ratio")
    if radius is not None:
        return float(radius) / float(ratio or 1.0)
    if corrected is None:
        raise InvalidInputError(f"{fit.method} does not tell the strength of the field: plot it with its samples")
    return float(np.median(np.linalg.norm(corrected, axis=1)))


def _sphere(axes: Any, fit: PlottedFit, raw: Array, corrected: Array) -> None:
    """Tips of the measured vectors on the fitted ellipsoid, and on the sphere about the origin once corrected."""
    axes.scatter(*raw.T, s=2, color=BEFORE, label="before")
    axes.scatter(*corrected.T, s=2, color=AFTER, label="after")
    axes.scatter(0.0, 0.0, 0.0, s=30, color="0.2", marker="+")
    sphere = _field(fit, corrected) * _globe()
    for surface, colour in ((sphere, AFTER), (fit.model.invert(sphere.reshape(-1, 3)).reshape(sphere.shape), BEFORE)):
        axes.plot_wireframe(*np.moveaxis(surface, -1, 0), color=colour, linewidth=0.3, alpha=0.35)
    unit = shown(fit.unit)[0]
    axes.set(xlabel=f"x, {unit}", ylabel=f"y, {unit}", zlabel=f"z, {unit}", title="Ellipsoid before, sphere after")
    axes.set_aspect("equal")
    axes.locator_params(nbins=5)
    axes.tick_params(labelsize="x-small")
    axes.legend(fontsize="small")


def _globe() -> Array:
    """Points (meridians, parallels, 3) of the unit sphere."""
    longitude, latitude = np.meshgrid(
        np.linspace(-np.pi, np.pi, _MERIDIANS), np.linspace(-0.5 * np.pi, 0.5 * np.pi, _PARALLELS), indexing="ij"
    )
    flat = np.cos(latitude)
    return np.stack([flat * np.cos(longitude), flat * np.sin(longitude), np.sin(latitude)], axis=-1)


def _directions(axes: Any, fit: PlottedFit, corrected: Array) -> None:
    """Directions of the corrected vectors in the sensor's axes: where there is no dot, nothing was measured."""
    x, y, z = (corrected / np.linalg.norm(corrected, axis=1)[:, None]).T
    axes.scatter(np.arctan2(y, x), np.arcsin(np.clip(z, -1.0, 1.0)), s=3, color=AFTER, alpha=0.5)
    for name, (longitude, latitude) in zip(FACES, _POLES, strict=True):
        axes.text(np.radians(longitude), np.radians(latitude), name, ha="center", va="center", weight="bold", zorder=5)
    covered = fit.quality.get("coverage")
    share = "" if covered is None else f", {100.0 * float(covered):.0f} % of the sphere"
    axes.set_title(f"Directions measured{share}")
    axes.grid(visible=True, linewidth=0.4)
    axes.set_xticklabels([])
    axes.set_yticklabels([])


def _drift(axes: Axes, fit: PlottedFit) -> None:
    """The fitted change of the offset with temperature, which is what is off before; the band is left afterwards."""
    curve = fit.model.polynomial
    assert curve is not None
    at = np.linspace(curve.t_min, curve.t_max, 121)
    unit, factor = shown(fit.unit)
    values, sd = factor * curve(at), factor * fit.drift_sd(at)
    for axis, shade in enumerate(SHADES):
        axes.plot(at, values[:, axis], color=shade, label="xyz"[axis])
        axes.fill_between(at, values[:, axis] - sd[:, axis], values[:, axis] + sd[:, axis], color=shade, alpha=0.25)
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    axes.set(xlabel="temperature, °C", ylabel=f"drift, {unit}", title=f"Drift from {curve.t_ref:.0f} °C, with its sd")
    axes.legend(fontsize="small")


def _by_direction(axes: Axes, fit: PlottedFit) -> None:
    """What the parameters correct, without samples: in six directions of the true vector, or at rest."""
    gyro = fit.sensor == "gyro"
    strength = 0.0 if gyro else STANDARD_GRAVITY if fit.sensor == "accel" else _field(fit, None)
    truths = np.zeros((1, 3)) if gyro else strength * np.vstack([np.eye(3), -np.eye(3)])
    unit, factor = shown(fit.unit)
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
