"""Pictures of a report's time series: residuals before and after, spectra, Allan deviation, time strip, overlay."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from mavcal.calib.drawing import Chart, limits_of, thinned
from mavcal.calib.fit import AXES
from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.schema import EffectEstimate, SeriesFit
from mavcal.calib.gap_report.colours import AFTER, BEFORE, FLOOR, MODEL

Array = NDArray[np.float64]

_BINS = 24
_STRIP = 120
_WINDOW = 4.0  # s of the overlay
_SPECTRUM = 240  # points
_LEAST = 64  # samples for a picture


def name_of(series: SeriesFit) -> str:
    """``mag 1``, or ``mag 1+2`` for a combination."""
    return f"{series.sensor.value} {'+'.join(map(str, series.instances))}"


def axis_of(series: SeriesFit, effect_id: str | None = None) -> int:
    """The axis on which an effect, or all of them, or else the residual, is largest."""
    moved = series.parts.get(effect_id, series.modelled) if effect_id else series.modelled
    size = (moved**2).mean(axis=0)
    if not size.any():
        size = (series.residual**2).mean(axis=0)
    return int(np.argmax(size / np.maximum(series.sigma, 1e-30) ** 2))


def shape_plot(series: SeriesFit, effect_id: str) -> Markup:
    """Residual before and after one effect or unexplained shape, over the covariate that it follows."""
    part = series.parts.get(effect_id)
    if part is None or len(series.t) < _LEAST or not part.any():
        return Markup()
    axis = axis_of(series, effect_id)
    label, x = _follows(series, part[:, axis])
    before = series.residual[:, axis] - (series.modelled - part)[:, axis]
    after = before - part[:, axis]
    middle, mean, half = _binned(x, before)
    _, left, half_left = _binned(x, after)
    _, curve, _ = _binned(x, part[:, axis])
    chart = Chart(
        f"{effect_id}: {name_of(series)}, {AXES[axis]} axis",
        label,
        f"real less ideal, {series.unit}",
        limits_of(middle),
        limits_of(mean - half, mean + half, left - half_left, left + half_left),
    )
    chart.bars(middle, mean, half, BEFORE, "before")
    chart.line(middle, curve, MODEL, "the effect")
    chart.bars(middle, left, half_left, AFTER, "after")
    return chart.drawn()


def _follows(series: SeriesFit, part: Array) -> tuple[str, Array]:
    """Name and values of the variable that explains `part` best: a covariate, an axis of the ideal reading, or time."""
    units = {"temperature": "degC", "current": "A", "throttle": "0 to 1"}
    offered: list[tuple[str, Array]] = [
        (f"{name}, {units.get(name, '')}".rstrip(", "), values) for name, values in series.covariates.items()
    ]
    if series.ideal is not None:
        offered += [(f"ideal {AXES[a]}, {series.unit}", series.ideal[:, a]) for a in range(3)]
    time = ("time, s", series.t)
    if np.ptp(part) <= 1e-9 * np.abs(part).max():
        return time
    best, share = time, 0.0
    for label, values in offered:
        found = _explained(values, part)
        if found > share + 0.02:
            best, share = (label, values), found
    return best if share > 0.5 else time


def _explained(x: Array, y: Array) -> float:
    """Share of the variance of `y` that its means over bins of `x` keep."""
    if np.ptp(x) <= 0.0 or y.var() <= 0.0:
        return 0.0
    _, where = np.unique(_bin(x), return_inverse=True)
    means = np.bincount(where, weights=y) / np.bincount(where)
    return float(1.0 - np.mean((y - means[where]) ** 2) / y.var())


def _bin(x: Array) -> NDArray[np.intp]:
    edges = np.linspace(x.min(), x.max(), _BINS + 1)[1:-1]
    return np.searchsorted(edges, x)


def _binned(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Middle, mean and 95 % half interval of each bin of `x` that has samples."""
    where = _bin(x) if np.ptp(x) > 0.0 else np.zeros(len(x), dtype=np.intp)
    count = np.bincount(where, minlength=_BINS)
    kept = count >= 3
    total = np.maximum(count, 1)
    mean = np.bincount(where, weights=y, minlength=_BINS) / total
    spread = np.bincount(where, weights=(y - mean[where]) ** 2, minlength=_BINS) / np.maximum(count - 1, 1)
    middle = np.bincount(where, weights=x, minlength=_BINS) / total
    return middle[kept], mean[kept], 1.96 * np.sqrt(spread / total)[kept]


