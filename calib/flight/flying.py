"""Checks the inertial sensors in flight: vibration, clipping, and whether redundant units agree in scale."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import Any, Final

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.stream.auxiliary import telemetry
from mavcal.calib.flight import limits
from mavcal.calib.flight.item import FlightVerdict, JudgedItem, judged, not_testable
from mavcal.calib.flight.rest import TimeSpan
from mavcal.calib.recording import Array, Channel, Event, Oddity, Recording, Sensor, Stage
from mavcal.calib.stats.correlated import long_run_variance
from mavcal.calib.stats.windows import finite_rows

FULL_SCALE: Final = 156.9
"""16 g, m/s2: the range that autopilots set."""

_RANGES = (4, 8, 16, 32)  # g, that drivers set
_SLACK = 0.02  # of a range: scale and offset move its end
_PILED = 3  # samples, and times as many as just below: the tail of any vibration falls
_NEAR_END = 0.9  # of a range, where a low-passed sample may have been at its end
_HIGH = 5.0  # Hz: what is faster is no manoeuvre (the filter of ArduPilot's VIBE)
_WINDOW = 1.0  # s of a spectrum
_AT_ONCE = 64  # windows of it
_LEAST_FLIGHT = 5.0  # s
_TONES = 3
_PAUSE = 5.0  # periods
_SLOWEST = 20.0  # Hz
_PROMINENT = 30.0  # times the floor around it
_CELL = 0.1  # s
_LEARNT = 0.02  # sd of a scale: more is no comparison


def flying_items(
    recording: Recording, flown: Sequence[TimeSpan], shaking: Sequence[JudgedItem] | None = None
) -> list[JudgedItem]:
    """Every item of a flight; `flown` are the spans with the motors on, `shaking` the vibration items if known."""
    items = [*(shaking_items(recording, flown) if shaking is None else shaking)]
    for sensor in (Sensor.ACCEL, Sensor.GYRO):
        items += [_scale(recording, sensor, pair, flown) for pair in combinations(recording.instances(sensor), 2)]
    return items


def shaking_items(recording: Recording, flown: Sequence[TimeSpan]) -> list[JudgedItem]:
    """Vibration and clipping of every accelerometer."""
    return [
        item
        for instance in recording.instances(Sensor.ACCEL)
        for item in (_vibration(recording, instance, flown), _clipping(recording, instance))
    ]


def _fastest_accel(recording: Recording, instance: int) -> Channel | None:
    """The accelerometer channel with the widest band: unfiltered first, then the one with more samples."""
    found = [c for c in recording.find(Sensor.ACCEL, instance) if c.unit == "m/s2"]
    return min(found, key=lambda c: (c.stage in (Stage.FILTERED, Stage.DEBIASED), -len(c)), default=None)


def _vibration(recording: Recording, instance: int, flown: Sequence[TimeSpan]) -> JudgedItem:
    subject = f"accel {instance + 1}"
    channel = _fastest_accel(recording, instance)
    if channel is None:
        return not_testable("vibration", subject, "it is not in m/s2")
    spectrum = _spectrum(channel, flown)
    if spectrum is None:
        return not_testable(
            "vibration", subject, f"fewer than {_LEAST_FLIGHT:.0f} s with the motors on at {_SLOWEST:.0f} Hz or more"
        )
    frequency, density = spectrum
    high = frequency >= _HIGH
    rms = np.sqrt(np.trapezoid(density[high], frequency[high], axis=0))
    tones = _tones(frequency[high], density[high].sum(axis=1))
    listed = ", ".join(f"{t['hz']:.0f} Hz of {t['amplitude']:.2g} m/s2" for t in tones) or "no tone"
    worst = float(rms.max())
    text = f"{worst:.2f} m/s2 rms above {_HIGH:.0f} Hz up to {frequency[-1]:.0f} Hz ({listed})"
    numbers = {
        "rms": rms.tolist(),
        "tones": tones,
        "source": channel.source,
        "nyquist_hz": float(frequency[-1]),
        "filtered": channel.stage == Stage.FILTERED,
    }
    if channel.stage != Stage.FILTERED:
        return judged("vibration", subject, worst, limits.VIBRATION, text, **numbers)
    item = judged("vibration", subject, worst, limits.LOW_PASSED, f"at least {text}, low-passed", **numbers)
    if item.verdict != FlightVerdict.PASS:  # what is left is more than enough already
        return item
    how = "take the log on board" if telemetry(recording) else "log the unfiltered samples (raw IMU or batch sampling)"
    why = f"{text}: {channel.source} is low-passed, what it hides is not known; {how}"
    return JudgedItem("vibration", subject, FlightVerdict.NOT_TESTABLE, why, worst, None, limits.LOW_PASSED, numbers)


def _spectrum(channel: Channel, flown: Sequence[TimeSpan]) -> tuple[Array, Array] | None:
    """Frequencies (F,) and power density (F, 3) over the flown spans, pauses left out; None: too short or too slow."""
    runs = []
    for span in flown:
        part = usable(channel.between(span.start, span.end))
        if len(part) > 1:
            period = float(np.median(np.diff(part.t)))
            cuts = np.flatnonzero(np.diff(part.t) > _PAUSE * period) + 1
            edges = [0, *cuts.tolist(), len(part)]
            runs += [part.take(slice(first, last)) for first, last in pairwise(edges)]
    duration = sum(float(run.t[-1] - run.t[0]) for run in runs)
    rate = sum(len(run) - 1 for run in runs) / duration if duration > 0.0 else 0.0
    window = int(_WINDOW * rate)
    if rate < _SLOWEST or duration < _LEAST_FLIGHT:
        return None
    total, weight, frequency = np.zeros((window // 2 + 1, 3)), 0, np.zeros(0)
    for run in runs:
        at = np.arange(run.t[0], run.t[-1], 1.0 / rate)  # loggers drop samples and stamp in batches
        if len(at) >= window:
            frequency, density = _welch(run, at, rate, window)
            total, weight = total + density * len(at), weight + len(at)
    return (frequency, total / weight) if weight else None


def usable(channel: Channel) -> Channel:
    """The finite samples with increasing times; `channel` itself if all are."""
    good = finite_rows(channel.values)
    good[1:] &= channel.t[1:] > channel.t[:-1]
    return channel if good.all() else channel.take(good)


def _welch(run: Channel, at: Array, rate: float, window: int) -> tuple[Array, Array]:
    """Mean power density of the half-overlapping windows of `run` at the even times `at`, some windows at a time."""
    from scipy.signal import welch  # a second of processor time, which who looks at no flight does without

    hop = window - window // 2
    windows = (len(at) - window) // hop + 1
    total, frequency = np.zeros((window // 2 + 1, 3)), np.zeros(0)
    for first in range(0, windows, _AT_ONCE):
        count = min(_AT_ONCE, windows - first)
        here = at[first * hop : (first + count - 1) * hop + window]
        begin, end = np.searchsorted(run.t, (here[0], here[-1]))
        rows = slice(max(int(begin) - 1, 0), int(end) + 1)
        even = np.column_stack([np.interp(here, run.t[rows], column) for column in run.values[rows].T])
        frequency, density = welch(even, fs=rate, nperseg=window, axis=0)
        total += density * count
    return frequency, total / windows


def _tones(frequency: Array, density: Array) -> list[dict[str, float]]:
    """The strongest lines of a spectrum, with the amplitude of a sine of that power."""
    if len(density) < 8:
        return []
    from scipy.signal import find_peaks  # likewise

    floor = float(np.median(density))
    peaks, _ = find_peaks(density, height=_PROMINENT * floor, distance=3)
    strongest = sorted(peaks.tolist(), key=lambda k: -float(density[k]))[:_TONES]
    step = float(frequency[1] - frequency[0])
    found = []
    for k in strongest:
        power = float(density[max(k - 2, 0) : k + 3].sum()) * step
        found.append({"hz": float(frequency[k]), "amplitude": float(np.sqrt(2.0 * power))})
    return found


def _clipping(recording: Recording, instance: int) -> JudgedItem:
    """Counted by the autopilot, or seen as samples at the end of the range."""
    subject = f"accel {instance + 1}"
    counts = [e.odd.count for e in clipped_events(recording, instance) if e.odd is not None]
    if counts:
        return judged("clipping", subject, float(sum(counts)), limits.CLIPPED, f"clipped {sum(counts)} times")
    channel = _fastest_accel(recording, instance)
    values = None if channel is None else _usable_rows(channel.values)
    if channel is None or values is None or not len(values):
        return not_testable("clipping", subject, "no sample in m/s2")
    end, at_end = _at_end(values)
    most = max(float(values.max()), -float(values.min()))
    text = f"{at_end} sample{'' if at_end == 1 else 's'} at {end} g, the largest is {most:.1f} m/s2"
    if not at_end:
        text = f"no peaks pile up at the end of a range, the largest is {most:.1f} m/s2"
    if not at_end and channel.stage == Stage.FILTERED and most > _NEAR_END * _RANGES[0] * STANDARD_GRAVITY:
        return not_testable("clipping", subject, f"{text}, low-passed: what it was before is not known", largest=most)
    return judged("clipping", subject, float(at_end), limits.CLIPPED, text, largest=most)


def _at_end(values: Array) -> tuple[int, int]:
    """Range, g, at whose end samples (N, 3) pile up, else the largest range, and the number of samples there."""
    size = np.abs(values[:, 0])
    for axis in (1, 2):  # one column at a time: a log may have millions of samples
        np.maximum(size, np.abs(values[:, axis]), out=size)
    size.sort()
    for g in _RANGES:
        end = g * STANDARD_GRAVITY
        width = _SLACK * end
        beyond = len(size) - int(np.searchsorted(size, end + width))
        near = len(size) - int(np.searchsorted(size, end - width)) - beyond
        below = len(size) - int(np.searchsorted(size, end - 3.0 * width)) - near - beyond
        if near >= _PILED and near > _PILED * below and _PILED * beyond < near:
            return g, near
    return round(FULL_SCALE / STANDARD_GRAVITY), len(size) - int(np.searchsorted(size, 0.999 * FULL_SCALE))


def clipped_events(recording: Recording, instance: int) -> list[Event]:
    """Clip counts of that accelerometer by the autopilot."""
    of = Oddity.CLIPPED, Sensor.ACCEL, instance
    return [e for e in recording.events if e.odd is not None and (e.odd.what, e.odd.sensor, e.odd.instance) == of]


def _usable_rows(values: Array) -> Array:
    good = finite_rows(values)
    return values if good.all() else values[good]


def _scale(recording: Recording, sensor: Sensor, pair: tuple[int, int], flown: Sequence[TimeSpan]) -> JudgedItem:
    """Scale ratio of two instances, axis by axis, from their common motion."""
    name, subject = f"{sensor.value}_scale", f"{sensor.value} {pair[0] + 1}, {pair[1] + 1}"
    cells = _cells(recording, sensor, pair, flown)
    if len(cells) < 100:
        return not_testable(name, subject, "not enough samples of both with the motors on")
    first, second = cells[:, :3], cells[:, 3:]
    scale, sd = _ratio(first, second)
    known = sd < _LEARNT
    numbers: dict[str, Any] = {
        "scale": [float(v) if ok else None for v, ok in zip(scale, known, strict=True)],
        "scale_sd": [float(v) if ok else None for v, ok in zip(sd, known, strict=True)],
    }
    if not known.any():
        return not_testable(
            name, subject, "the vehicle moved too little for the noise: no scale is known to 2 %", **numbers
        )
    off = np.where(known, np.abs(scale - 1.0) - 2.0 * sd, -np.inf)
    worst = int(np.argmax(off))
    shown = ", ".join(
        f"{axis} {100.0 * (s - 1.0):+.2f} +- {100.0 * d:.2f}" if ok else f"{axis} not excited"
        for axis, s, d, ok in zip("xyz", scale, sd, known, strict=True)
    )
    text = f"scale of the first over the second, %: {shown}"
    return judged(name, subject, abs(float(scale[worst]) - 1.0), limits.SCALE, text, sd=float(sd[worst]), **numbers)


def _cells(recording: Recording, sensor: Sensor, pair: tuple[int, int], flown: Sequence[TimeSpan]) -> Array:
    """Means (M, 6) of both instances over the same tenths of a second."""
    try:
        channels = [recording.channel(sensor, i) for i in pair]
    except InvalidInputError:  # an estimator's bias is subtracted from one of them
        return np.zeros((0, 6))
    if channels[0].unit != channels[1].unit:
        return np.zeros((0, 6))
    rows = []
    for span in flown:
        edges = np.arange(span.start, span.end, _CELL)
        if len(edges) < 2:
            continue
        means = []
        for channel in channels:
            part = channel.between(edges[0], edges[-1])
            good = finite_rows(part.values)
            part = part if good.all() else part.take(good)
            number = np.searchsorted(edges, part.t, side="right") - 1
            count = np.bincount(number, minlength=len(edges))[: len(edges)]
            sums = [np.bincount(number, weights=c, minlength=len(edges))[: len(edges)] for c in part.values.T]
            means.append(np.where(count > 0, np.array(sums) / np.maximum(count, 1), np.nan).T)
        both = np.hstack(means)
        rows.append(both[finite_rows(both)])
    return np.concatenate(rows) if rows else np.zeros((0, 6))


def _ratio(first: Array, second: Array) -> tuple[Array, Array]:
    """Diagonal (3,) of the matrix from `second` to `first` and its sd; cross terms and an offset are nuisances.

    The noise of `second`, taken as half of the difference, attenuates a regression; the sd includes the possible bias.
    """
    design = np.column_stack([second - second.mean(axis=0), np.ones(len(second))])
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-12)
    solution = np.linalg.lstsq(design / size, first, rcond=1e-12)[0] / size[:, None]
    residual = first - design @ solution
    inverse = np.linalg.pinv((design / size).T @ (design / size), rcond=1e-12) / np.outer(size, size)
    scale, sd = np.diag(solution[:3]).copy(), np.empty(3)
    for axis in range(3):
        information = max(float(inverse[axis, axis]), 1e-300)
        noise = 0.5 * float(residual[:, axis].var())
        shrink = noise * len(first) * information
        spread = long_run_variance(residual[:, axis]) * information
        sd[axis] = np.sqrt(spread) + min(shrink, 1.0)
    return scale, sd
