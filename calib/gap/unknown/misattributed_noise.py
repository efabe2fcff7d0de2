"""Noise that is no sensor's own.

Drift whose axes move together has one driver; drift that comes back (Gauss-Markov) is neither a walk nor flicker; noise
that swells and fades is not the steady one that is declared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from mavcal.calib.gap.effects.base import NoiseEffect
from mavcal.calib.gap.likelihood import fit_amplitudes, flicker, random_walk
from mavcal.calib.gap.model.joint import Model, NoiseTerm
from mavcal.calib.gap.model.noise_fit import noise_rows
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.reference.resolution import step_of
from mavcal.calib.gap.schema import HiddenDriver
from mavcal.calib.gap.search.added_noise import unsteady_line
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_DRIVEN = 1e-3
"""Chance of independent axes' correlation below which something drives them together. Source: GAP 3.3 has the test. The
chance is chosen, not measured: one series in a thousand."""
_LEAST = 6
"""Bins in which a drift is most of the noise, or windows of energy, below which nothing is said. Chosen, not measured:
a correlation of three axes from fewer means nothing."""
_RETURNS, _RETURNS_EACH = 8.0, 14.0
"""Twice the log-likelihood by which noise that comes back must beat a walk: with one corner, with one for each axis.
Chosen, not measured: one number more, or three, gain as much with a chance of 0.005 and 0.003."""
_POLES = np.geomspace(3e-5, 0.3, 20)
"""Corners that are tried, rad per sample. Chosen, not measured: a factor of 1.6 from one to the next."""


@dataclass(frozen=True, eq=False)
class MisattributedNoise:
    """A noise effect that is something else."""

    key: tuple[str, tuple[int, ...]]
    text: str
    driver: HiddenDriver | None


def misattributed_noise(model: Model) -> tuple[MisattributedNoise, ...]:
    """Random walks and flicker of the model that are not a sensor's own noise."""
    found = []
    for term in model.noise_terms:
        if not term.hypothesis.effect.drifts or unsteady_line(term, model):
            continue
        sensor = term.hypothesis.effect.sensor
        for v, view in enumerate(model.setting.views):
            if view.first or not term.hypothesis.touches(view):
                continue
            driver = coherent(model, v, term)
            if driver is not None:
                text = (
                    f"hidden scalar driver along [{', '.join(f'{d:.2f}' for d in driver.direction)}] on {sensor.value}"
                )
                found.append(MisattributedNoise(term.hypothesis.key, text, driver))
                break
            if returning(model, v, term):
                text = f"drift that comes back (Gauss-Markov) on {sensor.value}"
                found.append(MisattributedNoise(term.hypothesis.key, text, None))
                break
    return tuple(found)


def coherent(model: Model, v: int, term: NoiseTerm) -> HiddenDriver | None:
    """Whether the axes' drifts are correlated (Bartlett): then something drives them together.

    An axis that reads the same as its reference has no drift, and drives nothing.
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


def returning(model: Model, v: int, term: NoiseTerm) -> bool:
    """Whether noise with a corner, ``1 / (4 sin^2(w/2) + lambda)``, fits much better than a walk and than flicker."""
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


_TOGETHER = (([0, 1, 2], ""), ([0], ".x"), ([1], ".y"), ([2], ".z"))
"""Axes that may swell together, and their name: one supply feeds all three."""
_WINDOWS = (4, 8, 16, 32, 64, 128)
"""Samples over which energies are summed, in turn. Chosen, not measured: an octave from one to the next."""
_MOST = 0.99
"""Part of the samples whose energy counts as it is. Chosen, not measured: a few large samples are heavy tails and do
not swell."""
_UNSTEADY = 1e-6
"""Chance, over all that is looked at, below which steady noise does not scatter so. Chosen, not measured: white noise
of real sensors is never exactly normal."""


@dataclass(frozen=True)
class Unexplained:
    """Nats of what is in no effect of a model, the sensor on which it is, and what is said of it."""

    nats: float
    text: str
    sensor: Sensor


def unsteady(model: Model) -> list[Unexplained]:
    """By sensor, nats by which noise that swells and fades would fit better than the steady one, if not by chance.

    Only where white noise is declared and nothing in the model varies by itself: what was learned from flights was
    averaged over its own swelling.
    """
    worst: dict[Sensor, Unexplained] = {}
    for v, view in enumerate(model.setting.views):
        if view.density is not None or view.variance is None or view.first or varies(model, view) or coarse(view):
            continue
        white = np.stack(
            [
                view.whitened(view.spectra(model.residual[v])[c] / np.sqrt(model.noise[3 * v + c].power))
                for c in range(3)
            ]
        )
        for axes, name in _TOGETHER:
            for width in _WINDOWS:
                nats = _swelling(white[axes], width, len(_WINDOWS) * len(_TOGETHER) * len(model.setting.views))
                if nats > (worst[view.sensor].nats if view.sensor in worst else 0.0):
                    text = f"noise that comes and goes within {width / view.fs:.2g} s on {view.sensor.value}{name}"
                    worst[view.sensor] = Unexplained(nats, text, view.sensor)
    return list(worst.values())


def coarse(view: View) -> bool:
    """Whether readings are rounded so much that the error of rounding is no noise."""
    for trace in view.traces.values():
        rows = trace.measured[view.keep] if len(trace.t) == len(view.keep) else trace.measured
        variance = float(np.mean(view.variance)) if view.variance is not None else 0.0
        if step_of(rows) ** 2 > variance:
            return True
    return False


def varies(model: Model, view: View) -> bool:
    """Whether a model has noise on a series that goes with something: it is not steady, and has a name."""
    return any(
        isinstance(term.hypothesis.effect, NoiseEffect)
        and term.hypothesis.effect.variance is not None
        and term.hypothesis.touches(view)
        for term in model.noise_terms
    )


def _swelling(white: Array, width: int, tests: int) -> float:
    """Excess scatter of the energies of windows of `width` samples of axes (p, n), in nats; 0 if chance makes as much.

    Chance is that of the same samples in any other order: the energies' own scatter, whatever their tails (Pearson).
    The largest count as what most stay below, or two single ones beside each other would do.
    """
    count = white.shape[1] // width
    if count < _LEAST:
        return 0.0
    energy = (white[:, : count * width] ** 2).sum(axis=0)
    each = np.minimum(energy, np.quantile(energy, _MOST))
    spread = float(each.var())
    sums = each.reshape(count, width).sum(axis=1)
    square = float(sums.var()) * count / max(width * spread, 1e-300)
    if float(chdtrc(count - 1, square)) * tests > _UNSTEADY:
        return 0.0
    freedom = width * len(white)
    mean = energy.reshape(count, width).sum(axis=1) / float(energy.mean() * width)
    scatter = float((freedom * (mean - 1.0 - np.log(np.maximum(mean, 1e-12)))).sum())
    bartlett = 1.0 + 1.0 / (3.0 * freedom)  # correction of the ratio of one variance
    return float(0.5 * (scatter - bartlett * (count - 1)))
