"""Motion of a sensor: legs one after another, and their trajectory.

A leg turns the body from where the last one left it, about axes of the body. Attitude, rate and specific force each
come from one formula, so they agree to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Array, Segment

Turning = Callable[[Array], tuple[Rotation, Array]]
"""Function of seconds (n,) since the leg began: the rotation since then (body axes) and the body's rate (n, 3)."""
_MOST = 2e7  # samples of a trajectory: some gigabytes


@dataclass(frozen=True, eq=False)
class Leg:
    """A stretch of motion. An empty `label` makes no segment; `rate` is the true steady rate, `turns` whole turns."""

    duration: float
    turning: Turning
    label: str = ""
    rate: Array | None = None
    turns: float | None = None


@dataclass(frozen=True, eq=False)
class SegmentFacts:
    """What is known of a labelled segment: the true rate (3,) in rad/s, or the number of turns; None: neither."""

    segment: Segment
    rate: Array | None = None
    turns: float | None = None


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Where a sensor is and what acts on it at times `t` (N,), body axes forward-right-down.

    `attitude` is body to north-east-down, `rate` (N, 3) the body's in rad/s, `force` (N, 3) the specific force in
    m/s2 (level and at rest: ``(0, 0, -g)``), `field` (N, 3) the magnetic field in uT. `temperature` (N,) is the
    thermometer's in degC.
    """

    t: Array
    attitude: Rotation
    rate: Array
    force: Array
    field: Array
    temperature: Array
    facts: tuple[SegmentFacts, ...] = ()

    @property
    def samples_per_second(self) -> float:
        """Sample rate from the median step, 1/s."""
        return 1.0 / float(np.median(np.diff(self.t)))


@dataclass(frozen=True)
class Warming:
    """Temperature ``end - (end - start) exp(-t / time_constant)``, degC and s."""

    start: float = 25.0
    end: float = 25.0
    time_constant: float = 300.0

    def __post_init__(self) -> None:
        if not (np.isfinite([self.start, self.end]).all() and self.time_constant > 0.0):
            raise InvalidInputError(
                f"temperatures are finite and the time constant positive: {self.start}, {self.end}, "
                f"{self.time_constant}"
            )

    def __call__(self, t: Array) -> Array:
        """Temperature (N,) at seconds `t` (N,) since the start."""
        return np.asarray(self.end - (self.end - self.start) * np.exp(-t / self.time_constant), dtype=np.float64)


def hold(duration: float, label: str = "") -> Leg:
    """A leg at rest."""
    return Leg(duration, lambda t: (Rotation.identity(len(t)), np.zeros((len(t), 3))), label)


def turn(vector: Array, duration: float, label: str = "") -> Leg:
    """A turn by the rotation vector (3,) in rad, body axes, that starts and ends at rest."""

    def turning(t: Array) -> tuple[Rotation, Array]:
        s = (t / duration)[:, None]
        return Rotation.from_rotvec(s * s * (3.0 - 2.0 * s) * vector), 6.0 * s * (1.0 - s) / duration * vector

    return Leg(duration, turning, label, turns=float(np.linalg.norm(vector)) / (2.0 * np.pi))


def spin(rate: Array, duration: float, label: str = "") -> Leg:
    """A steady turn at `rate` (3,) in rad/s, body axes, that begins and ends at that rate."""

    def turning(t: Array) -> tuple[Rotation, Array]:
        return Rotation.from_rotvec(t[:, None] * rate), np.tile(rate, (len(t), 1))

    turns = float(np.linalg.norm(rate)) * duration / (2.0 * np.pi)
    return Leg(duration, turning, label, rate=np.asarray(rate, dtype=np.float64), turns=turns)


def ramp(start: Array, end: Array, duration: float) -> Leg:
    """From one steady rate to another about the same axis (3,), rad/s."""

    def turning(t: Array) -> tuple[Rotation, Array]:
        s = (t / duration)[:, None]
        angle = t[:, None] * (start + 0.5 * s * (end - start))
        return Rotation.from_rotvec(angle), start + s * (end - start)

    return Leg(duration, turning)


def weave(duration: float, angles: Callable[[Array], tuple[Array, Array]]) -> Leg:
    """A leg of yaw, pitch and roll over time: `angles` gives them (n, 3), rad, and their derivatives (n, 3)."""

    def turning(t: Array) -> tuple[Rotation, Array]:
        (yaw, pitch, roll), (dyaw, dpitch, droll) = (part.T for part in angles(t))
        p = droll - dyaw * np.sin(pitch)
        q = dpitch * np.cos(roll) + dyaw * np.cos(pitch) * np.sin(roll)
        r = -dpitch * np.sin(roll) + dyaw * np.cos(pitch) * np.cos(roll)
        return Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll])), np.column_stack([p, q, r])

    return Leg(duration, turning)


def trajectory(
    legs: Sequence[Leg],
    rate: float,
    *,
    field: Array,
    start: Rotation | None = None,
    gravity: float = STANDARD_GRAVITY,
    warming: Warming | None = None,
) -> Trajectory:
    """The samples of `legs` at `rate` per second, in a uniform `field` (3,) north-east-down in uT.

    Parameters
    ----------
    legs, rate, field
        As said.
    start
        Attitude at the beginning, body to north-east-down; None: level, facing north.
    gravity
        m/s2, straight down.
    warming
        None: 25 degC throughout.

    Raises
    ------
    InvalidInputError
        If a duration or the rate is not positive, or fewer than two samples would result.
    """
    ends = np.cumsum([leg.duration for leg in legs]) if legs else np.zeros(1)
    if not (np.isfinite(rate) and rate > 0.0 and np.isfinite(ends).all() and (np.diff(ends, prepend=0.0) > 0.0).all()):
        raise InvalidInputError(f"a motion has legs of positive duration and a positive rate, not {rate} Hz")
    if ends[-1] * rate > _MOST:
        raise InvalidInputError(f"{ends[-1]:g} s at {rate:g} Hz are more than {_MOST:g} samples: take less of either")
    t = np.arange(int(np.floor(ends[-1] * rate + 1e-9))) / rate
    if len(t) < 2:
        raise InvalidInputError(f"{ends[-1]} s at {rate} Hz are fewer than two samples")
    begin, attitudes, rates, facts = start or Rotation.identity(), [], [], []
    edges = np.searchsorted(t, np.concatenate([[0.0], ends - 1e-9]))
    for leg, i, j, end in zip(legs, edges[:-1], edges[1:], ends, strict=True):
        since = end - leg.duration
        relative, body_rate = leg.turning(t[i:j] - since)
        if j > i:
            attitudes.append((begin * relative).as_quat())
            rates.append(body_rate)
        begin = begin * leg.turning(np.array([leg.duration]))[0][0]
        if leg.label and j > i:
            facts.append(
                SegmentFacts(Segment(leg.label, float(t[i]), float(t[j - 1]) + 1.0 / rate), leg.rate, leg.turns)
            )
    attitude = Rotation.from_quat(np.concatenate(attitudes))
    return _moved(t, attitude, np.concatenate(rates), field=field, gravity=gravity, warming=warming, facts=tuple(facts))


def along(
    t: Array, attitude: Rotation, *, field: Array, gravity: float = STANDARD_GRAVITY, warming: Warming | None = None
) -> Trajectory:
    """A trajectory through N attitudes at times `t` (N,), without acceleration; a spline through them gives the rates.

    Raises
    ------
    InvalidInputError
        If there are fewer than two attitudes, or time does not rise.
    """
    if len(t) < 2 or len(t) != len(attitude) or not (np.diff(t) > 0.0).all():
        raise InvalidInputError(f"{len(attitude)} attitudes at {len(t)} times: two or more are needed, at rising times")
    rates = np.asarray(RotationSpline(t, attitude)(t, 1), dtype=np.float64)
    return _moved(
        np.asarray(t, dtype=np.float64), attitude, rates, field=field, gravity=gravity, warming=warming, facts=()
    )


def _moved(
    t: Array,
    attitude: Rotation,
    rates: Array,
    *,
    field: Array,
    gravity: float,
    warming: Warming | None,
    facts: tuple[SegmentFacts, ...],
) -> Trajectory:
    local = np.asarray(field, dtype=np.float64)
    if local.shape != (3,) or not np.isfinite(local).all() or not (np.isfinite(gravity) and gravity > 0.0):
        raise InvalidInputError(f"a field is three finite numbers in uT and gravity positive: {field}, {gravity}")
    return Trajectory(
        t=t,
        attitude=attitude,
        rate=rates,
        force=attitude.apply([0.0, 0.0, -gravity], inverse=True),
        field=attitude.apply(local, inverse=True),
        temperature=(warming or Warming())(t - t[0]),
        facts=facts,
    )
