"""Still spans of a recording, with the sensors' means.

Windows begin every quarter of their length. For each, the scatter about a straight line, the turn of gravity across it
and the mean rate are judged. Consecutive still windows make a span as long as their means stay together; half a window
is taken off wherever motion borders on it (METHODS 3.3). Time is that of the samples, and a span does not depend on
their division into chunks. A steady turn about the vertical keeps accelerometer and gyroscope constant, so it counts as
still here; :func:`calib.gyro.steady_turn` distinguishes it from a bias.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.geometry import frame_along, sphere_of
from mavcal.calib.recording import Array, Channel, Recording, Sensor
from mavcal.calib.stats.quantisation import QuantisedMean, mean_of
from mavcal.calib.stats.still_limits import HELD, StillnessLimits
from mavcal.calib.stats.windows import Windows, finite_rows, row_of, window_statistics

_LEAST_SAMPLES = 4  # of a window


@dataclass(frozen=True, eq=False)
class Still:
    """A still span and the means of its windows (None: that sensor was not watched)."""

    start: float
    end: float
    accel: Array | None
    gyro: Array | None

    @property
    def duration(self) -> float:
        """Length in seconds."""
        return self.end - self.start


@dataclass(frozen=True, eq=False)
class PoseMean:
    """Mean reading of one accelerometer in one still span.

    `mean` (3,) is freed of quantisation bias and of the shrink by tremor, `covariance` (3, 3) is that of the mean.
    `temperature` in degC and `rate` (3,) in rad/s are None where nothing measured them. `estimate` gives the variance
    along any direction, since hand sway across gravity must not count as noise along it. None: `covariance` is used.
    """

    start: float
    end: float
    mean: Array
    covariance: Array
    n: int
    temperature: float | None = None
    rate: Array | None = None
    estimate: QuantisedMean | None = None


BLOCK = 1 << 13
"""Windows judged at once; more would need memory without being faster."""
PIECE = 1 << 14
"""Samples of a recording that are judged at once."""
FAR_S = 1e6
"""Time from the first sample, s, beyond which sums over a window use its own time as origin, to keep precision."""
YEAR_S = 365.25 * 86400.0
LONGEST_S = 100.0 * YEAR_S
"""Longest recording, s."""


class StillnessDetector:
    """Finds still spans in a stream of samples.

    Parameters
    ----------
    limits
        Limits of stillness.
    accel, gyro : bool
        Which sensors are fed; a window is judged when all of them have passed its end.

    Examples
    --------
    >>> from mavcal.calib.recording import Stage
    >>> t = np.arange(0.0, 3.0, 0.02)
    >>> level = Channel(Sensor.ACCEL, 0, t, np.tile([0.0, 0.0, -9.8], (150, 1)), "m/s2", Stage.RAW, "example")
    >>> detector = StillnessDetector(HELD, gyro=False)
    >>> detector.feed(level, None)
    ()
    >>> round(detector.current.duration, 2)
    2.88
    """

    def __init__(self, limits: StillnessLimits = HELD, *, accel: bool = True, gyro: bool = True) -> None:
        if not (accel or gyro):
            raise InvalidInputError("stillness is judged from an accelerometer or a gyroscope: feed at least one")
        self.limits = limits
        self._hop = limits.window / 4
        self._watched = tuple(s for s, on in ((Sensor.ACCEL, accel), (Sensor.GYRO, gyro)) if on)
        self._t = {sensor: np.zeros(0) for sensor in self._watched}
        self._x = {sensor: np.zeros((0, 3)) for sensor in self._watched}
        self._origin: float | None = None
        self._next = 0
        self._span: _OpenSpan | None = None
        self._after_motion = False
        self.reason = "no samples yet"
        """Why the last window was not still; empty while it is."""

    @property
    def current(self) -> Still | None:
        """The span that is still going on, as far as it has been judged; None while the vehicle moves."""
        if self._span is None:
            return None
        return self._span.still(self._hop, self.limits.window, guard_end=False)

    def feed(self, accel: Channel | None, gyro: Channel | None) -> tuple[Still, ...]:
        """Take the next samples; return the spans that ended with them.

        Raises
        ------
        InvalidInputError
            If time goes back: that is another boot, begin a new detector.
        """
        self._append(Sensor.ACCEL, accel)
        self._append(Sensor.GYRO, gyro)
        if any(len(t) == 0 for t in self._t.values()):
            return ()
        if self._origin is None:
            self._origin = max(float(t[0]) for t in self._t.values())
        last = min(float(t[-1]) for t in self._t.values())
        if last - self._origin > LONGEST_S:
            raise InvalidInputError(
                f"the samples span {(last - self._origin) / YEAR_S:.0f} years: give t in seconds; else it is damaged"
            )
        ready = int(np.floor((last - self._origin - self.limits.window) / self._hop)) + 1
        ended: list[Still] = []
        while self._next < ready:
            until = min(self._next + BLOCK, ready)
            ended += self._windows(self._next, until)
            self._next = self._occupied(until, ready)
        self._forget(self._origin + self._next * self._hop)
        return tuple(ended)

    def _windows(self, begin: int, end: int) -> tuple[Still, ...]:
        """Still windows among those numbered `begin` to `end`, judged from the samples in and next to them."""
        assert self._origin is not None
        starts = np.asarray(self._origin + np.arange(begin, end) * self._hop, dtype=np.float64)
        statistics = {}
        for sensor in self._watched:
            first, last = np.searchsorted(self._t[sensor], (starts[0], starts[-1] + self.limits.window))
            rows = slice(max(int(first) - 1, 0), int(last) + 1)
            t, x = self._t[sensor][rows], self._x[sensor][rows]
            near = self._origin if starts[0] - self._origin < FAR_S else float(starts[0])
            statistics[sensor] = window_statistics(t, x, near, starts, self.limits.window)
        return self._judge(starts, statistics)

    def _occupied(self, number: int, ready: int) -> int:
        """The next window with samples, so that not every window of a hole of years is judged.

        It begins with an empty one, which ends the span before the hole.
        """
        assert self._origin is not None
        start = self._origin + number * self._hop
        following = [t[i] for t in self._t.values() if (i := int(np.searchsorted(t, start))) < len(t)]
        if not following:
            return number
        ahead = int(np.floor((min(following) - self._origin - self.limits.window) / self._hop))
        return min(max(number, ahead), ready)

    def finish(self) -> tuple[Still, ...]:
        """End of the recording: close the span that is still open."""
        ended = self._close(guard_end=False)
        return (ended,) if ended is not None else ()

    def _append(self, sensor: Sensor, channel: Channel | None) -> None:
        if channel is None or sensor not in self._t or not len(channel):
            return
        good = finite_rows(channel.values)
        t, x = channel.t[good], channel.values[good]
        known = self._t[sensor]
        if len(t) and ((np.diff(t) < 0).any() or (len(known) and t[0] < known[-1])):
            raise InvalidInputError(f"time of {sensor} goes back at {t[0]:.3f} s: it is another boot, begin again")
        self._t[sensor] = np.concatenate([known, t])
        self._x[sensor] = np.concatenate([self._x[sensor], x])

    def _forget(self, before: float) -> None:
        for sensor in self._watched:
            first = int(np.searchsorted(self._t[sensor], before))
            first = min(first, len(self._t[sensor]) - 1)  # the last one says how far this sensor has come
            self._t[sensor], self._x[sensor] = self._t[sensor][first:], self._x[sensor][first:]

    def _judge(self, starts: Array, statistics: dict[Sensor, Windows]) -> tuple[Still, ...]:
        accel, gyro = statistics.get(Sensor.ACCEL), statistics.get(Sensor.GYRO)
        reasons = _reasons(self.limits, accel, gyro, len(starts))
        ended = []
        for k, start in enumerate(starts):
            reason = reasons[k]
            still = not reason
            if still:
                a, w = row_of(accel, k), row_of(gyro, k)
                reason = self._span.leaves(self.limits, a, w) if self._span is not None else ""
            if reason:
                closed = self._close(guard_end=True)
                if closed is not None:
                    ended.append(closed)
                self._after_motion = True
            if still:  # a window that left its span begins the next one
                if self._span is None:
                    self._span = _OpenSpan(float(start), guard=self._after_motion)
                self._span.add(float(start), a, w)
                self._after_motion = False
            self.reason = reason
        return tuple(ended)

    def _close(self, *, guard_end: bool) -> Still | None:
        span, self._span = self._span, None
        if span is None:
            return None
        still = span.still(self._hop, self.limits.window, guard_end=guard_end)
        return still if still is not None and still.duration >= self.limits.shortest else None


def find_still(recording: Recording, *, instance: int = 0, limits: StillnessLimits = HELD) -> tuple[Still, ...]:
    """Every still span of `recording`, judged by the accelerometer and the gyroscope of `instance`.

    One of the two is enough. Sensors in counts are judged by their quietest tenth of windows. A gyroscope is judged
    about its median reading, an accelerometer about the centre of its poses, which determines gravity.

    Raises
    ------
    InvalidInputError
        If the recording has neither sensor.
    """
    accel, gyro = (
        recording.channel(sensor, instance) if instance in recording.instances(sensor) else None
        for sensor in (Sensor.ACCEL, Sensor.GYRO)
    )
    if accel is None and gyro is None:
        raise InvalidInputError(f"the recording has neither accelerometer nor gyroscope {instance}")
    if gyro is not None and gyro.unit != "rad/s":
        limits, gyro = _limits_of_counts(limits, gyro)
    if accel is not None and accel.unit != "m/s2":
        accel = _centred_counts(limits, accel)
    detector = StillnessDetector(limits, accel=accel is not None, gyro=gyro is not None)
    found = [still for piece in _pieces(accel, gyro) for still in detector.feed(*piece)]
    return (*found, *detector.finish())


def _pieces(accel: Channel | None, gyro: Channel | None) -> Iterator[tuple[Channel | None, Channel | None]]:
    """Both channels in pieces of the same times, so that no copy of a whole recording is made."""
    given = [c for c in (accel, gyro) if c is not None and len(c)]
    if not given or not all(bool((c.t[1:] >= c.t[:-1]).all()) for c in given):
        yield accel, gyro  # the detector says what is wrong
        return
    edges = [-np.inf, *max(given, key=len).t[PIECE::PIECE].tolist(), np.inf]
    for begin, end in pairwise(edges):
        yield (
            None if accel is None else accel.between(begin, end),
            None if gyro is None else gyro.between(begin, end),
        )


def pose_means(
    accel: Channel, stills: tuple[Still, ...], *, gyro: Channel | None = None, temperature: Channel | None = None
) -> tuple[PoseMean, ...]:
    """Mean of `accel` in every span of `stills` that holds at least eight of its samples.

    With `gyro` (rad/s) the mean is corrected for tremor, which shortens it. If gravity swings by small angles ``theta``
    of covariance ``S``, then ``E a = (1 - (tr S - S)/2) a``. The rate bias is separate for each span, since it changes
    with temperature: the attitude drift is taken from the accelerometer.
    """
    poses = []
    for still in stills:
        rate = _rate(gyro, still)
        part = accel.between(still.start, still.end)
        part = part.take(finite_rows(part.values))
        if len(part) < 8:
            continue
        direction = part.values.mean(axis=0)
        estimate = mean_of(part, frame=frame_along(direction))
        swing = np.zeros((3, 3)) if gyro is None or rate is None else _swing(gyro, still, _turning(part))
        shrink = 0.5 * (np.trace(swing) * np.eye(3) - swing)
        poses.append(
            PoseMean(
                start=still.start,
                end=still.end,
                mean=estimate.mean + shrink @ estimate.mean,
                covariance=estimate.covariance,
                n=len(part),
                temperature=_mean_temperature(temperature, still),
                rate=rate,
                estimate=estimate,
            )
        )
    return tuple(poses)


class _OpenSpan:
    """Still windows in a row, with the running means that the next one must agree with."""

    def __init__(self, start: float, *, guard: bool) -> None:
        self.start = start
        self.last = start
        self.guard = guard
        self.count = 0
        self.accel: Array | None = None
        self.gyro: Array | None = None

    def add(self, start: float, accel: Windows | None, gyro: Windows | None) -> None:
        self.last = start
        self.count += 1
        if accel is not None:
            self.accel = _running(self.accel, accel.mean, self.count)
        if gyro is not None:
            self.gyro = _running(self.gyro, gyro.mean, self.count)

    def leaves(self, limits: StillnessLimits, accel: Windows | None, gyro: Windows | None) -> str:
        """Reason for which the next window does not belong to this span; empty if it does."""
        if accel is not None and self.accel is not None:
            off = float(np.linalg.norm(accel.mean - self.accel))
            noise = 4.0 * float(accel.scatter / np.sqrt(accel.n))
            if off > limits.accel_drift * float(np.linalg.norm(self.accel)) + noise:
                return "its attitude changes slowly"
        if gyro is not None and self.gyro is not None:
            off = float(np.linalg.norm(gyro.mean - self.gyro))
            if off > limits.gyro_drift + 4.0 * float(gyro.scatter / np.sqrt(gyro.n)):
                return "its rate of turn changes"
        return ""

    def still(self, hop: float, window: float, *, guard_end: bool) -> Still | None:
        start = self.start + (window / 2 if self.guard else 0.0)
        end = self.last + window - (window / 2 if guard_end else 0.0)
        return Still(start, end, self.accel, self.gyro) if end > start else None


def _running(mean: Array | None, value: Array, count: int) -> Array:
    return value.copy() if mean is None else mean + (value - mean) / count


def _reasons(limits: StillnessLimits, accel: Windows | None, gyro: Windows | None, count: int) -> list[str]:
    """Reason for each window that is not still by itself; empty where it is."""
    reasons = np.full(count, "", dtype=object)
    if gyro is not None:
        reasons[gyro.scatter > limits.gyro_scatter] = "the gyroscope shakes"
        reasons[np.linalg.norm(gyro.mean, axis=1) > limits.rate] = "it turns"
    if accel is not None:
        gravity = np.linalg.norm(accel.mean, axis=1)
        noise = 4.0 * accel.scatter * np.sqrt(12.0 / np.maximum(accel.n, 1))  # sd of the line's change
        reasons[np.linalg.norm(accel.change, axis=1) > limits.tilt * gravity + noise] = "it tilts"
        reasons[accel.scatter > limits.accel_scatter * gravity] = "the accelerometer shakes"
    for windows in (accel, gyro):
        if windows is not None:
            reasons[windows.n < _LEAST_SAMPLES] = "samples are missing"
    return [str(reason) for reason in reasons]


def _limits_of_counts(limits: StillnessLimits, gyro: Channel) -> tuple[StillnessLimits, Channel]:
    """Limits for a gyroscope of unknown scale: six times its noise floor, about its median reading."""
    floor, means = _quiet_windows(limits, gyro)
    if not len(means):
        return limits, gyro
    centred = dataclasses.replace(gyro, values=gyro.values - np.median(means, axis=0))
    scaled = dataclasses.replace(limits, gyro_scatter=6.0 * floor, rate=10.0 * floor, gyro_drift=6.0 * floor)
    return scaled, centred


def _centred_counts(limits: StillnessLimits, accel: Channel) -> Channel:
    """Accelerometer of unknown scale, relative to the centre of its quiet readings; unchanged if they are alike."""
    _, means = _quiet_windows(limits, accel)
    if len(means) < 8:
        return accel
    centre, radius = sphere_of(means)
    spread = np.linalg.eigvalsh(np.cov(means.T))
    return dataclasses.replace(accel, values=accel.values - centre) if spread[0] > 0.01 * radius**2 else accel


def _quiet_windows(limits: StillnessLimits, channel: Channel) -> tuple[float, Array]:
    """Scatter of the quietest tenth of windows, and the means (M, 3) of all windows hardly noisier."""
    starts = np.arange(channel.t[0], channel.t[-1] - limits.window, limits.window / 4)
    windows = window_statistics(channel.t, channel.values, channel.t[0], starts, limits.window)
    usable = windows.n >= _LEAST_SAMPLES
    if not usable.any():
        return 0.0, np.zeros((0, 3))
    floor = max(float(np.quantile(windows.scatter[usable], 0.1)), 1e-9)
    return floor, windows.mean[usable & (windows.scatter <= 3.0 * floor)]


def _rate(gyro: Channel | None, still: Still) -> Array | None:
    """Mean rate in a still span; None where no gyroscope in rad/s tells it."""
    if gyro is None or gyro.unit != "rad/s":
        return None
    values = gyro.between(still.start, still.end).values
    values = values[finite_rows(values)]
    return np.asarray(values.mean(axis=0), dtype=np.float64) if len(values) >= 8 else None


def _turning(accel: Channel) -> Array:
    """Rate (3,) of the turn of gravity in a span, by least squares, rad/s; zero for counts, whose centre is unknown.

    In the body ``df/dt = -w x f``. Hence ``w = -(f x df/dt)/|f|^2``, without the part about gravity, which does not
    shorten the mean of f.
    """
    if accel.unit != "m/s2":
        return np.zeros(3)
    t = accel.t - accel.t.mean()
    spread = float(t @ t)
    if spread <= 0.0:
        return np.zeros(3)
    mean = accel.values.mean(axis=0)
    slope = t @ (accel.values - mean) / spread
    return np.asarray(-np.cross(mean, slope) / max(float(mean @ mean), 1e-12))


def _swing(gyro: Channel, still: Still, turning: Array) -> Array:
    """Covariance (3, 3), rad^2, of the attitude in a still span: the integrated rate minus the slope `turning`."""
    part = gyro.between(still.start, still.end)
    part = part.take(finite_rows(part.values))
    steps = 0.5 * (part.values[1:] + part.values[:-1]) * np.diff(part.t)[:, None]
    angle = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    t = part.t - part.t.mean()
    angle += np.outer(t, turning - t @ angle / (t @ t))
    return np.cov(angle.T)


def _mean_temperature(temperature: Channel | None, still: Still) -> float | None:
    if temperature is None or not len(temperature):
        return None
    part = temperature.between(still.start, still.end).values[:, 0]
    if not len(part):  # about one new value a second: the last one holds
        before = int(np.searchsorted(temperature.t, still.end)) - 1
        part = temperature.values[max(before, 0), :1]
    part = part[np.isfinite(part)]
    return float(part.mean()) if len(part) else None
