"""Whether other sensors confirm the logged attitude, so that it may serve as a reference.

An attitude is estimated from the very sensors that it would judge. A faulty gyroscope makes it tumble, and a dead
compass pulls its heading. Its tilt is confirmed where it turns the mean force of an accelerometer to point up. Its
heading is confirmed where it turns the field of a live compass to a constant direction. Where no recorded data could
contradict it, it is accepted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.flight.flying import usable
from mavcal.calib.health import motion
from mavcal.calib.health.channels import judged_channel
from mavcal.calib.recording import Array, Channel, Recording, Sensor

_TILT_DEG: Final = 25.0
"""Angle, deg, between up and the mean force over ten seconds, beyond the effect of offsets, climbs and turns."""
_TILTED_DEG: Final = 15.0
"""The same where the force has the length of gravity. A horizontal offset that tilts the force as far makes it 3.5 %
longer, and so does a banked turn."""
_AS_LONG: Final = 0.025 * STANDARD_GRAVITY
"""Largest difference of such a force from gravity, m/s2."""
_SECOND: Final = 1.0
"""Averaging time of a force, s: a vehicle turns little meanwhile, and vibration averages out."""
_HEADING_DEG: Final = 30.0
"""Median deviation, deg, of a compass's field direction in a good attitude; a badly calibrated one has ten."""
_REPEATED: Final = 0.9  # of the samples of a compass that equal the one before: it delivers nothing
_WEAK: Final = 0.2  # of the field that must lie across the vertical to tell a heading


@dataclass(frozen=True)
class Support:
    """Contradictions to tilt and heading of the logged attitude; empty: none."""

    tilt: str = ""
    heading: str = ""


def support_of(recording: Recording, attitude: Channel | None) -> Support:
    """Agreement of accelerometers and compasses with `attitude`."""
    if attitude is None:
        return Support()
    q = usable(attitude)
    if len(q) < 2:
        return Support()
    turned = Rotation.from_quat(q.values, scalar_first=True).as_matrix()
    return Support(_tilt(recording, q.t, turned), _heading(recording, q.t, turned))


def _tilt(recording: Recording, t: Array, turned: Array) -> str:
    """Contradiction to the tilt: no accelerometer measures gravity along its vertical; empty: none."""
    angles, gravity = {}, []
    for instance in recording.instances(Sensor.ACCEL):
        channel = judged_channel(recording, Sensor.ACCEL, instance)
        if channel is None:
            continue
        channel = usable(channel)
        force = _in_world(channel, t, turned)
        if force is None:
            continue
        means = motion.window_means(*force).values
        if len(means) < motion.LEAST_WINDOWS:
            continue
        length = np.maximum(np.linalg.norm(means, axis=1), 1e-9)
        angles[instance] = float(np.degrees(np.median(np.arccos(np.clip(-means[:, 2] / length, -1.0, 1.0)))))
        if abs(_usual_length(channel) - STANDARD_GRAVITY) < _AS_LONG:
            gravity.append(instance)
    limit = _TILTED_DEG if set(gravity) == set(angles) else _TILT_DEG
    if not angles or min(angles.values()) <= limit:
        return ""
    instance, angle = min(angles.items(), key=lambda one: one[1])
    return f"by it the force of accelerometer {instance + 1} points {angle:.0f} deg away from up"


def _usual_length(accel: Channel) -> float:
    """Median length of the mean force of a second, m/s2."""
    second = np.unique(np.floor((accel.t - accel.t[0]) / _SECOND), return_inverse=True)[1]
    means = np.array([np.bincount(second, column) for column in accel.values.T]) / np.bincount(second)
    return float(np.median(np.linalg.norm(means, axis=0)))


def _heading(recording: Recording, t: Array, turned: Array) -> str:
    """Contradiction to the heading: every compass is dead, or its field turns with it; empty: none."""
    reasons = [
        f"compass {event.odd.instance + 1} is dead"
        for event in recording.events
        if event.kind == "dead" and event.odd is not None and event.odd.sensor == Sensor.MAG
    ]
    for instance in recording.instances(Sensor.MAG):
        channel = judged_channel(recording, Sensor.MAG, instance)
        if channel is None or len(channel) < 2:
            continue
        channel = usable(channel)
        if repeats(channel):
            reasons.append(f"compass {instance + 1} reads the same throughout")
            continue
        field = _in_world(channel, t, turned)
        spread = None if field is None else _spread_deg(field[1])
        if spread is None or spread <= _HEADING_DEG:
            return ""
        reasons.append(f"compass {instance + 1} turns by it, by {spread:.0f} deg")
    return " and ".join(dict.fromkeys(reasons))


def repeats(channel: Channel) -> bool:
    """Whether a sensor delivers nothing: nearly all of its samples equal the one before."""
    if len(channel) < 2:
        return False
    return float((np.diff(channel.values, axis=0) == 0.0).all(axis=1).mean()) > _REPEATED


def _in_world(channel: Channel, t: Array, turned: Array) -> tuple[Array, Array] | None:
    """Times, and vectors in north, east and down, of the samples between attitudes; None: of too few."""
    row = np.clip(np.searchsorted(t, channel.t), 1, len(t) - 1)
    inside = (channel.t >= t[0]) & (channel.t <= t[-1]) & (t[row] - t[row - 1] <= motion.LONGEST_STEP_S)
    if int(inside.sum()) < motion.LEAST_WINDOWS:
        return None
    row = row[inside]
    at = channel.t[inside]
    nearest = np.where(at - t[row - 1] < t[row] - at, row - 1, row)
    return at, np.einsum("nij,nj->ni", turned[nearest], channel.values[inside])


def _spread_deg(field: Array) -> float | None:
    """Median deviation of the heading of `field` (N, 3) from its mean direction; None where it has no heading."""
    across = field[:, :2]
    length = np.linalg.norm(across, axis=1)
    if float(np.median(length)) < _WEAK * float(np.median(np.linalg.norm(field, axis=1))):
        return None
    unit = across / np.maximum(length, 1e-9)[:, None]
    mean = unit.mean(axis=0)
    cosine = unit @ mean / max(float(np.linalg.norm(mean)), 1e-9)
    return float(np.degrees(np.median(np.arccos(np.clip(cosine, -1.0, 1.0)))))
