"""The attitude and body rate of the vehicle as exact functions of vehicle time.

A motion is one segment at a time, each in closed form. The gyroscope's truth is then the exact derivative of the
attitude, and no integration error can hide in a calibration. The rate may jump between segments; the attitude never
does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from mavcal.service.simvehicle.errors import ControlError
from mavcal.service.simvehicle.rotation import (
    Array,
    conjugate,
    matrices_from_quaternions,
    multiply,
    quaternion_from_euler,
    quaternion_from_vector,
    vector_from_quaternion,
)

# Roll, pitch, yaw (deg) of the six faces as ArduPilot names them.
FACES: dict[str, tuple[float, float, float]] = {
    "level": (0, 0, 0),
    "left": (-90, 0, 0),
    "right": (90, 0, 0),
    "nose_down": (0, -90, 0),
    "nose_up": (0, 90, 0),
    "back": (180, 0, 0),
}

RAMP_S = 0.5  # a turn or tumble reaches its rate, and tremor its size, over this time
DEFAULT_TRANSITION_S = 1.5
SURGE = 0.35  # of its mean rate, by how much a tumble by hand swells and fades
SURGE_HZ = 0.7
TREMOR_BAND_HZ = (1.0, 3.0)
TREMOR_TONES = 6
MAX_TILT_FACTOR = 2.0  # a human's error is cut at twice its size


class MotionSegment(Protocol):
    """A piece of motion: unit quaternions (N, 4) and body rates (N, 3) at vehicle times (N,)."""

    def evaluate(self, t: Array) -> tuple[Array, Array]:
        """Attitude and body rate at times t ≥ the segment's start."""


class AtRest:
    """No motion at all."""

    def __init__(self, q: Array) -> None:
        self._q = q

    def evaluate(self, t: Array) -> tuple[Array, Array]:
        """See MotionSegment."""
        return np.tile(self._q, (len(t), 1)), np.zeros((len(t), 3))


class Tremor:
    """A hand's tremor about a pose: a few tones of 1 to 3 Hz on each axis, faded in."""

    def __init__(self, q: Array, start: float, rms_rad: float, rng: np.random.Generator) -> None:
        self._q, self._start = q, start
        self._omega = 2 * np.pi * rng.uniform(*TREMOR_BAND_HZ, size=(3, TREMOR_TONES))
        self._phase = rng.uniform(0, 2 * np.pi, size=(3, TREMOR_TONES))
        self._size = rms_rad * math.sqrt(2.0 / TREMOR_TONES)

    def evaluate(self, t: Array) -> tuple[Array, Array]:
        """See MotionSegment."""
        tau = t - self._start
        arg = self._omega[None] * tau[:, None, None] + self._phase[None]
        wave = self._size * np.sin(arg).sum(axis=2)
        wave_rate = self._size * (self._omega[None] * np.cos(arg)).sum(axis=2)
        x = np.clip(tau / RAMP_S, 0.0, 1.0)
        fade = (x * x * (3 - 2 * x))[:, None]
        fade_rate = (6 * x * (1 - x) / RAMP_S)[:, None]
        phi = fade * wave
        phi_rate = fade_rate * wave + fade * wave_rate
        return multiply(self._q, quaternion_from_vector(phi)), _body_rate(phi, phi_rate)


def _body_rate(phi: Array, phi_rate: Array) -> Array:
    """Body rate of q ⊗ exp(phi(t)): the right Jacobian of SO(3) times the derivative of phi."""
    angle2 = np.sum(phi * phi, axis=1, keepdims=True)
    angle = np.sqrt(angle2)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 0.5 - angle2 / 24, (1 - np.cos(safe)) / safe**2)
    b = np.where(small, 1 / 6 - angle2 / 120, (safe - np.sin(safe)) / safe**3)
    first = np.cross(phi, phi_rate)
    return np.asarray(phi_rate - a * first + b * np.cross(phi, first))


class AttitudeChange:
    """Turn from one attitude to another about the shortest axis with a minimum-jerk profile, then the next segment."""

    def __init__(self, q_from: Array, then: MotionSegment, start: float, duration: float) -> None:
        self._q_from, self._then, self._start, self._duration = q_from, then, start, duration
        q_to = then.evaluate(np.array([start + duration]))[0][0]
        self._vector = vector_from_quaternion(multiply(conjugate(q_from), q_to))

    def evaluate(self, t: Array) -> tuple[Array, Array]:
        """See MotionSegment."""
        x = np.clip((t - self._start) / self._duration, 0.0, 1.0)
        s = x**3 * (10 - 15 * x + 6 * x * x)
        s_rate = 30 * x * x * (1 - x) ** 2 / self._duration
        q = multiply(self._q_from, quaternion_from_vector(s[:, None] * self._vector))
        rate = s_rate[:, None] * self._vector
        after = t >= self._start + self._duration
        if after.any():
            q[after], rate[after] = self._then.evaluate(t[after])
        return q, rate


