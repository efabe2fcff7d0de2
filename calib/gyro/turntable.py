"""The gyroscope on a turntable: steady turns of known rate about one axis or three (METHODS S3)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import AXES, FitResult
from mavcal.calib.gyro.turns import EARTH_RATE, Turn, fit_turns, usable
from mavcal.calib.recording import Array, Channel, Segment
from mavcal.calib.stats.quantisation import mean_of
from mavcal.calib.stats.windows import finite_rows, occupied_starts, window_statistics

METHOD = "gyro-turntable"
MOVEMENT = "turn it on the table about each axis at a steady rate, five seconds or more, both ways"
_WINDOW = 0.5  # s
_LEAST = 8  # samples of a turn
_TURNING = 0.05  # of the fastest rate: slower is rest
_STEADY = 0.03  # of its own rate: a turn that changes by more between windows is not steady
_SHORTEST = 2.0  # s, of a turn that was found and not labelled
_AXIS = re.compile(r"(?:^|[^a-z])([xyz])(?:[^a-z]|$)|^([xyz])(?:pos|neg|plus|minus|p|n|m)$", re.IGNORECASE)


def fit_turntable(
    gyro: Channel,
    rate_true: float | Mapping[str, float],
    *,
    segments: Sequence[Segment] = (),
    accel: Channel | None = None,
    rate_sd: float = 0.0,
    latitude: float | None = None,
    temperature: float | None = None,
    relative: bool = False,
) -> FitResult:
    """Scale, cross axes and offset from turns at a known rate: ``(m+ - m-)/(2 W)`` by columns, ``(m+ + m-)/2``.

    Parameters
    ----------
    gyro
        Samples, rad/s or counts.
    rate_true
        Rate of every turn, rad/s; the samples tell its direction. Or the signed rate for every label of `segments`,
        zero for a rest.
    segments
        The turns. A lone x, y or z in a label names the axis; otherwise it is the axis of the largest reading. If none
        are given, steady turns are found.
    accel
        Accelerometer, which tells the vertical for the Earth's rate; None: the Earth's rate stays in the offset.
    rate_sd
        Uncertainty of the true rate, rad/s, one sd.
    latitude
        Degrees; None: the Earth's rate stays in the offset.
    temperature, relative
        Passed on to the result.

    Raises
    ------
    InvalidInputError
        If a label of `rate_true` is not there, or a rate is not finite.
    """
    _check(rate_true, segments, rate_sd, latitude)
    given = gyro
    gyro = usable(gyro)
    spans = [(s.label, s.start, s.end) for s in segments] or [("", *span) for span in steady_spans(gyro)]
    turns = []
    for label, start, end in spans:
        part = _steady_part(gyro.between(start, end), trim=bool(segments))
        rate = _true_rate(label, part, rate_true)
        if rate is None or len(part) < _LEAST:
            continue
        earth = _earth_rate(accel, latitude, part)
        estimate = mean_of(part)
        doubt = rate_sd if rate.any() else 0.0
        duration = float(part.t[-1] - part.t[0])
        turns.append(Turn(label, rate + earth, estimate.mean, estimate.covariance, duration, len(part), doubt))
    warnings = () if rate_sd else ("the stated rate was taken as exact: state its --rate-sd",)
    return fit_turns(
        METHOD,
        given,
        turns,
        movement=MOVEMENT,
        earth_known=latitude is not None and accel is not None,
        warnings=warnings,
        temperature=temperature,
        relative=relative,
    )


def steady_spans(gyro: Channel) -> Array:
    """Spans (S, 2) of two seconds or more at a constant rate, with a quarter second cut off at each end."""
    if len(gyro) < _LEAST or not gyro.t[-1] - gyro.t[0] > _SHORTEST:
        return np.zeros((0, 2))
    starts = occupied_starts(gyro.t, gyro.t[0], gyro.t[-1], _WINDOW)
    windows = window_statistics(gyro.t, gyro.values, gyro.t[0], starts, _WINDOW)
    full = windows.n >= min(_LEAST, 4)
    if not full.any():
        return np.zeros((0, 2))
    rest = _rest_of(windows.mean[full], windows.scatter[full])
    speed = np.linalg.norm(windows.mean - rest, axis=1)
    tolerance = _STEADY * speed + 4.0 * windows.scatter / np.sqrt(np.maximum(windows.n, 1))
    turning = full & (speed > _TURNING * speed[full].max()) & (speed > 10.0 * tolerance)
    steady = turning & (np.linalg.norm(windows.change, axis=1) <= tolerance * np.sqrt(12.0))
    changed = np.linalg.norm(np.diff(windows.mean, axis=0), axis=1) > tolerance[1:] + tolerance[:-1]
    apart = np.diff(starts) > 0.3 * _WINDOW  # a hole in the recording
    runs = np.split(np.arange(len(starts)), np.flatnonzero(np.diff(steady) | changed | apart) + 1)
    spans = [(starts[r[0]] + _WINDOW / 2, starts[r[-1]] + _WINDOW / 2) for r in runs if steady[r[0]]]
    return np.array([span for span in spans if span[1] - span[0] >= _SHORTEST]).reshape(-1, 2)


def _rest_of(means: Array, scatter: Array) -> Array:
    """Reading of the gyroscope at rest: the median of the quieter half of the windows."""
    quiet = means[scatter <= np.quantile(scatter, 0.5)]
    return np.asarray(np.median(quiet, axis=0), dtype=np.float64)


def _steady_part(part: Channel, *, trim: bool) -> Channel:
    """The samples of a labelled turn without the run-up and the stop at its ends."""
    if not trim or len(part) < 4 * _LEAST:
        return part
    middle = np.median(part.values, axis=0)
    deviation = np.abs(part.values - middle)
    noise = 1.4826 * np.median(deviation, axis=0)
    allowed = 6.0 * noise + _STEADY * float(np.linalg.norm(middle)) + 2.0 * part.quantum
    off = np.flatnonzero((deviation > allowed).any(axis=1))
    third = len(part) // 3
    first = int(off[off < third].max(initial=-1)) + 1
    last = int(off[off >= len(part) - third].min(initial=len(part)))
    return part.take(slice(first, last))


def _true_rate(label: str, part: Channel, rate_true: float | Mapping[str, float]) -> Array | None:
    """True rate (3,) of a turn about the axis its label names; None if none is stated."""
    mean = part.values.mean(axis=0) if len(part) else np.zeros(3)
    named = _AXIS.search(label)
    axis = AXES.index((named[1] or named[2]).lower()) if named else int(np.argmax(np.abs(mean)))
    if isinstance(rate_true, Mapping):
        if label not in rate_true:
            return None
        value = rate_true[label]
    else:
        value = float(np.copysign(rate_true, mean[axis]))
    return np.asarray(value * np.eye(3)[axis], dtype=np.float64)


def _earth_rate(accel: Channel | None, latitude: float | None, part: Channel) -> Array:
    """The Earth's rate (3,) about the vertical in the sensor's axes; its horizontal part averages out over a turn."""
    if accel is None or latitude is None or not len(part):
        return np.zeros(3)
    values = accel.between(float(part.t[0]), float(part.t[-1])).values
    values = values[finite_rows(values)]
    if not len(values):
        return np.zeros(3)
    up = values.mean(axis=0) / np.linalg.norm(values, axis=1).mean()
    return np.asarray(EARTH_RATE * np.sin(np.radians(latitude)) * up, dtype=np.float64)


def _check(
    rate_true: float | Mapping[str, float], segments: Sequence[Segment], rate_sd: float, latitude: float | None
) -> None:
    rates = list(rate_true.values()) if isinstance(rate_true, Mapping) else [rate_true]
    if not rates or not np.isfinite(rates).all() or not np.any(rates):
        raise InvalidInputError(f"the true rate must be a finite number and not zero, not {rate_true}")
    if isinstance(rate_true, Mapping):
        missing = sorted(set(rate_true) - {s.label for s in segments})
        if missing:
            labels = ", ".join(sorted({s.label for s in segments})) or "none"
            raise InvalidInputError(f"there is no segment {', '.join(missing)}; the recording has {labels}")
    if not (np.isfinite(rate_sd) and rate_sd >= 0.0):
        raise InvalidInputError(f"the uncertainty of the rate must be zero or more, not {rate_sd}")
    if latitude is not None and not -90.0 <= latitude <= 90.0:
        raise InvalidInputError(f"a latitude lies between -90 and 90 degrees, not at {latitude}")
