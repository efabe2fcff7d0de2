"""A reference that was recorded: ``ref_*`` columns, or the readings of a simulator on the same trajectory."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.problem import ReferenceInfo, ReferenceKind
from mavcal.calib.gap.reference.calibrated import TRIADS
from mavcal.calib.gap.reference.ideal import Ideal
from mavcal.calib.gap.reference.signals import Signal
from mavcal.calib.gap.reference.simulator import denoised
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

Array = NDArray[np.float64]

TABLE = "table"
"""Source of the channels of a table: the only recordings whose own attitude is a truth."""


def reference_readings(recording: Recording) -> dict[Sensor, Signal]:
    """What `recording` says that ideal sensors read."""
    return _signals(recording.reference)


def recorded(recording: Recording) -> Ideal | None:
    """The reference that `recording` carries itself; None if it has none.

    Attitude: ``ref_q_*``, else that of a table, which counts as truth; never an estimator's.
    """
    readings = reference_readings(recording)
    if not readings:
        return None
    names = ", ".join(sensor.value for sensor in TRIADS if sensor in readings)
    text = f"The recording carries what ideal sensors read ({names})."
    return Ideal(ReferenceInfo(ReferenceKind.SIM, text=text), readings, true_attitude(recording), true_place(recording))


def simulated(recording: Recording) -> Ideal | None:
    """What the sensors of a simulator's `recording` read, without its noise where it has some; None if it has none."""
    channels = [
        recording.channel(sensor, recording.instances(sensor)[0])
        for sensor in TRIADS
        if any(c.stage != Stage.DEBIASED for c in recording.channels if c.sensor == sensor and len(c))
    ]
    readings = _signals(channels)
    if not readings:
        return None
    quiet = {c.sensor: found for c in channels if c.sensor in readings and (found := denoised(c)) is not None}
    readings |= {sensor: found.signal for sensor, found in quiet.items()}
    named = ", ".join(sensor.value for sensor in quiet)
    freed = f"freed of its own noise ({named})" if quiet else "its own noise included"
    return Ideal(
        ReferenceInfo(ReferenceKind.SIM, text=f"Readings of a simulator on the same trajectory, {freed}."),
        readings,
        true_attitude(recording),
        true_place(recording),
        noise={sensor: found.noise for sensor, found in quiet.items()},
    )


def true_attitude(recording: Recording) -> Signal | None:
    """Body to north-east-down: ``ref_q_*``, else that of a table; None: only an estimator's or none."""
    found = [c for c in recording.reference if c.sensor == Sensor.ATTITUDE]
    found += [c for c in recording.channels if c.sensor == Sensor.ATTITUDE and c.source == TABLE]
    for channel in found:
        if (signal := Signal.of(channel)) is not None:
            return Signal(signal.t, continuous(signal.values))
    return None


def true_place(recording: Recording) -> Signal | None:
    """North, east, down of the reference's origin; None if it was not recorded."""
    return next((Signal.of(c) for c in recording.reference if c.sensor == Sensor.PLACE), None)


def continuous(q: Array) -> Array:
    """The same attitudes (N, 4) without jumps of sign, so that they can be interpolated."""
    turned = np.concatenate([[1.0], np.cumprod(np.where((q[1:] * q[:-1]).sum(axis=1) < 0.0, -1.0, 1.0))])
    return np.asarray(q * turned[:, None])


def _signals(channels: Iterable[Channel]) -> dict[Sensor, Signal]:
    found: dict[Sensor, Signal] = {}
    for channel in channels:
        if channel.sensor in TRIADS and channel.sensor not in found and (signal := Signal.of(channel)) is not None:
            found[channel.sensor] = signal
    return found
