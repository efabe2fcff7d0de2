"""Rows of a flight near the ground but in the air: take-off, landing, a low hover.

The airframe is fitted on the rest of the flight. Measured thrust near the ground is compared with that fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.airframe.flown import FlownFlight, Unflown, flown
from mavcal.calib.airframe.physics import Airframe, Layout
from mavcal.calib.recording import Channel, Recording, Sensor

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEGS_M: Final = (0.15, 0.05)
"""Mean and standard deviation of the rotors' height when the vehicle stands. Chosen, not measured: small drones."""
HEIGHT_SD: Final = {Sensor.HEIGHT: 0.03, Sensor.PLACE: 0.1}
"""Standard deviation of the height in one pass, m. Source: data sheets of rangefinders; the estimator's height between
take-off and hover."""
_CLEAR: Final = {Sensor.HEIGHT: 0.08, Sensor.PLACE: 0.2}
"""Height above the stand, m, below which a row may be on the ground. Source: two to three of these errors."""
_CONTACT_S: Final = 0.3
"""Time, s, left out around such rows. Chosen, not measured: legs bend, and the accelerometer is filtered."""
NEAR_M: Final = 0.6
"""Height of the rotors below which ground effect shows. Source: three radii of a 15-inch propeller, where one rotor
alone gains 0.7 %."""
_PASS_M: Final = 3.0
"""Height, m, up to which a pass over the ground is used, for its offset. Chosen, not measured: ten radii and more."""
CALM_M: Final = 4.0
"""Height, m, above which rows are used for the noise of thrust. Chosen, not measured: above every pass."""
_CALM_PUSH: Final = 1.5
_CALM_CLIMB: Final = 1.5
_CALM_SPEED: Final = 2.0
"""Limits of calm flight: vertical force minus gravity, m/s2, climb and speed over ground, m/s. Chosen, not measured."""
_LEAST_NOISE: Final = 1e-3
"""Least noise of relative thrust in one row. Source: a third of the model's own error."""
_BLOCK: Final = 10
"""Grid rows averaged into one row: 0.1 s."""
MEMORY_S: Final = 3.0
"""Longest lag of the noise covariance, s. Chosen, not measured: duration of gusts in a hover."""
_REST_S: Final = 3.0
"""Time, s, before and after the motors run in which the height of the stand is measured."""
_FEWEST: Final = 10
_SHORTEST: Final = 2
"""Least number of rows of a height series, and of a pass."""


@dataclass(frozen=True, eq=False)
class Pass:
    """One stretch near the ground: relative thrust gain (M,) and height above the stand (M,), m."""

    gain: Array
    height: Array


@dataclass(frozen=True, eq=False)
class LowFlight:
    """Passes of a flight near the ground, and the noise of its thrust.

    `noise` is the covariance of the relative thrust gain by lag; `step` is the time between rows, s; `height_sd` in m.
    """

    passes: tuple[Pass, ...]
    noise: Array
    step: float
    height_sd: float

    @property
    def low_s(self) -> float:
        """Time in the air with the rotors below :data:`NEAR_M`, s."""
        return self.step * sum(int((p.height + LEGS_M[0] < NEAR_M).sum()) for p in self.passes)


@dataclass(frozen=True, eq=False)
class NearGround:
    """A flight from its motors' start to their stop, and its height `above` the stand (N,), m; nan: not known.

    `sensor` measured the height.
    """

    flight: FlownFlight
    above: Array
    sensor: Sensor


def near_ground(recording: Recording, flight: FlownFlight) -> NearGround | None:
    """The flight with take-off and landing; None where no height is logged.

    A rangefinder is preferred to the estimator, except far above the ground, where it may be out of range.
    """
    found = {c.sensor: c for c in recording.dynamics if c.sensor in HEIGHT_SD and len(c) > _FEWEST}
    whole = flown(recording, flight.geometry, flight.commands, from_ground=True) if found else None
    if whole is None or isinstance(whole, Unflown):
        return None
    heights = {sensor: _above_stand(channel, whole) for sensor, channel in found.items()}
    sensor = Sensor.HEIGHT if Sensor.HEIGHT in heights else Sensor.PLACE
    above = heights[sensor]
    if len(heights) > 1:
        above = np.where(heights[Sensor.PLACE] > CALM_M, heights[Sensor.PLACE], above)
    return NearGround(whole, above, sensor)


