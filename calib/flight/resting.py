"""Checks the inertial sensors at rest: gravity, bias and its drift, level, and whether units agree.

The calibration in force is applied: a log is judged as the autopilot used it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.earth import local_gravity
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.compose.trim import AHRS_TRIM
from mavcal.calib.firmware.rotations import euler_matrix
from mavcal.calib.flight import limits
from mavcal.calib.flight.craft import craft_of
from mavcal.calib.flight.item import FlightLimit, JudgedItem, judged, not_testable
from mavcal.calib.flight.rest import SHORTEST, Rest, how_to_rest, why_no_rest
from mavcal.calib.recording import Array, Recording, Sensor
from mavcal.calib.stats.quantisation import mean_of
from mavcal.calib.stats.windows import finite_rows

_LEAST = 32  # samples of a mean
_CLEARLY = 3.0  # times the error of the other one
_SETTLED = 5.0  # s: an attitude estimator is levelled after that


@dataclass(frozen=True, eq=False)
class RestMean:
    """What one sensor read in one rest: mean and sd (3,), and its temperature (None: not known)."""

    rest: Rest
    mean: Array
    sd: Array
    temperature: float | None


def rest_means(recording: Recording, sensor: Sensor, instance: int, rests: Sequence[Rest]) -> tuple[RestMean, ...]:
    """Means over the rests that are long enough."""
    if not any(c.unit in ("m/s2", "rad/s") for c in recording.find(sensor, instance)):
        return ()
    try:
        channel = recording.channel(sensor, instance)
    except InvalidInputError:  # an estimator's bias is subtracted: nothing of the sensor is left in it
        return ()
    found = []
    for rest in rests:
        part = channel.between(rest.start, rest.end)
        part = part.take(finite_rows(part.values))
        if len(part) < _LEAST or rest.duration < SHORTEST:
            continue
        estimate = mean_of(part)
        sd = np.sqrt(np.diag(estimate.covariance))
        found.append(RestMean(rest, estimate.mean, sd, _temperature(recording, instance, rest)))
    return tuple(found)


def resting_items(recording: Recording, rests: Sequence[Rest]) -> list[JudgedItem]:
    """Every item of the rests, for every instance."""
    why = why_no_rest(recording)
    accels = {i: rest_means(recording, Sensor.ACCEL, i, rests) for i in recording.instances(Sensor.ACCEL)}
    gyros = {i: rest_means(recording, Sensor.GYRO, i, rests) for i in recording.instances(Sensor.GYRO)}
    gravity, known = gravity_of_place(recording)
    items = [_gravity(i, means, gravity, known, why) for i, means in accels.items()]
    items += [_level(recording, i, means, why) for i, means in accels.items()]
    items += [
        _difference("accel_consistency", "accel", pair, limits.APART, accels, why) for pair in combinations(accels, 2)
    ]
    for instance, means in gyros.items():
        items += [_bias(instance, means, why), _bias_change(recording, instance, means, why)]
    items += [
        _difference("gyro_consistency", "gyro", pair, limits.RATES_APART, gyros, why) for pair in combinations(gyros, 2)
    ]
    return items


def gravity_of_place(recording: Recording) -> tuple[float, bool]:
    """Normal gravity at the vehicle's position, m/s2, and whether the log has the position."""
    found = recording.find(Sensor.POSITION)
    if found:
        values = found[0].values[finite_rows(found[0].values)]
        values = values[np.abs(values[:, :2]).max(axis=1) > 1e-6]  # zero is a receiver without fix
        if len(values):
            latitude, _, altitude = np.median(values, axis=0)
            if abs(latitude) <= 90.0 and -1000.0 < altitude < 50e3:
                return local_gravity(float(latitude), float(altitude)), True
    return STANDARD_GRAVITY, False


def _none(name: str, subject: str, why: str) -> JudgedItem:
    return not_testable(name, subject, why)


