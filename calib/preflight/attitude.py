"""The vehicle's attitude against its accelerometers: an estimator may still use former offsets.

After new accelerometer offsets the estimators of both firmwares carry the old ones for minutes, or until a restart. The
vehicle would fly by that attitude.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.firmware.compose.trim import AHRS_TRIM
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.rotations import euler_matrix
from mavcal.calib.preflight import limits
from mavcal.calib.preflight.check import Check, CheckId, Measure, judged, unknown
from mavcal.calib.preflight.rest import Mean
from mavcal.calib.recording import Channel, Recording, Sensor
from mavcal.calib.stats.windows import finite_rows

Array = NDArray[np.float64]

_RESTART = (
    "Restart the vehicle: its estimator remembers offsets that are in force no more. If that does not help, calibrate "
    "the level."
)
_TOLD = "The accelerometers agree with gravity, and the attitude does not agree with them."


def attitude(
    recording: Recording,
    accels: Mapping[int, Mean],
    autopilot: str,
    parameters: Mapping[str, Value],
    motion: str | None,
    *,
    complete: bool,
) -> Check:
    """Angle between the verticals of the attitude and of the accelerometers, deg."""
    of = CheckId.ATTITUDE
    channel = next((c for c in recording.find(Sensor.ATTITUDE) if finite_rows(c.values).any()), None)
    if channel is None:
        return unknown(of, "The vehicle did not say its attitude (ATTITUDE).", "Check again over a better link.")
    if motion is not None or not accels:
        why = motion or "no accelerometer shows where down is"
        return unknown(of, f"The vertical cannot be seen: {why}.", "Put the vehicle down and check again.")
    if autopilot == "ardupilot" and not complete and any(name not in parameters for name in AHRS_TRIM):
        return unknown(of, "AHRS_TRIM_X and _Y could not be read in time.", "Check again over a better link.")
    trim = level_trim(autopilot, parameters)
    force = np.median([mean.value for mean in accels.values()], axis=0)
    there = trim @ (-force / np.linalg.norm(force))
    off = math.degrees(math.acos(float(np.clip(there @ down(channel), -1.0, 1.0))))
    noise = max(float(np.linalg.norm(mean.sd)) for mean in accels.values()) / float(np.linalg.norm(force))
    sd = math.degrees(math.hypot(limits.TILT_SD, noise))
    limit = limits.ATTITUDE
    name = "vertical of the vehicle's attitude from that of its accelerometers"
    measure = Measure(name, off, sd, limit.value, limit.unit, ("the vehicle's estimator",), _TOLD, _RESTART)
    good = "The vehicle's own attitude agrees with its accelerometers."
    notes = (f"ATTITUDE: {len(channel)} samples over {channel.t[-1] - channel.t[0]:.1f} s",)
    return judged(of, [measure], good=good, remedy=_RESTART, notes=notes)


def level_trim(autopilot: str, parameters: Mapping[str, Value]) -> Array:
    """``R_vehicle_from_board`` (3, 3): ArduPilot's level trim turns the attitude, and no inertial message."""
    if autopilot != "ardupilot":
        return np.eye(3)
    roll, pitch = (math.degrees(float(parameters.get(name, 0.0))) for name in AHRS_TRIM)
    return euler_matrix(roll, pitch, 0.0)


def down(channel: Channel) -> Array:
    """Down in the vehicle's frame (3,), the middle of an attitude's samples."""
    w, x, y, z = channel.values[finite_rows(channel.values)].T
    downs = np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1)
    middle = np.median(downs, axis=0)
    return np.asarray(middle / np.linalg.norm(middle))