def _ramped(tau: Array) -> tuple[Array, Array]:
    """Elapsed time whose speed rises smoothly from 0 to 1 over RAMP_S, and that speed."""
    x = np.clip(tau / RAMP_S, 0.0, 1.0)
    speed = x * x * (3 - 2 * x)
    elapsed = RAMP_S * (x**3 - 0.5 * x**4) + np.maximum(tau - RAMP_S, 0.0)
    return elapsed, speed


class TurntableTurn:
    """A turntable: a steady rate about one body axis."""

    def __init__(self, q: Array, start: float, axis: Array, rate: float) -> None:
        self._q, self._start, self._omega = q, start, axis * rate

    def evaluate(self, t: Array) -> tuple[Array, Array]:
        """See MotionSegment."""
        elapsed, speed = _ramped(t - self._start)
        return multiply(self._q, quaternion_from_vector(elapsed[:, None] * self._omega)), speed[:, None] * self._omega


class WholeTurns:
    """Whole turns about one body axis, as on a thread: from rest to rest, at a steady rate in between."""

    def __init__(self, q: Array, start: float, axis: Array, rate: float, turns: float) -> None:
        angle = 2.0 * math.pi * turns
        steady = min(abs(rate), angle / RAMP_S)
        self._q, self._start, self._omega = q, start, axis * math.copysign(steady, rate)
        # each ramp takes RAMP_S and covers half of what the steady rate would
        self._duration = angle / steady + RAMP_S

    def evaluate(self, t: Array) -> tuple[Array, Array]:
        """See MotionSegment."""
        tau = np.clip(t - self._start, 0.0, self._duration)
        ahead, speed = _ramped(np.minimum(tau, self._duration - tau))
        elapsed = np.where(tau <= 0.5 * self._duration, ahead, self._duration - RAMP_S - ahead)
        return multiply(self._q, quaternion_from_vector(elapsed[:, None] * self._omega)), speed[:, None] * self._omega


class Tumble:
    """Smooth tumbling through all directions: Euler angles z, x, z at steady incommensurate rates.

    With q = q₀ ⊗ Z(a) ⊗ X(b) ⊗ Z(c) the body rate is ċ·e₃ + Zᵀ(c)·ḃ·e₁ + Zᵀ(c)·Xᵀ(b)·ȧ·e₃. Its length stays within
    about ±17 % of the rate of the moment. That rate varies about the requested one by SURGE of it, as a hand's does.
    The effect of a 100 ms window on a compass depends on it.
    """

    PROPORTIONS = (0.2638, 0.7907, 0.5523)  # of ȧ, ḃ, ċ to the mean rate; squares add up to 1

    def __init__(self, q: Array, start: float, rate: float) -> None:
        self._q, self._start = q, start
        self._rates = rate * np.array(self.PROPORTIONS)

    def evaluate(self, t: Array) -> tuple[Array, Array]:
        """See MotionSegment."""
        elapsed, speed = _ramped(t - self._start)
        omega = 2.0 * math.pi * SURGE_HZ
        speed = speed * (1.0 + SURGE * np.cos(omega * elapsed))
        elapsed = elapsed + SURGE * np.sin(omega * elapsed) / omega
        zero = np.zeros_like(elapsed)
        a, b, c = (rate * elapsed for rate in self._rates)
        z_a = quaternion_from_vector(np.stack([zero, zero, a], axis=1))
        x_b = quaternion_from_vector(np.stack([b, zero, zero], axis=1))
        z_c = quaternion_from_vector(np.stack([zero, zero, c], axis=1))
        e3 = np.array([0.0, 0.0, 1.0])
        # Row i of a matrix is the transpose applied to unit vector i.
        after_z = matrices_from_quaternions(z_c)
        after_xz = matrices_from_quaternions(multiply(x_b, z_c))
        rate = self._rates[2] * e3 + self._rates[1] * after_z[:, 0] + self._rates[0] * after_xz[:, 2]
        q = multiply(self._q, multiply(multiply(z_a, x_b), z_c))
        return q, speed[:, None] * rate


