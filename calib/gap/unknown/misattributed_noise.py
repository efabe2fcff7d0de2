"""Noise effects of a model that are not the noise of a sensor.

Drift that is common to the axes has one driver. Drift that returns to its mean (Gauss-Markov) is neither a random walk
nor flicker. Noise that comes and goes is not the stationary noise that is declared. Noise in a few windows only is an
event, such as a person handling the vehicle.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from mavcal.calib.gap.effects.base import NoiseEffect
from mavcal.calib.gap.likelihood import fit_amplitudes, flicker, random_walk
from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.model.joint import Model, NoiseTerm
from mavcal.calib.gap.model.noise_fit import noise_rows
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.reference.resolution import step_of
from mavcal.calib.gap.schema import HiddenDriver
from mavcal.calib.gap.search.added_noise import is_line_unsteadiness
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_DRIVEN = 1e-3
"""P-value of the axes' correlation below which they have a common driver. Source: GAP 3.3 has the test. The value is
chosen, not measured: one series in a thousand."""
_LEAST = 6
"""Least number of bins dominated by a drift, or of energy windows, for a test. Chosen, not measured: a correlation of
three axes from fewer means nothing."""
_RETURNS, _RETURNS_EACH = 8.0, 14.0
"""Least gain, in twice the log-likelihood, of mean-reverting noise over a walk: with one corner, with one per axis.
Chosen, not measured: one number more, or three, gain as much with a chance of 0.005 and 0.003."""
_POLES = np.geomspace(3e-5, 0.3, 20)
"""Corner frequencies that are tried, rad per sample. Chosen, not measured: a factor of 1.6 from one to the next."""


@dataclass(frozen=True, eq=False)
class MisattributedNoise:
    """A noise effect with another cause; `driver` if the axes drift together."""

    key: tuple[str, tuple[int, ...]]
    text: str
    driver: HiddenDriver | None


def misattributed_noise(model: Model) -> tuple[MisattributedNoise, ...]:
    """Random walks and flicker of the model that are not a sensor's own noise."""
    found = []
    for term in model.noise_terms:
        if not term.hypothesis.effect.drifts or is_line_unsteadiness(term, model):
            continue
        sensor = term.hypothesis.effect.sensor
        for v, view in enumerate(model.setting.views):
            if view.first or not term.hypothesis.touches(view):
                continue
            driver = hidden_driver(model, v, term)
            if driver is not None:
                text = (
                    f"hidden scalar driver along [{', '.join(f'{d:.2f}' for d in driver.direction)}] on {sensor.value}"
                )
                found.append(MisattributedNoise(term.hypothesis.key, text, driver))
                break
            if returns_to_mean(model, v, term):
                text = f"drift that comes back (Gauss-Markov) on {sensor.value}"
                found.append(MisattributedNoise(term.hypothesis.key, text, None))
                break
    return tuple(found)