def spectrum_plot(series: SeriesFit) -> Markup:
    """Density of the residual before and after, and the model's final noise."""
    if len(series.t) < _LEAST:
        return Markup()
    axis, fs = axis_of(series), _rate(series)
    hz, before = spectrum(series.residual[:, axis], fs)
    _, after = spectrum((series.residual - series.modelled)[:, axis], fs)
    chart = Chart(
        f"Spectrum: {name_of(series)}, {AXES[axis]} axis",
        "frequency, Hz",
        f"{series.unit} per root Hz",
        (hz[0], hz[-1]),
        limits_of(before, after, log=True),
        log_x=True,
        log_y=True,
    )
    chart.line(hz, before, BEFORE, "real less simulated")
    chart.line(hz, after, AFTER, "with the effects")
    if series.power is not None:
        own = 0.5 * fs * np.arange(len(series.power)) / len(series.power)
        chart.line(hz, np.sqrt(np.interp(hz, own, series.power[:, axis]) / (0.5 * fs)), FLOOR, "model's noise")
    return chart.drawn()


def spectrum(values: Array, fs: float) -> tuple[Array, Array]:
    """Frequencies, and root of the one-sided density averaged in bins even in the logarithm."""
    power = np.abs(np.fft.rfft(values - values.mean())) ** 2 * (2.0 / (fs * len(values)))
    hz = np.fft.rfftfreq(len(values), 1.0 / fs)
    edges = np.geomspace(hz[1], hz[-1], _SPECTRUM // 2)
    where = np.searchsorted(edges, hz[1:])
    count = np.bincount(where)
    kept = count > 0
    mean = np.bincount(where, weights=power[1:])[kept] / count[kept]
    return np.bincount(where, weights=hz[1:])[kept] / count[kept], np.sqrt(mean)


def allan_plot(series: SeriesFit) -> Markup:
    """Allan deviation of the residual before and after."""
    if len(series.t) < 4 * _LEAST:
        return Markup()
    axis, fs = axis_of(series), _rate(series)
    tau, before = allan(series.residual[:, axis], fs)
    _, after = allan((series.residual - series.modelled)[:, axis], fs)
    chart = Chart(
        f"Allan deviation: {name_of(series)}, {AXES[axis]} axis",
        "averaging time, s",
        series.unit,
        limits_of(tau, log=True),
        limits_of(before, after, log=True),
        log_x=True,
        log_y=True,
    )
    chart.line(tau, before, BEFORE, "real less simulated")
    chart.line(tau, after, AFTER, "with the effects")
    return chart.drawn()


def allan(values: Array, fs: float) -> tuple[Array, Array]:
    """Averaging times (s) and overlapping Allan deviations, up to a quarter of the record."""
    sums = np.concatenate([[0.0], np.cumsum(values - values.mean())])
    sizes = np.unique(np.geomspace(1, len(values) // 4, 24).astype(int))
    found = []
    for m in sizes:
        means = (sums[m:] - sums[:-m]) / m
        found.append(np.sqrt(0.5 * np.mean((means[m:] - means[:-m]) ** 2)))
    return sizes / fs, np.array(found)


def strip(series: Sequence[SeriesFit], effects: Sequence[EffectEstimate]) -> list[Markup]:
    """One plot for each sensor: residual over time in units of its noise, before and after, above the conditions."""
    drawn = []
    for fit in series:
        if len(fit.t) < _LEAST:
            continue
        chart = _strip_chart(fit)
        for effect in effects:
            own = effect.sensor is fit.sensor and set(effect.instances) & set(fit.instances)
            if own and effect.id in by_id() and by_id()[effect.id].jumps:
                chart.mark(next(p.value for p in effect.params if p.name == "time_s"), "step", MODEL)
        drawn.append(chart.drawn())
    return drawn + conditions(series)


def _strip_chart(fit: SeriesFit) -> Chart:
    t, before = _energy(fit, fit.residual)
    _, after = _energy(fit, fit.residual - fit.modelled)
    chart = Chart(
        f"Over time: {name_of(fit)}",
        "time, s",
        "rms / noise",
        (float(fit.t[0]), float(fit.t[-1])),
        limits_of(before, after, log=True),
        width=880,
        height=160,
        log_y=True,
    )
    chart.line(t, before, BEFORE, "before")
    chart.line(t, after, AFTER, "after")
    return chart


def _energy(fit: SeriesFit, values: Array) -> tuple[Array, Array]:
    where = np.minimum((_STRIP * np.arange(len(values))) // len(values), _STRIP - 1)
    count = np.bincount(where, minlength=_STRIP)
    power = ((values / np.maximum(fit.sigma, 1e-30)) ** 2).mean(axis=1)
    kept = count > 0
    t = np.bincount(where, weights=fit.t, minlength=_STRIP)[kept] / count[kept]
    return t, np.sqrt(np.bincount(where, weights=power, minlength=_STRIP)[kept] / count[kept])


def conditions(series: Sequence[SeriesFit]) -> list[Markup]:
    """Temperature, current and throttle over time, each once."""
    units = {"temperature": "degC", "current": "A", "throttle": "0 to 1"}
    seen: dict[str, SeriesFit] = {}
    for fit in series:
        for name in fit.covariates:
            seen.setdefault(name, fit)
    drawn = []
    for name, fit in seen.items():
        t, values = thinned(fit.t, fit.covariates[name])
        if np.ptp(values) <= 0.0:
            continue
        chart = Chart(
            name.capitalize(),
            "time, s",
            units.get(name, ""),
            (float(fit.t[0]), float(fit.t[-1])),
            limits_of(values),
            width=880,
            height=140,
        )
        chart.line(t, values, MODEL)
        drawn.append(chart.drawn())
    return drawn


def overlay(series: SeriesFit) -> Markup:
    """Real, simulated and corrected simulation in the seconds where the effects move most."""
    if series.ideal is None or len(series.t) < _LEAST or not series.modelled.any():
        return Markup()
    axis = axis_of(series)
    rows = _busiest(series.t, series.modelled[:, axis] ** 2)
    t, ideal = series.t[rows], series.ideal[rows, axis]
    real, patched = ideal + series.residual[rows, axis], ideal + series.modelled[rows, axis]
    chart = Chart(
        f"{name_of(series)}, {AXES[axis]} axis",
        "time, s",
        series.unit,
        (float(t[0]), float(t[-1])),
        limits_of(real, ideal, patched),
    )
    chart.line(*thinned(t, real), BEFORE, "real", thin=True)
    chart.line(*thinned(t, ideal), FLOOR, "simulated")
    chart.line(*thinned(t, patched), AFTER, "simulated with the effects")
    return chart.drawn()


def _busiest(t: Array, power: Array) -> slice:
    """Rows of the window with most of `power`."""
    size = min(len(t), max(8, int(_WINDOW / max(float(np.median(np.diff(t))), 1e-6))))
    sums = np.concatenate([[0.0], np.cumsum(power)])
    start = int(np.argmax(sums[size:] - sums[:-size]))
    return slice(start, start + size)


def _rate(series: SeriesFit) -> float:
    return 1.0 / max(float(np.median(np.diff(series.t))), 1e-9)


def of_effect(series: Sequence[SeriesFit], effect_id: str) -> SeriesFit | None:
    """The series on which an effect shows most; None where it has no part in any mean."""
    having = [s for s in series if effect_id in s.parts]
    return max(having, key=lambda s: _size(s, effect_id)) if having else None


def _size(series: SeriesFit, effect_id: str) -> float:
    return float(((series.parts[effect_id] / np.maximum(series.sigma, 1e-30)) ** 2).sum())
