"""Readings of the still vehicle, which are the evidence of the physical check."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.recording import Array, Channel, Recording, Sensor, Stage
from mavcal.calib.stats.quantisation import mean_of
from mavcal.calib.stats.stillness import Still, find_still, pose_means

LEAST_SAMPLES = 8
LONGEST_READING_S = 6.0
"""Longest reading, s; a longer rest is divided, so that a change of temperature shows."""
THERMOMETER_AGE_S = 0.5
"""Mean age of an IMU temperature on the wire, which firmwares update about once a second."""
MOST_MOVING_SAMPLES = 200
IN_MOTION = -1
"""Number of the rest for a reading in motion."""
AVERAGED_S = 0.1
"""Time over which a compass sample is a mean at most (ArduPilot's compass task, FLIGHT_CONTROLLERS 2.1)."""


@dataclass(frozen=True, eq=False)
class StillMean:
    """Mean (3,) of a stream with the covariance (3, 3) of that mean, as the vehicle corrected it."""

    t: float
    mean: Array
    covariance: Array
    temperature: float | None
    """degC; None: not streamed."""
    current: float | None = None
    """A; None: not streamed."""
    throttle: float | None = None
    rest: int = IN_MOTION
    """Which rest it belongs to: readings of one rest share the pose."""
    temperature_sd: float = 0.0
    """degC by which the temperature may be off: it is sent about once a second while it changes."""


@dataclass(frozen=True, eq=False)
class StreamEvidence:
    """Readings of every sensor in every still span of one recording."""

    readings: dict[Subject, tuple[StillMean, ...]]
    moving: dict[Subject, tuple[StillMean, ...]]
    """Single samples of a magnetometer that was turned (its field strength holds in any attitude)."""
    raw: frozenset[Subject]
    """Sensors that are streamed without the calibration in force: nothing written can show in them."""


def gather(recording: Recording) -> StreamEvidence:
    """Read every still span of `recording`."""
    stills = _stills(recording)
    pieces = _pieces(stills)
    readings: dict[Subject, tuple[StillMean, ...]] = {}
    moving: dict[Subject, tuple[StillMean, ...]] = {}
    raw = set()
    for sensor in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG):
        for instance in recording.instances(sensor):
            about = Subject(sensor, instance)
            channel = _channel(recording, about)
            if channel is None:
                continue
            if channel.stage == Stage.RAW:
                raw.add(about)
                continue
            readings[about] = _readings(recording, channel, pieces)
            if sensor == Sensor.MAG:
                moving[about] = _moving(recording, channel, stills)
    return StreamEvidence(readings, moving, frozenset(raw))


def _stills(recording: Recording) -> tuple[Still, ...]:
    for instance in recording.instances(Sensor.ACCEL) or recording.instances(Sensor.GYRO):
        return find_still(recording, instance=instance)
    return ()


def _channel(recording: Recording, about: Subject) -> Channel | None:
    try:
        channel = recording.channel(about.sensor, about.instance)
    except InvalidInputError:
        return None  # only debiased streams of it
    return channel.take(np.asarray(np.isfinite(channel.values).all(axis=1)))


def _pieces(stills: tuple[Still, ...]) -> dict[Still, int]:
    """Every rest cut into readings, with the number of the rest."""
    pieces = {}
    for rest, still in enumerate(stills):
        edges = np.linspace(still.start, still.end, max(1, round(still.duration / LONGEST_READING_S)) + 1)
        for start, end in pairwise(edges):
            pieces[replace(still, start=float(start), end=float(end))] = rest
    return pieces


def _readings(recording: Recording, channel: Channel, pieces: dict[Still, int]) -> tuple[StillMean, ...]:
    if channel.sensor == Sensor.ACCEL:
        gyros = recording.find(Sensor.GYRO, channel.instance)
        poses = pose_means(channel, tuple(pieces), gyro=gyros[0] if gyros else None)
        means = [(p.start, p.end, p.mean, p.covariance) for p in poses]
    else:
        means = []
        for piece in pieces:
            part = channel.between(piece.start, piece.end)
            if len(part) >= LEAST_SAMPLES:
                estimate = mean_of(part)
                means.append((piece.start, piece.end, estimate.mean, estimate.covariance))
    rests = {piece.start: rest for piece, rest in pieces.items()}
    return tuple(
        StillMean(
            0.5 * (start + end),
            mean,
            covariance,
            *_conditions(recording, channel.instance, start, end),
            rest=rests[start],
            temperature_sd=_staleness(recording, channel.instance, start, end),
        )
        for start, end, mean, covariance in means
    )


def _moving(recording: Recording, channel: Channel, stills: tuple[Still, ...]) -> tuple[StillMean, ...]:
    outside = np.ones(len(channel), dtype=bool)
    for still in stills:
        outside &= (channel.t < still.start) | (channel.t > still.end)
    part = channel.take(outside)
    if len(part) < LEAST_SAMPLES:
        return ()
    part = part.take(np.unique(np.linspace(0, len(part) - 1, min(len(part), MOST_MOVING_SAMPLES)).astype(np.intp)))
    covariance = channel.quantum**2 / 12.0 * np.eye(3)
    short = _shortened(recording, part.t)
    return tuple(
        StillMean(
            float(t),
            value,
            covariance + share**2 * np.outer(value, value),
            *_conditions(recording, channel.instance, float(t), float(t)),
        )
        for t, value, share in zip(part.t, part.values, short, strict=True)
    )


def _shortened(recording: Recording, t: Array) -> Array:
    """Share (n,) by which a vector that turns becomes shorter in a mean: ``(rate duration)^2 / 24`` at most."""
    for gyro in recording.find(Sensor.GYRO)[:1]:
        rate = np.interp(t, gyro.t, np.linalg.norm(gyro.values, axis=1))
        return np.asarray((rate * AVERAGED_S) ** 2 / 24.0)
    return np.zeros(len(t))


def _conditions(
    recording: Recording, instance: int, start: float, end: float
) -> tuple[float | None, float | None, float | None]:
    """Temperature, current and throttle in a span; the last value before it where none was sent in it."""
    return (
        _held(recording, Sensor.TEMPERATURE, instance, start, end),
        _held(recording, Sensor.CURRENT, 0, start, end),
        _held(recording, Sensor.THROTTLE, 0, start, end),
    )


def _staleness(recording: Recording, instance: int, start: float, end: float) -> float:
    """Change of temperature in the half second by which a reading of it is old on average."""
    found = recording.find(Sensor.TEMPERATURE, instance)
    part = found[0].between(start, end) if found else None
    if part is None or len(part) < 2 or end <= start:
        return 0.0
    return float(abs(part.values[-1, 0] - part.values[0, 0]) / (end - start) * THERMOMETER_AGE_S)


def _held(recording: Recording, sensor: Sensor, instance: int, start: float, end: float) -> float | None:
    found = recording.find(sensor, instance)
    if not found:
        return None
    t, values = found[0].t, found[0].values[:, 0]
    i, j = np.searchsorted(t, (start, end))
    part = values[i:j] if j > i else values[max(i - 1, 0) : max(i - 1, 0) + 1]
    part = part[np.isfinite(part)]
    return float(part.mean()) if len(part) else None