class CurrentMotion:
    """The present motion; a command replaces its segment from the present vehicle time on."""

    def __init__(self, rng: np.random.Generator, yaw_deg: float = 0.0) -> None:
        self._rng = rng
        self._segment: MotionSegment = AtRest(quaternion_from_euler(0.0, 0.0, math.radians(yaw_deg)))
        self.name = "still"
        self._jolts: list[tuple[float, float, Array]] = []

    def evaluate(self, t: Array) -> tuple[Array, Array]:
        """Attitude (N, 4) and body rate (N, 3) at ascending vehicle times not before the last command."""
        return self._segment.evaluate(t)

    def linear_acceleration(self, t: Array) -> Array:
        """Specific force of shocks in the body frame, shape (N, 3): zero without a jolt."""
        force = np.zeros((len(t), 3))
        for start, duration, peak in self._jolts:
            x = (t - start) / duration
            force += np.where((x >= 0) & (x <= 1), np.sin(np.pi * x), 0.0)[:, None] * peak
        return force

    def attitude(self, t: float) -> Array:
        """The quaternion at one time."""
        return np.asarray(self.evaluate(np.array([t]))[0][0])

    def still(self, t: float) -> None:
        """Stop in the present attitude without tremor, as on a bench."""
        self._segment, self.name = AtRest(self.attitude(t)), "still"

    def hold(
        self,
        t: float,
        pose: str | Sequence[float],
        tilt_deg: float = 0.0,
        tremor_deg: float = 0.0,
        transition_s: float = DEFAULT_TRANSITION_S,
    ) -> float:
        """Turn to a pose and hold it there as a person does.

        Args:
            t: vehicle time of the command.
            pose: a face of FACES; roll, pitch, yaw in degrees; or a quaternion w x y z.
            tilt_deg: size of the person's error of attitude (rms per horizontal axis, cut at twice that).
            tremor_deg: rms of the tremor per axis.
            transition_s: duration of the turn.

        Returns: the vehicle time at which the pose is reached.
        """
        error = np.clip(self._rng.normal(size=3), -MAX_TILT_FACTOR, MAX_TILT_FACTOR) * math.radians(tilt_deg)
        target = multiply(_pose(pose), quaternion_from_vector(error))
        reached = t + max(transition_s, 0.0)
        held: MotionSegment = (
            Tremor(target, reached, math.radians(tremor_deg), self._rng) if tremor_deg > 0 else AtRest(target)
        )
        self._segment = AttitudeChange(self.attitude(t), held, t, transition_s) if transition_s > 0 else held
        self.name = f"hold {pose}"
        return reached

    def turn(self, t: float, axis: Sequence[float], rate_dps: float, turns: float | None = None) -> None:
        """Turn steadily about a body axis; `turns` of them from rest to rest, or until told otherwise."""
        vector = np.asarray(axis, dtype=np.float64)
        length = float(np.linalg.norm(vector)) if vector.shape == (3,) else 0.0
        if not length > 0:
            raise ControlError(f"turn: axis must be three numbers that are not all zero, got {list(axis)}")
        if turns is not None and not (turns > 0 and rate_dps):
            raise ControlError(f"turn: {turns} turns at {rate_dps} deg/s cannot be made")
        q, rate = self.attitude(t), math.radians(rate_dps)
        whole = None if turns is None else WholeTurns(q, t, vector / length, rate, turns)
        self._segment = whole or TurntableTurn(q, t, vector / length, rate)
        self.name = "turn"

    def tumble(self, t: float, rate_dps: float = 45.0) -> None:
        """Tumble through all directions; the rate swells and fades."""
        self._segment, self.name = Tumble(self.attitude(t), t, math.radians(rate_dps)), "tumble"

    def jolt(self, t: float, peak: Sequence[float], duration_s: float = 0.1) -> None:
        """A half-sine shock of specific force (m/s², body frame), beginning now."""
        vector = np.asarray(peak, dtype=np.float64)
        if vector.shape != (3,) or not np.isfinite(vector).all():
            raise ControlError(f"jolt: peak must be three finite numbers in m/s², got {peak}")
        self._jolts = [j for j in self._jolts if j[0] + j[1] > t]
        self._jolts.append((t, max(duration_s, 1e-3), vector))

    def restart(self, elapsed: float) -> None:
        """Restart vehicle time at zero after `elapsed` seconds; the motion goes on undisturbed."""
        self._segment = ClockShifted(self._segment, elapsed)
        self._jolts = [(start - elapsed, duration, peak) for start, duration, peak in self._jolts]


class ClockShifted:
    """A segment seen by a clock that was set back."""

    def __init__(self, segment: MotionSegment, elapsed: float) -> None:
        self._segment, self._elapsed = segment, elapsed

    def evaluate(self, t: Array) -> tuple[Array, Array]:
        """See MotionSegment."""
        return self._segment.evaluate(t + self._elapsed)


def _pose(pose: str | Sequence[float]) -> Array:
    """Quaternion of a pose."""
    if isinstance(pose, str):
        if pose not in FACES:
            raise ControlError(
                f"hold: unknown pose {pose!r}; known: {', '.join(FACES)}, or [roll, pitch, yaw] in degrees"
            )
        return quaternion_from_euler(*np.radians(FACES[pose]))
    numbers = np.array(pose, dtype=np.float64)
    length = float(np.linalg.norm(numbers))
    if numbers.shape == (3,):
        return quaternion_from_euler(*np.radians(numbers))
    if numbers.shape != (4,) or not 0.5 < length < 2.0:
        raise ControlError(f"hold: a pose has three angles in degrees or is a unit quaternion, got {pose}")
    return np.asarray(numbers / length)