def hidden_driver(model: Model, v: int, term: NoiseTerm) -> HiddenDriver | None:
    """The common driver of the axes' drifts if they are correlated (Bartlett), else None.

    An axis that reads the same as its reference has no drift and does not count.
    """
    view = model.setting.views[v]
    y, own = [], []
    for c in range(3):
        noise = model.noise[3 * v + c]
        part = sum(noise.amplitudes[name] * noise.densities[name] for name in noise.densities if name == term.name(0))
        y.append(view.spectra(model.residual[v])[c] / np.sqrt(noise.power))
        own.append(part / noise.power)
    bins = np.flatnonzero(np.max(own, axis=0) > 0.5)
    if len(bins) < _LEAST:
        return None
    low = np.array(y)[:, bins]
    norm = np.sqrt((low**2).sum(axis=1))
    live = norm > 0.0
    k = int(live.sum())
    if k < 2:
        return None
    correlation = (low[live] @ low[live].T) / np.outer(norm[live], norm[live])
    statistic = -(len(bins) - 1.0 - (2.0 * k + 5.0) / 6.0) * math.log(max(float(np.linalg.det(correlation)), 1e-300))
    p = float(chdtrc(k * (k - 1) // 2, statistic))
    if p > _DRIVEN:
        return None
    scale = np.array([math.sqrt(float(model.noise[3 * v + c].power[bins].mean())) for c in range(3)])
    leading = np.linalg.eigh((low * scale[:, None]) @ (low * scale[:, None]).T)[1][:, -1]
    leading = leading * np.sign(leading[np.argmax(np.abs(leading))])
    return HiddenDriver(p, (float(leading[0]), float(leading[1]), float(leading[2])), view.sensor)


def returns_to_mean(model: Model, v: int, term: NoiseTerm) -> bool:
    """Whether noise with a corner, ``1 / (4 sin^2(w/2) + lambda)``, fits much better than a random walk and flicker."""
    view = model.setting.views[v]
    bins = model.setting.bins[v]
    steep = 1.0 / random_walk(view.omega)
    corners = [view.gain * bins.mean(1.0 / (steep + pole**2)) for pole in _POLES]
    known = [view.gain * bins.mean(form(view.omega)) for form in (random_walk, flicker)]
    common, each = np.zeros(len(_POLES)), 0.0
    best = np.zeros(len(known))
    for c in range(3):
        counts, power, base, rows = noise_rows(model, 3 * v + c, term.name(0))
        if term.name(0) not in model.noise[3 * v + c].densities:
            continue
        bare = fit_amplitudes(power, counts, base, rows).deviance
        plain = np.array([bare - fit_amplitudes(power, counts, base, [*rows, form]).deviance for form in known])
        gains = np.array([bare - fit_amplitudes(power, counts, base, [*rows, corner]).deviance for corner in corners])
        common, best = common + gains, best + plain
        each += max(float(gains.max() - plain.max()), 0.0)
    return float(common.max() - best.max()) > _RETURNS or each > _RETURNS_EACH


_AXIS_GROUPS = (([0, 1, 2], ""), ([0], ".x"), ([1], ".y"), ([2], ".z"))
"""Axes whose noise may swell together, and their name: one supply feeds all three."""
_WINDOWS = (4, 8, 16, 32, 64, 128)
"""Samples over which energies are summed, in turn. Chosen, not measured: an octave from one to the next."""
_CLIPPED_QUANTILE = 0.99
"""Quantile of the energy above which samples are clipped. Chosen, not measured: a few large samples are heavy tails,
not swelling."""
_NONSTATIONARY = 1e-6
"""P-value, over everything tested, below which noise is not stationary. Chosen, not measured: white noise of real
sensors is never exactly normal."""


@dataclass(frozen=True)
class Unexplained:
    """Nats in the residual of a sensor that no effect of the model explains, and their description."""

    nats: float
    text: str
    sensor: Sensor


def nonstationary_noise(model: Model) -> list[Unexplained]:
    """By sensor, nats by which noise of varying power fits better than stationary noise, if significant.

    Only with declared white noise and without modulated noise in the model: a spectrum learned from flights is an
    average over their own variation.
    """
    worst: dict[Sensor, Unexplained] = {}
    for v, view in enumerate(model.setting.views):
        if (
            view.density is not None
            or view.variance is None
            or view.first
            or has_modulated_noise(model, view)
            or is_coarsely_quantised(view)
        ):
            continue
        white = np.stack(
            [
                view.whitened(view.spectra(model.residual[v])[c] / np.sqrt(model.noise[3 * v + c].power))
                for c in range(3)
            ]
        )
        for axes, name in _AXIS_GROUPS:
            for width in _WINDOWS:
                nats = _excess_scatter(white[axes], width, len(_WINDOWS) * len(_AXIS_GROUPS) * len(model.setting.views))
                if nats > (worst[view.sensor].nats if view.sensor in worst else 0.0):
                    text = f"noise that comes and goes within {width / view.fs:.2g} s on {view.sensor.value}{name}"
                    worst[view.sensor] = Unexplained(nats, text, view.sensor)
    return list(worst.values())


def is_coarsely_quantised(view: View) -> bool:
    """Whether quantisation steps exceed the noise, so that the error of rounding is no noise."""
    for trace in view.traces.values():
        rows = trace.measured[view.keep] if len(trace.t) == len(view.keep) else trace.measured
        variance = float(np.mean(view.variance)) if view.variance is not None else 0.0
        if step_of(rows) ** 2 > variance:
            return True
    return False


def has_modulated_noise(model: Model, view: View) -> bool:
    """Whether the model has noise on a series whose power follows a known envelope."""
    return any(
        isinstance(term.hypothesis.effect, NoiseEffect)
        and term.hypothesis.effect.variance is not None
        and term.hypothesis.touches(view)
        for term in model.noise_terms
    )


def _excess_scatter(white: Array, width: int, tests: int) -> float:
    """Excess scatter, in nats, of the energies of windows of `width` samples of axes (p, n); 0 if chance explains it.

    Chance is judged by the scatter of single energies in any order, whatever their tails (Pearson). The largest ones
    are clipped, or two of them in one window would be significant.
    """
    count = white.shape[1] // width
    if count < _LEAST:
        return 0.0
    energy = (white[:, : count * width] ** 2).sum(axis=0)
    each = np.minimum(energy, np.quantile(energy, _CLIPPED_QUANTILE))
    spread = float(each.var())
    sums = each.reshape(count, width).sum(axis=1)
    square = float(sums.var()) * count / max(width * spread, 1e-300)
    if float(chdtrc(count - 1, square)) * tests > _NONSTATIONARY:
        return 0.0
    freedom = width * len(white)
    mean = energy.reshape(count, width).sum(axis=1) / float(energy.mean() * width)
    scatter = float((freedom * (mean - 1.0 - np.log(np.maximum(mean, 1e-12)))).sum())
    bartlett = 1.0 + 1.0 / (3.0 * freedom)  # correction of the ratio of one variance
    return float(0.5 * (scatter - bartlett * (count - 1)))


_WINDOW_S = 1.0
"""Seconds of a window. Source: decision 34 counts seconds."""
_FEWEST = 20
"""Least number of windows in a recording to compare them. Chosen, not measured: a quarter of them is then five."""
_BURST_SHARE = 0.25
"""Largest fraction of the windows in bursts; noise of a sensor is in all of them. Source: decision 34."""
_LOUD_RATIO = 0.5
"""Excess of a window, relative to the mean, above which it contains the noise. Chosen, not measured: half of the mean
is beyond the scatter of a window without it."""
_BURST_PAUSE_S = 3.0
"""Longest pause, s, between loud windows of one burst. Chosen, not measured: a person who handles a vehicle pauses for
as long."""
_LISTED = 3
"""Most bursts whose times are listed. Chosen, not measured: a sentence that a person reads."""


def bursts(model: Model) -> Iterator[tuple[Key, str]]:
    """Noise terms that are present in a small part of the recording, and a description with times."""
    for term in model.noise_terms:
        effect = term.hypothesis.effect
        if not isinstance(effect, NoiseEffect) or effect.drifts or effect.variance is not None or effect.shape:
            continue
        if (spans := _burst_spans(model, term)) is not None:
            when = ", ".join(f"{start:.0f} to {end:.0f} s" for start, end in spans[:_LISTED])
            more = f" and {len(spans) - _LISTED} more times" if len(spans) > _LISTED else ""
            yield term.hypothesis.key, f"noise on {effect.sensor.value} from {when}{more} only"


def _burst_spans(model: Model, term: NoiseTerm) -> list[tuple[float, float]] | None:
    """Intervals in which the noise of a term is present, s, the longest first; None if throughout or undecided."""
    edges, excess = _excess_by_window(model, term)
    mean = float(excess.mean()) if len(excess) >= _FEWEST else 0.0
    loud = np.flatnonzero(excess > _LOUD_RATIO * mean)
    if mean <= 0.0 or not 0 < len(loud) <= _BURST_SHARE * len(excess):
        return None
    breaks = np.flatnonzero(np.diff(loud) > _BURST_PAUSE_S / _WINDOW_S)
    groups = np.split(loud, breaks + 1)
    spans = [(float(edges[g[0]]), float(edges[g[-1] + 1])) for g in groups]
    return sorted(spans, key=lambda span: span[0] - span[1])


def _excess_by_window(model: Model, term: NoiseTerm) -> tuple[Array, Array]:
    """Edges (m + 1,) of windows of one second, and their power (m,) above the noise without the term."""
    touched = [v for v, view in enumerate(model.setting.views) if term.hypothesis.touches(view)]
    times = [model.setting.views[v].t for v in touched]
    first, last = min(float(t[0]) for t in times), max(float(t[-1]) for t in times)
    edges = first + _WINDOW_S * np.arange(int((last - first) / _WINDOW_S) + 1)
    squares, counts = np.zeros(max(len(edges) - 1, 0)), np.zeros(max(len(edges) - 1, 0))
    names = {term.name(j) for j in range(len(term.hypothesis.effect.parameters))}
    for v in touched:
        view = model.setting.views[v]
        at = np.searchsorted(edges, view.t, side="right") - 1
        inside = (at >= 0) & (at < len(squares))
        for c in range(3):
            noise = model.noise[3 * v + c]
            own = sum((noise.amplitudes[n] * noise.densities[n] for n in names & noise.densities.keys()), 0.0)
            bare = np.maximum(noise.power - own, 1e-300)
            white = view.whitened(view.spectra(model.residual[v])[c] / np.sqrt(bare))
            squares += np.bincount(at[inside], white[inside] ** 2, len(squares))
            counts += np.bincount(at[inside], None, len(squares)) * (view.count / view.n)
    return np.asarray(edges, dtype=np.float64), squares - counts
