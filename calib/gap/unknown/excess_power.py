"""Power in the residual above the noise: in bands, in lines, or for a limited time.

A complete model leaves stationary white noise. Nothing is assumed about the shape of an excess.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.ndimage import uniform_filter1d
from scipy.special import chdtrc, fdtrc, ndtr

from mavcal.calib.gap.model.joint import Model
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.unknown.misattributed_noise import Unexplained, is_coarsely_quantised
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_LEFTOVER = 1e-7
"""P-value, over everything tested, below which power is more than noise. Source: GAP 3.3."""
_MINUTES_DIFFER = 2.0
"""Multiple of a learned spectrum up to which power may be variation between minutes. Chosen, not measured: noise
doubles from minute to minute (`baselines._NOISE_DIFFERENCE`)."""
_JOLT_S, _JOLTS = 0.5, 0.03
"""Length of a jolt, s, and fraction of a recording in jolts. Chosen, not measured: a filter of 20 Hz has settled by
then; two or three touchdowns of a flight of a minute."""
_GROUPS = 24
"""Bands of a series, of a constant ratio of frequencies. Chosen, not measured: some seven to a decade of frequency."""
_AROUND = 50
"""Number of bins around a line that form its background. Chosen, not measured: their mean power is known to 20 %
(sqrt(2/50))."""
_WINDOWS = (64, 256, 1024)
"""Lengths of short spectra, in samples. Chosen, not measured: a factor of four from one to the next, a third of a
second to some seconds at 200 Hz."""
_LENGTHS = (32, 64, 128, 256, 512, 1024)
"""Lengths of windows in which slow deviations are sought, in samples; they begin every half a length. Chosen, not
measured: an octave from one to the next, so that any length is within a factor of 1.5."""
_SLOW = 8
"""Lowest bins of such a window that are compared with the others. Chosen, not measured: four periods in a window;
faster ones are lines."""
_SLOWEST = 4
"""Lowest bins that are ignored, since a mean is fitted there. Chosen, not measured: two periods of a recording."""


@dataclass(frozen=True)
class _Excess:
    """Power above the noise: `nats`, and its p-value `p`, corrected within its kind."""

    sensor: Sensor
    p: float
    nats: float
    text: str


def excess_power(
    model: Model,
    bandwidth_hz: float = math.inf,
    floor: Mapping[Sensor, float] | None = None,
    *,
    outside: bool = False,
) -> list[Unexplained]:
    """By sensor, nats of significant power above the noise, and a description.

    Above `bandwidth_hz` an accelerometer measures movement that the reference does not contain. Excess below the
    sensor's `floor` is an error of the reference. `outside`: the reference is not a sensor of the vehicle (cameras), so
    that jolts belong to the sensor.
    """
    by_sensor: dict[Sensor, list[_Excess]] = {}
    for v, view in enumerate(model.setting.views):
        for one in _tested_excesses(model, v, bandwidth_hz, outside=outside):
            by_sensor.setdefault(view.sensor, []).append(one)
    found = []
    for sensor, excesses in by_sensor.items():
        nats = sum(one.nats for one in excesses)
        if 2.0 * nats > (floor or {}).get(sensor, 0.0):
            found.append(Unexplained(nats, min(excesses, key=lambda one: (one.p, one.text)).text, sensor))
    return found


def _tested_excesses(model: Model, v: int, bandwidth_hz: float, *, outside: bool) -> list[_Excess]:
    """Significant excesses of a series: in bands of one axis, else of all axes, else in lines, else transient ones."""
    # The error of the reference is known only up to the last of its cosines.
    turned = model.ridge.columns.parts if model.ridge is not None else {}
    axes = [c for c in range(3) if 3 * v + c not in turned]
    if not axes:
        return []
    view = model.setting.views[v]
    power = np.array([model.noise[3 * v + c].power for c in axes])
    white = view.spectra(model.residual[v])[axes] / np.sqrt(power)
    ratio = white**2
    tests = _GROUPS * model.setting.axes
    edges = _edges(view, bandwidth_hz)
    if len(edges) < 2:
        return []
    parts = {"xyz"[c]: white[j : j + 1] for j, c in enumerate(axes)}
    for looked in (
        (
            _band(view, own, (low, high), axis, outside=outside)
            for axis, own in parts.items()
            for low, high in itertools.pairwise(edges)
        ),
        (_band(view, white, band, outside=outside) for band in (*itertools.pairwise(edges), (edges[0], edges[-1]))),
        (_line(view, ratio[:, : edges[-1]]),),
        _transient_waves(view, white),
        _slow_deviations(view, white),
    ):
        found = [one for one in looked if one.p * tests < _LEFTOVER]
        if found:
            return found
    return []


def _edges(view: View, bandwidth_hz: float) -> list[int]:
    """Edges of bands, as bins, up to the bandwidth of the reference."""
    known = bandwidth_hz if view.reference_error and view.sensor is Sensor.ACCEL else math.inf
    edges = np.unique(np.geomspace(_SLOWEST, view.count, _GROUPS + 1).astype(np.intp))
    return [int(k) for j, k in enumerate(edges) if j == 0 or (k + view.first) * _bin_hz(view) <= known]


def _bin_hz(view: View) -> float:
    return 0.5 * view.fs / view.n


def _band(view: View, white: Array, band: tuple[int, int], axis: str = "", *, outside: bool) -> _Excess:
    """Relative power of axes in a band, from whitened spectra (p, count)."""
    low, high = band
    count, square = white[:, low:high].size, float((white[:, low:high] ** 2).sum())
    learned = view.density is not None
    if learned and square > _MINUTES_DIFFER * count and view.sensor is Sensor.ACCEL and not outside:
        square = min(square, _power_between_jolts(view, white, band))
    if learned and square <= _MINUTES_DIFFER * count:
        p = 1.0  # a learned spectrum is that of other minutes: twice as much is none of this recording's
    elif math.isinf(view.dof):
        p = float(chdtrc(count, square))
    else:
        p = float(fdtrc(count, view.dof * len(white), square / max(count, 1)))
    start, end = ((k + view.first) * _bin_hz(view) for k in band)
    on = f"{view.sensor.value}.{axis}" if axis else view.sensor.value
    return _Excess(view.sensor, p, _nats(square, count), f"power from {start:.3g} to {end:.3g} Hz on {on}")


def _power_between_jolts(view: View, white: Array, band: tuple[int, int]) -> float:
    """Sum of squares in a band without the hardest jolts, scaled to the whole recording.

    A touchdown lasts a few samples, and no two are equal. Units that sample at different times read it differently.
    """
    moved = np.add.reduce([view.traces[i].measured[view.keep] for i in view.weights])
    change = np.append((np.diff(moved, axis=0) ** 2).sum(axis=1), 0.0)
    change = uniform_filter1d(change, max(1, round(_JOLT_S * view.n / max(float(view.t[-1] - view.t[0]), 1e-9))))
    calm = change <= np.quantile(change, 1.0 - _JOLTS)
    series = np.where(calm, np.stack([view.whitened(axis) for axis in white]), 0.0)
    low, high = (k + view.first for k in band)
    return float((dct(series, type=2, norm="ortho", axis=1)[:, low:high] ** 2).sum() / calm.mean())


def _nats(square: float, count: int) -> float:
    """Gain, nats, of a fitted variance for `count` squares over unit variance."""
    return 0.5 * (square - count - count * math.log(square / count)) if square > count > 0 else 0.0


def _line(view: View, ratio: Array) -> _Excess:
    """The bin of axes (p, count) with the largest ratio to its surroundings."""
    level = 2 * _AROUND + 1
    surroundings = uniform_filter1d(ratio.sum(axis=0), level, mode="nearest") - ratio.sum(axis=0) / level
    least = 1.0 if view.density is None else _MINUTES_DIFFER
    peak = ratio.sum(axis=0) / np.maximum(surroundings / len(ratio), least)
    k = _SLOWEST + int(np.argmax(peak[_SLOWEST:]))
    nats = max(_nats(float(peak[k]), len(ratio)) - math.log(len(peak)), 0.0)
    text = f"a line at {(k + view.first) * _bin_hz(view):.4g} Hz on {view.sensor.value}"
    return _Excess(view.sensor, float(chdtrc(len(ratio), peak[k])) * len(peak), nats, text)


def _transient_waves(view: View, white: Array) -> Iterator[_Excess]:
    """Transient waves: short-time spectra of whitened spectra (p, count) that are less even than those of noise.

    Each cell of frequency and time has a p-value. For noise, minus its logarithm is exponential, and the sum of squares
    of n such numbers has the mean 2 n and the variance 20 n. A window is normalised by its own power: louder noise is
    not a wave. Spectra learned from flights are averages over such waves and are not tested.
    """
    if view.density is not None or view.variance is None or view.first or is_coarsely_quantised(view):
        return
    series = np.stack([view.whitened(axis) for axis in white])
    for width in _WINDOWS:
        count = series.shape[1] // width
        if count < 2:
            return
        short = dct(series[:, : count * width].reshape(len(series), count, width), type=2, norm="ortho", axis=2)
        cell = (short[..., _SLOWEST:] ** 2).sum(axis=0)
        cell *= len(series) / np.maximum(cell.mean(axis=1, keepdims=True), 1e-300)
        rare = -np.log(np.maximum(chdtrc(len(series), cell), 1e-300))
        beyond = (float((rare**2).sum()) - 2.0 * rare.size) / math.sqrt(20.0 * rare.size)
        c, k = np.unravel_index(int(np.argmax(rare)), rare.shape)
        hz, at = (k + _SLOWEST + 0.5) * 0.5 * view.fs / width, float(view.t[c * width])
        text = f"waves that come and go on {view.sensor.value}, at {at:.0f} s of {hz:.3g} Hz"
        yield _Excess(view.sensor, float(ndtr(-beyond)) * len(_WINDOWS), 0.5 * max(beyond, 0.0) ** 2, text)


def _slow_deviations(view: View, white: Array) -> Iterator[_Excess]:
    """Transient slow deviations: windows of whitened spectra (p, count) with most power in their first bins.

    A window is compared with its own noise, as in :func:`_transient_waves`: louder noise is not a deviation.
    """
    if view.density is not None or view.first or is_coarsely_quantised(view):
        return
    series = np.stack([view.whitened(axis) for axis in white])
    for width in _LENGTHS:
        starts = range(0, series.shape[1] - width + 1, width // 2)
        if len(starts) < 2:
            return
        windows = np.stack([series[:, k : k + width] for k in starts])
        square = dct(windows, type=2, norm="ortho", axis=2) ** 2
        slow, rest = square[..., :_SLOW].sum(axis=(1, 2)), square[..., _SLOW:].sum(axis=(1, 2))
        low, high = len(series) * _SLOW, len(series) * (width - _SLOW)
        ratio = (slow / low) / np.maximum(rest / high, 1e-300)
        k = int(np.argmax(ratio))
        p = float(fdtrc(low, high, ratio[k])) * len(starts) * len(_LENGTHS)
        own = max(_nats(float(ratio[k]) * low, low) - math.log(len(starts) * len(_LENGTHS)), 0.0)
        when = f"at {view.t[starts[k]]:.1f} s within {width / view.fs:.2g} s"
        text = f"something that passes {when} on {view.sensor.value}"
        yield _Excess(view.sensor, p, own, text)
