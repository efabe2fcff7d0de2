"""The gyroscope hung on a thread: whole turns each way, counted; the rate need not be steady.

``I+ = 2 pi n/k + b T+`` and ``I- = -2 pi n/k + b T-`` are the integrals of its reading (METHODS S3). Hence ``b = (I+ +
I-)/(T+ + T-)`` and ``k = 2 pi n/(I+ - b T+)``. A compass counts the turns: it reads the same after a whole turn,
however iron distorts its circle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavcal.calib.errors import InvalidInputError, UndeterminedError
from mavcal.calib.fit import FitBuilder, FitResult
from mavcal.calib.geometry import sphere_of
from mavcal.calib.gyro.turns import Turn, fit_turns, usable
from mavcal.calib.recording import Array, Channel, Segment
from mavcal.calib.stats.correlated import long_run_variance
from mavcal.calib.stats.windows import occupied_starts, window_statistics

METHOD = "gyro-thread"
MOVEMENT = "let it turn on the thread by whole turns one way, and by as many the other way"
_WINDOW = 0.5  # s
_TURNING = 0.05  # of the fastest rate: slower is rest
_SHORTEST = 2.0  # s
_HOLE = 5.0  # usual steps of a sensor: in a longer one turns are lost
_DISAGREE = 0.25  # turns between what was stated and what a compass or the gyroscope counts
_REST_PHASE = 0.03  # turns next to a rest that are not used: a running maximum of noise there is no phase
_PHASES = 400  # starting points from which whole turns are averaged


def thread_scale(turns: float, plus: float, plus_time: float, minus: float, minus_time: float) -> tuple[float, float]:
    """Offset b and scale k (true = k (read - b)) from the integrals of `turns` turns one way and as many back.

    >>> b, k = thread_scale(10, 64.3141357875468, 20.0, -63.8641357875468, 25.0)
    >>> round(b, 12), round(k, 12)
    (0.01, 0.98)

    Parameters
    ----------
    turns
        Whole turns each way.
    plus, minus
        Integral of the reading over the turns one way and over those the other way.
    plus_time, minus_time
        Duration of these turns, s.

    Raises
    ------
    UndeterminedError
        If the integrals do not differ: it did not turn both ways.
    """
    if not plus_time + minus_time > 0.0:
        raise InvalidInputError(f"the turns must take time, not {plus_time} and {minus_time} s")
    offset = (plus + minus) / (plus_time + minus_time)
    turned = plus - offset * plus_time
    if turned == 0.0 or not np.isfinite(turned):
        raise UndeterminedError("the gyroscope reads the same for both ways: it did not turn", remedy=MOVEMENT)
    return offset, 2.0 * np.pi * turns / turned


def fit_thread(
    gyro: Channel,
    *,
    turns: float | None = None,
    mag: Channel | None = None,
    segments: Sequence[Segment] = (),
    angle_sd: float = 0.0,
    temperature: float | None = None,
    relative: bool = False,
) -> FitResult:
    """Scale, cross axes and offset about the axis of a thread from whole turns each way.

    Parameters
    ----------
    gyro
        Samples, rad/s or counts.
    turns
        Turns each way, counted by eye from rest to rest; None: `mag` counts whole ones.
    mag
        A compass that turns with the gyroscope; it also shows where a turn is complete.
    segments
        The spans of the turns; if none are given, they are found, from rest to rest.
    angle_sd
        Error of the stated turns, rad, one sd.
    temperature, relative
        Passed on to the result.

    Raises
    ------
    InvalidInputError
        If neither turns nor a compass are given.
    """
    if turns is None and mag is None:
        raise InvalidInputError("the turns must be counted: give --turns, or a recording with a compass")
    if turns is not None and not (np.isfinite(turns) and turns > 0.0):
        raise InvalidInputError(f"the number of turns must be positive, not {turns}")
    given = gyro
    gyro = usable(gyro)
    spans = np.array([(s.start, s.end) for s in segments]) if segments else turning_spans(gyro)
    labels = [s.label for s in segments] or [f"turn {k + 1}" for k in range(len(spans))]

    made = FitBuilder.of(METHOD, given, movement=MOVEMENT)
    if len(spans) < 2:
        return made.refused(f"{len(spans)} spans of turning were found: {MOVEMENT}")
    if mag is not None:
        mag = usable(mag)
    integral = _Integral.of(gyro)
    axis = int(np.argmax(np.abs([integral.between(*span) for span in spans]).sum(axis=0)))
    found = []
    for label, span in zip(labels, spans, strict=True):
        inside = len(gyro.between(*span))
        if inside < 8:
            return made.refused(f"{inside} samples of the gyroscope in {label}: the recording does not cover the turns")
        if np.diff(gyro.between(*span).t).max() > _HOLE * float(np.median(np.diff(gyro.t))):
            return made.refused(f"the gyroscope has a hole in {label}: the turns in it are lost")
        counted = _counted(integral, axis, span, mag) if mag is not None else None
        if counted is None and turns is None:
            return made.refused(
                f"the compass does not go round in {label}, {span[0]:.1f} to {span[1]:.1f} s: state --turns"
            )
        if counted is not None and turns is not None and abs(counted.seen - turns) > _DISAGREE:
            return made.refused(f"{turns:g} turns were stated, but the compass sees {counted.seen:.2f} in {label}")
        if counted is None or turns is not None:
            counted = _stated(integral, axis, span, float(turns or 0.0))
        found.append(_turn(label, axis, counted, gyro, span, angle_sd))
    exact = () if angle_sd or turns is None else ("the stated turns were taken as exact: state their --angle-sd",)
    return fit_turns(
        METHOD,
        given,
        found,
        movement=MOVEMENT,
        native=_native(axis, found),
        warnings=exact,
        temperature=temperature,
        relative=relative,
    )


def turning_spans(gyro: Channel) -> Array:
    """Spans (S, 2) of turns in one direction about the axis of largest rate, from rest to rest."""
    if len(gyro) < 16 or not gyro.t[-1] - gyro.t[0] > _SHORTEST:
        return np.zeros((0, 2))
    starts = occupied_starts(gyro.t, gyro.t[0], gyro.t[-1], _WINDOW)
    windows = window_statistics(gyro.t, gyro.values, gyro.t[0], starts, _WINDOW)
    seen = windows.n > 0
    if not seen.any():
        return np.zeros((0, 2))
    axis = int(np.argmax(np.abs(windows.mean[seen]).mean(axis=0)))
    quiet = windows.mean[seen & (windows.scatter <= np.quantile(windows.scatter[seen], 0.2)), axis]
    slow = quiet[np.abs(quiet) <= np.quantile(np.abs(quiet), 0.5)]
    rate = windows.mean[:, axis] - np.median(slow)
    way = np.where(seen & (np.abs(rate) > _TURNING * np.abs(rate).max()), np.sign(rate), 0.0)
    quietest = float(np.quantile(windows.scatter[seen], 0.2))
    noise = quietest / np.sqrt(np.maximum(windows.n, 1)) + 0.5 * gyro.quantum
    resting = seen & (np.abs(rate) <= 4.0 * noise)
    runs = np.split(np.arange(len(way)), np.flatnonzero(np.diff(way)) + 1)
    turns = [run for run in runs if way[run[0]] and starts[run[-1]] - starts[run[0]] >= _SHORTEST]
    spans = []
    for run in turns:  # out to where it rests: the slow beginning and end belong to the turns
        before, after = np.flatnonzero(resting[: run[0]]), run[-1] + np.flatnonzero(resting[run[-1] :])
        first = starts[before[-1]] + _WINDOW / 2 if len(before) else gyro.t[0]
        last = starts[after[0]] + _WINDOW / 2 if len(after) else gyro.t[-1]
        spans.append((first, last))
    return np.array(spans).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class _Counted:
    """Whole turns (signed), the integral (3,) of the reading over them, how long they took, and the error of counting.

    `seen` are the turns that the compass saw over the whole span, whole or not, unsigned.
    """

    turns: float
    integral: Array
    duration: float
    variance: Array
    seen: float


@dataclass(frozen=True, eq=False)
class _Integral:
    """The running integral of a channel; each sample holds for the time nearest to it."""

    edges: Array
    sums: Array

    @classmethod
    def of(cls, channel: Channel) -> _Integral:
        inner = 0.5 * (channel.t[1:] + channel.t[:-1])
        edges = np.concatenate([channel.t[:1], inner, channel.t[-1:]])
        steps = channel.values * np.diff(edges)[:, None]
        return cls(edges, np.vstack([np.zeros(steps.shape[1]), np.cumsum(steps, axis=0)]))

    def at(self, t: Array) -> Array:
        """Integral (N, 3) from the beginning to `t` (N,)."""
        return np.column_stack([np.interp(t, self.edges, column) for column in self.sums.T])

    def between(self, start: float, end: float) -> Array:
        """Integral (3,) over a span."""
        both = self.at(np.array([start, end]))
        return np.asarray(both[1] - both[0], dtype=np.float64)


def _stated(integral: _Integral, axis: int, span: Array, turns: float) -> _Counted:
    total = integral.between(*span)
    sign = float(np.sign(total[axis]))
    return _Counted(sign * turns, total, float(span[1] - span[0]), np.zeros(3), turns)


def _counted(integral: _Integral, axis: int, span: Array, mag: Channel) -> _Counted | None:
    """Whole turns between instants at which the compass reads the same; None if there is no whole turn."""
    part = mag.between(*span)
    across = [k for k in range(3) if k != axis]
    if len(part) < 16 or np.diff(part.t).max() > _HOLE * float(np.median(np.diff(mag.t))):
        return None
    plane = part.values[:, across]
    centre, radius = sphere_of(np.column_stack([plane, np.zeros(len(plane))]))
    arms = plane - centre[:2]
    if radius <= 0.0 or np.linalg.norm(arms, axis=1).min() < 0.2 * radius:
        return None
    phase = np.unwrap(np.arctan2(arms[:, 1], arms[:, 0])) / (2.0 * np.pi)
    direction = float(np.sign(phase[-1] - phase[0]))
    climbing = np.maximum.accumulate(direction * (phase - phase[0]))
    seen = float(climbing[-1])
    whole = int(np.floor(seen - 2.0 * _REST_PHASE))
    if whole < 1:
        return None
    moving = np.flatnonzero(np.diff(climbing, prepend=-1.0) > 1e-9)  # a turn's instants, each phase once
    t, phases = part.t[moving], climbing[moving]
    starts = np.flatnonzero((phases >= _REST_PHASE) & (phases + whole <= phases[-1] - _REST_PHASE))
    starts = starts[:: max(1, len(starts) // _PHASES)]
    ends = np.interp(phases[starts] + whole, phases, t)
    integrals = integral.at(ends) - integral.at(t[starts])
    total = integrals.mean(axis=0)
    spread = np.array([long_run_variance(column) for column in integrals.T]) / len(starts) if len(starts) > 1 else None
    step = float(np.median(np.diff(part.t)))
    alone = (np.abs(total) / float((ends - t[starts]).mean()) * 0.1 * step) ** 2  # one crossing, known to a tenth
    sign = float(np.sign(total[axis]))
    return _Counted(sign * whole, total, float((ends - t[starts]).mean()), alone if spread is None else spread, seen)


def _turn(label: str, axis: int, counted: _Counted, gyro: Channel, span: Array, angle_sd: float) -> Turn:
    """The turns as a mean rate, with the noise of the gyroscope and of the counting."""
    part = gyro.between(*span)
    step = float(np.median(np.diff(part.t)))
    steps = np.diff(part.values, n=2, axis=0)  # of the noise, and now and then of a start or a stop
    noise = (1.4826 * np.median(np.abs(steps), axis=0)) ** 2 / 6.0 + part.quantum**2 / 12.0
    variance = (noise * step * counted.duration + counted.variance) / counted.duration**2
    return Turn(
        label=label,
        rate=2.0 * np.pi * counted.turns / counted.duration * np.eye(3)[axis],
        mean=counted.integral / counted.duration,
        covariance=np.diag(variance),
        duration=counted.duration,
        n=len(part),
        rate_sd=angle_sd / counted.duration,
    )


def _native(axis: int, found: Sequence[Turn]) -> dict[str, object]:
    """Offset and scale from the first turn each way, as published."""
    plus = next((t for t in found if t.rate[axis] > 0.0), None)
    minus = next((t for t in found if t.rate[axis] < 0.0), None)
    if plus is None or minus is None:
        return {}
    counts = [abs(float(t.rate[axis])) * t.duration / (2.0 * np.pi) for t in (plus, minus)]
    integrals = [float(t.mean[axis]) * t.duration for t in (plus, minus)]
    pair: dict[str, object] = {"axis": "xyz"[axis], "turns_plus": counts[0], "turns_minus": counts[1]}
    if np.isclose(counts[0], counts[1]):
        b, k = thread_scale(counts[0], integrals[0], plus.duration, integrals[1], minus.duration)
        pair |= {"b": b, "k": k}
    return pair
