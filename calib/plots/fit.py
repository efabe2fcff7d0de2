"""Pictures of data before and after a fit: of its samples if given, else of the parameters alone.

A fit by the method ``allan`` is drawn as its Allan deviation and the model of white noise, bias instability and walk.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import ArrayLike

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.drawing import Blank, Chart, Drawing, Picture, SpaceView, SphereMap, limits_of, sheet
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.plots.canvas import (
    AFTER,
    BEFORE,
    HEIGHT,
    PALE,
    RULE,
    SHADES,
    TOO_FEW,
    WIDTH,
    PlottedChannel,
    density,
    name_of,
    shown,
    thinned,
)
from mavcal.calib.triad import Array, TriadModel

FACES: Final = ("+x", "+y", "+z", "-x", "-y", "-z")
_MERIDIANS, _PARALLELS = 25, 13
"""Lines of the drawn ellipsoid."""
_POLES: Final = ((0, 0), (90, 0), (0, 82), (172, 0), (-90, 0), (0, -82))
"""Longitude and latitude of :data:`FACES`, degrees; the outermost are moved inside the frame."""


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


def plotted(fit: PlottedFit, channel: PlottedChannel | None, temperature: ArrayLike | None) -> Drawing:
    """The picture of :meth:`calib.fit.FitResult.plot`."""
    if channel is not None:
        _check(fit, channel)
    suffix = "" if "adev" in fit.native else ": before and after"
    return sheet(_panels(fit, channel, temperature), f"{name_of(fit.sensor, fit.instance)} by {fit.method}{suffix}")


def _panels(fit: PlottedFit, channel: PlottedChannel | None, temperature: ArrayLike | None) -> list[Picture]:
    if "adev" in fit.native:
        deviation = allan(fit.native, fit.unit)
        return [deviation] if channel is None else [deviation, spectrum(channel, fit.native)]
    if channel is None:
        return [_drift(fit) if fit.model.polynomial is not None else _by_direction(fit)]
    return _sample_panels(fit, *_samples(fit, channel, temperature))


def _sample_panels(fit: PlottedFit, t: Array, raw: Array, corrected: Array) -> list[Picture]:
    """Residuals, and the result of the method: a drift curve, the sphere, or the visited directions."""
    residuals = _rates(fit, t, raw, corrected) if fit.sensor == "gyro" else _lengths(fit, t, raw, corrected)
    if fit.model.polynomial is not None:
        return [_drift(fit), residuals]
    if fit.sensor == "mag":
        return [residuals, _sphere(fit, raw, corrected), _directions(fit, corrected)]
    return [residuals, _directions(fit, corrected)] if fit.sensor == "accel" else [residuals]


def _check(fit: PlottedFit, channel: PlottedChannel) -> None:
    if (channel.sensor, channel.instance) != (fit.sensor, fit.instance):
        theirs, ours = f"{channel.sensor} {channel.instance + 1}", f"{fit.sensor} {fit.instance + 1}"
        raise InvalidInputError(f"these are samples of {theirs}, the fit is of {ours}: give the channel of the fit")
    if channel.unit != fit.unit:
        raise InvalidInputError(f"these samples are in {channel.unit}, the fit in {fit.unit}: convert them")
    if not len(channel.t):
        raise InvalidInputError(f"there are no samples of {fit.sensor} {fit.instance + 1} to plot")


def _samples(fit: PlottedFit, channel: PlottedChannel, temperature: ArrayLike | None) -> tuple[Array, Array, Array]:
    """Times since the first one (N,), raw and corrected values (N, 3), thinned for drawing."""
    every = thinned(len(channel.t))
    at = None if temperature is None else np.asarray(temperature, dtype=np.float64)
    if at is not None and at.shape != channel.t.shape:
        raise InvalidInputError(f"{len(channel.t)} samples need as many temperatures, not an array of {at.shape}")
    raw = channel.values[every]
    corrected = fit.model.apply(raw, None if at is None else at[every])
    return channel.t[every] - channel.t[0], raw, corrected


def _rates(fit: PlottedFit, t: Array, raw: Array, corrected: Array) -> Chart:
    """Error of a gyroscope at rest over time."""
    unit, factor = shown(fit.unit)
    limits = limits_of(factor * raw, factor * corrected)
    chart = Chart("", "time, s", f"rate, {unit}", limits_of(t), limits, WIDTH, HEIGHT, legend_rows=2)
    for name, pale, before in zip("xyz", PALE, raw.T, strict=True):
        chart.dots(t, factor * before, pale, f"{name} before")
    for name, shade, after in zip("xyz", SHADES, corrected.T, strict=True):
        chart.line(t, factor * after, shade, f"{name} after", thin=True)
    return chart


def _lengths(fit: PlottedFit, t: Array, raw: Array, corrected: Array) -> Chart:
    """Length of every sample over time, with the expected length."""
    symbol, expected = ("|B|", _field(fit, corrected)) if fit.sensor == "mag" else ("|f|", STANDARD_GRAVITY)
    before, after = (np.linalg.norm(values, axis=1) for values in (raw, corrected))
    limits = limits_of(before, after, [expected])
    chart = Chart("", "time, s", f"{symbol}, {shown(fit.unit)[0]}", limits_of(t), limits, WIDTH, HEIGHT)
    for lengths, colour, when in ((before, BEFORE, "before"), (after, AFTER, "after")):
        spread = float(np.sqrt(np.mean((lengths - expected) ** 2)))
        chart.dots(t, lengths, colour, f"{when}, off by {spread:.2g} rms")
    chart.line(chart.x, [expected, expected], RULE, f"expected {expected:.4g}", dashed=True)
    return chart


def _field(fit: PlottedFit, corrected: Array | None) -> float:
    """Field strength to which the fit corrects; from the samples if the fit does not state it."""
    radius, ratio = fit.quality.get("radius"), fit.quality.get("field_ratio")
    if radius is not None:
        return float(radius) / float(ratio or 1.0)
    if corrected is None:
        raise InvalidInputError(f"{fit.method} does not tell the strength of the field: plot it with its samples")
    return float(np.median(np.linalg.norm(corrected, axis=1)))


def _sphere(fit: PlottedFit, raw: Array, corrected: Array) -> SpaceView:
    """Measured vectors on the fitted ellipsoid, and corrected ones on the sphere about the origin."""
    sphere = _field(fit, corrected) * _globe()
    ellipsoid = fit.model.invert(sphere.reshape(-1, 3)).reshape(sphere.shape)
    everything = np.vstack([raw, corrected, sphere.reshape(-1, 3), ellipsoid.reshape(-1, 3)])
    low, high = np.nanmin(everything, axis=0), np.nanmax(everything, axis=0)
    unit, half = shown(fit.unit)[0], 0.52 * float((high - low).max())
    labels = f"x, {unit}", f"y, {unit}", f"z, {unit}"
    view = SpaceView("Ellipsoid before, sphere after", labels, 0.5 * (low + high), half, WIDTH - 80, HEIGHT)
    for surface, colour in ((sphere, AFTER), (ellipsoid, BEFORE)):
        view.lines([*surface, *surface.swapaxes(0, 1)], colour)
    view.dots(raw, BEFORE, "before")
    view.dots(corrected, AFTER, "after")
    view.cross(np.zeros(3), "#1d2b36")
    return view


def _globe() -> Array:
    """Points (meridians, parallels, 3) of the unit sphere."""
    longitude, latitude = np.meshgrid(
        np.linspace(-np.pi, np.pi, _MERIDIANS), np.linspace(-0.5 * np.pi, 0.5 * np.pi, _PARALLELS), indexing="ij"
    )
    flat = np.cos(latitude)
    return np.stack([flat * np.cos(longitude), flat * np.sin(longitude), np.sin(latitude)], axis=-1)


def _directions(fit: PlottedFit, corrected: Array) -> SphereMap:
    """Directions of the corrected vectors in the sensor's axes; areas without dots were not measured."""
    covered = fit.quality.get("coverage")
    share = "" if covered is None else f", {100.0 * float(covered):.0f} % of the sphere"
    drawn = SphereMap(f"Directions measured{share}", "", WIDTH - 80, HEIGHT)
    drawn.dots(corrected, AFTER)
    for name, (longitude, latitude) in zip(FACES, _POLES, strict=True):
        drawn.mark(longitude, latitude, name)
    return drawn