def _gravity(instance: int, means: Sequence[RestMean], gravity: float, known: bool, why: str) -> JudgedItem:
    """Length of the force at rest; a calibrated sensor reads the firmware's 9.80665 wherever it was calibrated."""
    subject = f"accel {instance + 1}"
    if not means:
        return _none("gravity_at_rest", subject, why)
    lengths = np.array([np.linalg.norm(m.mean) for m in means])
    low, high = sorted((gravity, STANDARD_GRAVITY))
    off = np.maximum(np.maximum(lengths - high, low - lengths), 0.0)
    worst = int(np.argmax(off))
    place = f"{gravity:.4f} of the place" if known else "9.80665 (the place is not known)"
    text = f"reads {lengths[worst]:.4f} m/s2 at rest ({means[worst].rest.phase}), gravity is {place}"
    sd = float(np.linalg.norm(means[worst].sd))
    return judged(
        "gravity_at_rest",
        subject,
        float(off[worst]),
        limits.GRAVITY,
        text,
        sd=sd,
        lengths=lengths.tolist(),
        gravity=gravity,
    )


def _level(recording: Recording, instance: int, means: Sequence[RestMean], why: str) -> JudgedItem:
    """Angle between the vertical of the accelerometer, trimmed, and that of the autopilot's attitude."""
    subject = f"accel {instance + 1}"
    if not means:
        return _none("level", subject, why)
    attitudes = recording.find(Sensor.ATTITUDE)
    state = recording.parameters.at(means[0].rest.end)
    trim = [float(state.get(name, 0.0)) for name in AHRS_TRIM]
    roll, pitch = np.degrees(trim).tolist()
    turn = euler_matrix(roll, pitch, 0.0)  # the vehicle's frame from the board's
    angles, tilts = [], []
    for m in means:
        size = float(np.linalg.norm(m.mean))
        if size < 0.5 * STANDARD_GRAVITY:
            return not_testable("level", subject, f"it reads {size:.2f} m/s2 at rest: that is not gravity")
        up = turn @ m.mean / size
        tilts.append(np.degrees([np.arctan2(-up[1], -up[2]), np.arctan2(up[0], np.hypot(up[1], up[2]))]).tolist())
        part = attitudes[0].between(m.rest.start, m.rest.end).values if attitudes else np.zeros((0, 4))
        part = part[finite_rows(part)]
        if len(part) > 8 and m.rest.duration >= _SETTLED:
            angles.append(float(np.degrees(np.arccos(np.clip(_vertical(part[len(part) // 2 :]) @ up, -1.0, 1.0)))))
    numbers: dict[str, Any] = {"roll_pitch_deg": tilts, "trim_deg": [roll, pitch]}
    if not angles:
        return not_testable("level", subject, "the log has no attitude during a rest", **numbers)
    text = f"its vertical and the autopilot's are {max(angles):.2f} deg apart at rest"
    return judged("level", subject, max(angles), limits.LEVEL, text, angles_deg=angles, **numbers)


def _vertical(q: Array) -> Array:
    """Up in the body frame (3,), the mean over attitudes (N, 4)."""
    w, x, y, z = q.T
    up = -np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z], axis=1)
    mean = up.mean(axis=0)
    return np.asarray(mean / max(float(np.linalg.norm(mean)), 1e-12), dtype=np.float64)


def _bias(instance: int, means: Sequence[RestMean], why: str) -> JudgedItem:
    subject = f"gyro {instance + 1}"
    if not means:
        return _none("gyro_bias_at_rest", subject, why)
    worst = max(means, key=lambda m: float(np.linalg.norm(m.mean)))
    rate = float(np.linalg.norm(worst.mean))
    text = f"reads {np.degrees(rate):.3f} deg/s at rest ({worst.rest.phase}): {_vector(np.degrees(worst.mean))} deg/s"
    sd = float(np.linalg.norm(worst.sd))
    return judged(
        "gyro_bias_at_rest",
        subject,
        rate,
        limits.RATE,
        text,
        sd=sd,
        bias=worst.mean.tolist(),
        bias_sd=worst.sd.tolist(),
    )


def _bias_change(recording: Recording, instance: int, means: Sequence[RestMean], why: str) -> JudgedItem:
    """Change of the bias between the first and the last rest."""
    subject = f"gyro {instance + 1}"
    if not means:
        return _none("gyro_bias_drift", subject, why)
    if len(means) < 2:
        return not_testable(
            "gyro_bias_drift",
            subject,
            f"one rest only: another one after the {craft_of(recording.identity).trip} tells. {how_to_rest(recording)}",
        )
    first, last = means[0], means[-1]
    change = last.mean - first.mean
    minutes = (last.rest.start - first.rest.end) / 60.0
    text = f"its bias moved by {np.degrees(np.linalg.norm(change)):.3f} deg/s in {minutes:.1f} min"
    warmer = None
    if first.temperature is not None and last.temperature is not None:
        warmer = last.temperature - first.temperature
        text += f" and {warmer:+.1f} degC"
    sd = float(np.sqrt((first.sd**2 + last.sd**2).sum()))
    return judged(
        "gyro_bias_drift",
        subject,
        float(np.linalg.norm(change)),
        limits.WANDER,
        text,
        sd=sd,
        change=change.tolist(),
        degrees_c=warmer,
    )


def _difference(
    name: str, sensor: str, pair: tuple[int, int], limit: FlightLimit, means: Mapping[int, Sequence[RestMean]], why: str
) -> JudgedItem:
    """Largest difference of two instances in the same rest; the vertical one is halved, as in ArduPilot's check."""
    a, b = pair
    subject = f"{sensor} {a + 1}, {b + 1}"
    others = {m.rest.start: m for m in means[b]}
    common = [(m, others[m.rest.start]) for m in means[a] if m.rest.start in others]
    if not common:
        return _none(name, subject, why)
    weight = np.array([1.0, 1.0, 0.5]) if sensor == "accel" else np.ones(3)
    first, second = max(common, key=lambda two: float(np.linalg.norm(weight * (two[0].mean - two[1].mean))))
    difference, sd = first.mean - second.mean, np.hypot(first.sd, second.sd)
    factor, unit = (float(np.degrees(1.0)), "deg/s") if limit.unit == "rad/s" else (1.0, limit.unit)
    halved = ", z counted half" if sensor == "accel" else ""
    text = f"differ by {_vector(factor * difference)} {unit} at rest ({first.rest.phase}{halved})"
    errors = [_own_error(sensor, m.mean) for m in (first, second)]
    if max(errors) > _CLEARLY * min(errors) and max(errors) > 0.25 * limit.warn:
        text += (
            f"; judged by its own reading, {sensor} {1 + (a if errors[0] > errors[1] else b)} is the one that is off"
        )
    return judged(
        name,
        subject,
        float(np.linalg.norm(weight * difference)),
        limit,
        text,
        sd=float(np.linalg.norm(sd)),
        difference=difference.tolist(),
        difference_sd=sd.tolist(),
        every=[(m.mean - other.mean).tolist() for m, other in common],
    )


def _own_error(sensor: str, mean: Array) -> float:
    """Error of one sensor by itself at rest: its rate, or the difference of its length from the firmware's gravity."""
    size = float(np.linalg.norm(mean))
    return abs(size - STANDARD_GRAVITY) if sensor == "accel" else size


def _vector(values: Array) -> str:
    return "(" + ", ".join(f"{v:+.4f}" for v in values) + ")"


def _temperature(recording: Recording, instance: int, rest: Rest) -> float | None:
    found = recording.find(Sensor.TEMPERATURE, instance)
    values = found[0].between(rest.start, rest.end).values if found else np.zeros((0, 1))
    values = values[np.isfinite(values)]
    return float(values.mean()) if len(values) else None
