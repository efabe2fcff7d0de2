"""Readings of ideal sensors as signals over time.

A recorded reference is in ``ref_*`` columns, or consists of the readings of a simulator on the same trajectory.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.problem import ReferenceInfo, ReferenceKind, Trace
from mavcal.calib.gap.reference.channels import TRIADS, filter_in_force, sensor_from_corrected
from mavcal.calib.gap.reference.noise import ResidualSpectrum
from mavcal.calib.gap.reference.signals import Signal, grid_of, slow_values
from mavcal.calib.gap.reference.simulator import denoised
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

Array = NDArray[np.float64]

_QUIET_S = 1.0
"""Length, s, of the spans, of which the quietest shows the noise of a reading. Chosen, not measured: it has tens of
samples, and flights have calm spans of that length."""


@dataclass(frozen=True, eq=False)
class Ideal:
    """A reference: readings of ideal sensors in body axes.

    Parameters
    ----------
    info
        Where it comes from and how far it can be believed.
    readings
        Of ACCEL, GYRO, MAG where they are known, (N, 3).
    attitude
        Body to north-east-down, w x y z, or None.
    place
        North, east, down of a local origin, m, or None.
    warnings
        Warnings about the reference.
    noise
        By sensor, for a reference made from noisy readings: the noise of such a sensor relative to it.
    """

    info: ReferenceInfo
    readings: Mapping[Sensor, Signal]
    attitude: Signal | None = None
    place: Signal | None = None
    warnings: tuple[str, ...] = ()
    spin: Signal | None = field(default=None)
    noise: Mapping[Sensor, ResidualSpectrum] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.spin is None and Sensor.GYRO in self.readings:
            object.__setattr__(self, "spin", self.readings[Sensor.GYRO].rate_of_change())

    def shifted(self, by: float) -> Ideal:
        """The same, `by` seconds later."""
        readings = {sensor: signal.shifted(by) for sensor, signal in self.readings.items()}
        attitude = None if self.attitude is None else self.attitude.shifted(by)
        place = None if self.place is None else self.place.shifted(by)
        return Ideal(self.info, readings, attitude, place, self.warnings, noise=self.noise)

    def body(self, t: Array) -> dict[str, Any]:
        """Force, rate, spin, field, attitude and place at `t`; None if unknown."""
        signals = {
            "force": self.readings.get(Sensor.ACCEL),
            "rate": self.readings.get(Sensor.GYRO),
            "spin": self.spin,
            "field": self.readings.get(Sensor.MAG),
            "attitude": self.attitude,
            "place": self.place,
        }
        values = {name: None if signal is None else signal.at(t) for name, signal in signals.items()}
        if (q := values["attitude"]) is not None:
            values["attitude"] = q / np.linalg.norm(q, axis=1, keepdims=True)
        return values


def trace_of(channel: Channel, reading: Signal, ideal: Ideal | None, recording: Recording) -> Trace:
    """`channel` on its own grid beside `reading`, with the state of body and vehicle.

    The ideal reading is taken at the true time stamps, so that their jitter is no gap. Both are in the scale of the
    sensor.

    Raises
    ------
    InvalidInputError
        If the channel is no time series.
    """
    grid = grid_of(channel)
    at_points = grid.t.copy()
    at_points[grid.point] = grid.stamps
    scale = sensor_from_corrected(channel, recording)
    ideal_values = reading.at(at_points) @ scale.T
    observed = grid.observed & reading.known(at_points)
    measured = ideal_values.copy()
    rows = observed[grid.point]
    measured[grid.point[rows]] = channel.values[grid.sample[rows]] @ scale.T
    keep = _observed_span(observed)
    trace = Trace(
        sensor=channel.sensor,
        instances=(channel.instance,),
        t=grid.t[keep],
        measured=measured[keep],
        ideal=ideal_values[keep],
        observed=observed[keep],
        quantum=channel.quantum,
        low_pass_hz=filter_in_force(channel, recording),
    )
    body = {} if ideal is None else ideal.body(at_points[keep])
    return dataclasses.replace(trace, **body, **_vehicle_data(recording, channel, trace.t))


def with_unit_noise(trace: Trace, reference: ReferenceInfo) -> Trace:
    """`trace` with the noise of the inertial unit that is inside its reference.

    The trajectory follows that unit between its other measurements. The quietest second of the ideal reading bounds its
    noise.
    """
    bandwidth = {Sensor.ACCEL: reference.bandwidth_hz, Sensor.GYRO: reference.turns_hz}.get(trace.sensor, math.inf)
    width = max(2, round(_QUIET_S * trace.fs))
    count = len(trace.t) // width
    seen = trace.observed[: count * width].reshape(count, width).all(axis=1)
    if trace.against is not None or math.isinf(bandwidth) or not seen.any():
        return trace
    parts = trace.ideal[: count * width].reshape(count, width, 3)[seen]
    quietest = float(parts.std(axis=1).max(axis=1).min())
    return dataclasses.replace(trace, unit_sd=quietest)


def _observed_span(observed: NDArray[np.bool_]) -> slice:
    """From the first to the last observed point."""
    seen = np.flatnonzero(observed)
    return slice(int(seen[0]), int(seen[-1]) + 1) if len(seen) else slice(0, 0)


def _vehicle_data(recording: Recording, channel: Channel, t: Array) -> dict[str, Any]:
    """Temperature, current, throttle, motors and rotors at `t`; None if not recorded."""
    thermometers = [c for i in (channel.instance, 0) for c in recording.find(Sensor.TEMPERATURE, i)]
    single = {
        "temperature": slow_values(thermometers, t),
        "current": slow_values(recording.find(Sensor.CURRENT), t),
        "throttle": slow_values(recording.find(Sensor.THROTTLE), t),
    }
    return {
        **{name: None if values is None else values[:, 0] for name, values in single.items()},
        "motors": slow_values(recording.find(Sensor.MOTOR), t),
        "rotor_hz": slow_values(recording.find(Sensor.ROTOR_SPEED), t),
    }


TABLE = "table"
"""Source of the channels of a table, the only recordings whose own attitude counts as truth."""


def reference_readings(recording: Recording) -> dict[Sensor, Signal]:
    """Ideal readings that `recording` carries."""
    return _signals(recording.reference)


def recorded_reference(recording: Recording) -> Ideal | None:
    """The reference that `recording` carries; None without one.

    Attitude: ``ref_q_*``, else that of a table, which counts as truth; never an estimator's.
    """
    readings = reference_readings(recording)
    if not readings:
        return None
    names = ", ".join(sensor.value for sensor in TRIADS if sensor in readings)
    text = f"The recording carries what ideal sensors read ({names})."
    return Ideal(ReferenceInfo(ReferenceKind.SIM, text=text), readings, true_attitude(recording), true_place(recording))


def simulator_reference(recording: Recording) -> Ideal | None:
    """Readings of a simulator's `recording`, without its noise if that can be separated; None without sensors."""
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
    """Body to north-east-down: ``ref_q_*``, else that of a table; None for an estimator's."""
    found = [c for c in recording.reference if c.sensor == Sensor.ATTITUDE]
    found += [c for c in recording.channels if c.sensor == Sensor.ATTITUDE and c.source == TABLE]
    for channel in found:
        if (signal := Signal.of(channel)) is not None:
            return Signal(signal.t, continuous(signal.values))
    return None


def true_place(recording: Recording) -> Signal | None:
    """North, east, down of the reference's origin; None if not recorded."""
    return next((Signal.of(c) for c in recording.reference if c.sensor == Sensor.PLACE), None)


def continuous(q: Array) -> Array:
    """The same attitudes (N, 4) without sign changes, for interpolation."""
    turned = np.concatenate([[1.0], np.cumprod(np.where((q[1:] * q[:-1]).sum(axis=1) < 0.0, -1.0, 1.0))])
    return np.asarray(q * turned[:, None])


def _signals(channels: Iterable[Channel]) -> dict[Sensor, Signal]:
    found: dict[Sensor, Signal] = {}
    for channel in channels:
        if channel.sensor in TRIADS and channel.sensor not in found and (signal := Signal.of(channel)) is not None:
            found[channel.sensor] = signal
    return found