def _drift(fit: PlottedFit) -> Chart:
    """Fitted drift of the offset, which is the error before correction; the band is the error afterwards."""
    curve = fit.model.polynomial
    assert curve is not None
    at = np.linspace(curve.t_min, curve.t_max, 121)
    unit, factor = shown(fit.unit)
    values, sd = factor * curve(at), factor * fit.drift_sd(at)
    title, y = f"Drift from {curve.t_ref:.0f} °C, with its sd", limits_of(values - sd, values + sd, [0.0])
    chart = Chart(title, "temperature, °C", f"drift, {unit}", limits_of(at), y, WIDTH, HEIGHT)
    for name, shade, middle, half in zip("xyz", SHADES, values.T, sd.T, strict=True):
        chart.band(at, middle - half, middle + half, shade)
        chart.line(at, middle, shade, name)
    chart.line(chart.x, [0.0, 0.0], RULE, thin=True)
    return chart


def _by_direction(fit: PlottedFit) -> Chart:
    """Correction by the parameters alone: for six directions of the true vector, or at rest."""
    gyro = fit.sensor == "gyro"
    strength = 0.0 if gyro else STANDARD_GRAVITY if fit.sensor == "accel" else _field(fit, None)
    truths = np.zeros((1, 3)) if gyro else strength * np.vstack([np.eye(3), -np.eye(3)])
    unit, factor = shown(fit.unit)
    errors, sds = fit.model.invert(truths) - truths, fit.corrected_sd(truths)
    before = factor * (errors[0] if gyro else np.linalg.norm(truths + errors, axis=1) - strength)
    left = factor * (sds[0] if gyro else np.linalg.norm(sds, axis=1))
    places = np.arange(len(before), dtype=np.float64)
    x, y = (-0.5, len(before) - 0.25), limits_of(before, -left, left)
    label = "axis" if gyro else "direction of the true vector"
    chart = Chart("", label, f"error, {unit}", x, y, WIDTH, HEIGHT, x_names="xyz" if gyro else FACES)
    chart.columns(places, before, BEFORE, "before")
    chart.line(x, [0.0, 0.0], RULE, thin=True)
    chart.bars(places + 0.35, np.zeros(len(places)), left, AFTER, "after, ± sd")
    return chart


def allan(native: Mapping[str, Any], unit: str) -> Chart:
    """Measured Allan deviation with error bars, and the model as a line, for each axis."""
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