def low_flight(near: NearGround, like: Airframe, theta: Array) -> LowFlight | None:
    """Thrust gain near the ground relative to a fitted airframe; None: too little calm flight to know the noise.

    `theta` are the airframe's parameters on the layout of `like`.
    """
    flight, clear = near.flight, _CLEAR[near.sensor]
    airframe = Airframe(
        flight, like.kind, like.full_voltage, spin_low=like.spin_low, slew=like.slew, torque=False,
        loaded_at=like.loaded_at,
    )  # fmt: skip
    theta = _on_layout(theta, like.layout, airframe.layout)
    predicted, _ = airframe.predicted(theta)
    thrust, _, _ = airframe.thrusts(theta)
    lift = theta[airframe.layout.place["k"]] * thrust.mean(axis=1)
    usable = flight.usable & (lift > 0.5 * flight.gravity) & np.isfinite(near.above) & _calm(flight)
    gain = np.where(usable, (predicted[:, 2] - flight.force[:, 2]) / np.maximum(lift, 1e-3), np.nan)
    rows = len(gain) // _BLOCK
    gain, height = (x[: rows * _BLOCK].reshape(rows, _BLOCK).mean(axis=1) for x in (gain, near.above))
    step = _BLOCK / flight.fs
    noise = noise_by_lag(np.where(height > CALM_M, gain, np.nan), round(MEMORY_S / step))
    if noise is None:
        return None
    width = 2 * max(round(_CONTACT_S / step), 1) + 1
    touched = np.convolve(~(height > clear), np.ones(width), mode="same") > 0.5
    kept = np.isfinite(gain) & ~touched & (height < _PASS_M)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]]).astype(np.int8)))
    spans = zip(edges[::2], edges[1::2], strict=True)
    passes = tuple(Pass(gain[a:b], height[a:b]) for a, b in spans if b - a >= _SHORTEST)
    return LowFlight(passes, noise, step, HEIGHT_SD[near.sensor])


def _above_stand(channel: Channel, flight: FlownFlight) -> Array:
    """Height above the ground where the vehicle stood before and after the flight (N,), m; nan if it did not stand."""
    values = channel.values[:, 0] if channel.sensor == Sensor.HEIGHT else -channel.values[:, 2]
    start, end = float(flight.t[0]), float(flight.t[-1])
    known = []
    for low, high, at in ((start - _REST_S, start, start), (end, end + _REST_S, end)):
        rows = (channel.t >= low) & (channel.t <= high)
        if rows.sum() >= 2:
            known.append((at, float(np.median(values[rows]))))
    if not known:
        return np.full(len(flight.t), np.nan)
    stand = np.interp(flight.t, [k[0] for k in known], [k[1] for k in known])
    return np.asarray(np.interp(flight.t, channel.t, values) - stand)


def _calm(flight: FlownFlight) -> Mask:
    """Mask (N,) of rows near a hover, since the formula holds in steady flow."""
    push = np.abs(flight.force[:, 2] + flight.gravity)
    speed = np.hypot(flight.velocity[:, 0], flight.velocity[:, 1])
    return np.asarray((push < _CALM_PUSH) & (np.abs(flight.velocity[:, 2]) < _CALM_CLIMB) & (speed < _CALM_SPEED))


def noise_by_lag(gain: Array, memory: int) -> Array | None:
    """Covariance by lag of the thrust noise in calm flight above the ground (nan elsewhere); None: too few rows."""
    known = np.isfinite(gain)
    if known.sum() < 2 * memory:
        return None
    centre, spread = float(np.median(gain[known])), np.percentile(gain[known], (1.0, 99.0))
    off = np.where(known, np.clip(gain, *spread) - centre, 0.0)
    full = np.array([float(off[: len(off) - k] @ off[k:]) for k in range(memory)]) / float(known.sum())
    # Bartlett's window has no negative lobe, so the covariance stays positive definite.
    full *= 1.0 - np.arange(memory) / memory
    full[0] += _LEAST_NOISE**2
    return np.asarray(full)


def _on_layout(theta: Array, layout: Layout, other: Layout) -> Array:
    """`theta` on another layout; effects without a name are left out."""
    found = np.zeros(len(other.names))
    for name in set(layout.names) - set(layout.free):
        found[other.place[name]] = theta[layout.place[name]]
    return found
