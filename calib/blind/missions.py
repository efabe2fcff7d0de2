"""Missions: what a vehicle really does, at eight times the log rate.

Everything here is truth: motion, field, temperature, current, rotors. Smooth paths make the acceleration; a multirotor
tilts so that its thrust carries it (differential flatness), a hand-held one is turned through attitudes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation, Slerp

Array = NDArray[np.float64]
Rng = np.random.Generator

OVERSAMPLING = 8
LOG_RATE = 200.0
DURATION = 70.0
GRAVITY_N = np.array([0.0, 0.0, 9.80665])
ROTORS = 4
MARGIN = 16
BLOCK = 512
FULL_SPEED_HZ = 110.0  # of a 10 inch rotor at full throttle


class MissionKind(StrEnum):
    """What is done with the vehicle."""

    TUMBLE = "tumble"  # by hand through all attitudes, rotors off
    HOVER = "hover"
    FLIGHT = "flight"  # take-off, turns, climbs, landing
    FULL = "full"  # by hand through all attitudes, then two short flights from the same attitude


ALL = tuple(MissionKind)
TURNED = (MissionKind.TUMBLE, MissionKind.FULL)
FLOWN = (MissionKind.HOVER, MissionKind.FLIGHT, MissionKind.FULL)
TRAVELLED = (MissionKind.FLIGHT, MissionKind.FULL)


@dataclass(frozen=True, eq=False)
class World:
    """Truth on the fine grid: N = 8 x log samples; vectors are (N, 3)."""

    kind: MissionKind
    t: Array  # s, from 0
    attitude: Rotation  # n from b
    place: Array  # m, north east down
    velocity: Array  # m/s
    force: Array  # specific force in the body, m/s2
    rate: Array  # rad/s in the body
    field_n: Array  # (3,) uT
    field: Array  # uT in the body
    temperature: Array  # degC of the board, (N,)
    throttle: Array  # 0..1
    current: Array  # A
    rotor_hz: Array  # (N, 4)
    rotor_angle: Array  # (N, 4) rad

    @property
    def dt(self) -> float:
        """Fine step, s."""
        return float(self.t[1] - self.t[0])

    def truth(self, sensor: str) -> Array:
        """What an ideal sensor reads."""
        return {"accel": self.force, "gyro": self.rate, "mag": self.field}[sensor]


def smooth(t: Array, rng: Rng, band: tuple[float, float], rms: float, *, roll_off: float = 0.0) -> Array:
    """A band-limited path of the given rms: a sum of sines at random frequencies (Hz) and phases.

    Amplitudes fall with the power `roll_off` of the frequency: what has mass moves less the faster it is.
    """
    terms = 8
    f = np.exp(rng.uniform(math.log(band[0]), math.log(band[1]), terms))
    phase = rng.uniform(0.0, 2.0 * np.pi, terms)
    weight = rng.uniform(0.4, 1.0, terms) * f**-roll_off
    weight *= rms / math.sqrt(0.5 * float(weight @ weight))
    # sin(a + b) over blocks of the uniform grid: a few thousand sines in place of a million.
    w, dt = 2.0 * np.pi * f, float(t[1] - t[0])
    starts = w * (t[0] + dt * BLOCK * np.arange(-(-len(t) // BLOCK)))[:, None] + phase
    steps = np.outer(w, dt * np.arange(BLOCK))
    path = (weight * np.sin(starts)) @ np.cos(steps) + (weight * np.cos(starts)) @ np.sin(steps)
    return np.asarray(path.ravel()[: len(t)])


def smooth3(t: Array, rng: Rng, band: tuple[float, float], rms: Array | float, *, roll_off: float = 0.0) -> Array:
    """Three of them, (N, 3)."""
    each = np.broadcast_to(rms, 3)
    return np.stack([smooth(t, rng, band, float(r), roll_off=roll_off) for r in each], axis=1)


def ease(t: Array, start: float, end: float) -> Array:
    """From 0 before `start` to 1 after `end`, with three continuous derivatives."""
    u = np.clip((t - start) / (end - start), 0.0, 1.0)
    return np.asarray(u**4 * (35.0 - 84.0 * u + 70.0 * u**2 - 20.0 * u**3))


def window(t: Array, start: float, end: float, edge: float = 2.0) -> Array:
    """1 between `start` and `end`, eased."""
    return np.asarray(ease(t, start, start + edge) * (1.0 - ease(t, end - edge, end)))


def make_mission(kind: MissionKind, rng: Rng, *, duration: float = DURATION, log_rate: float = LOG_RATE) -> World:
    """A new mission of that kind."""
    n = round(duration * log_rate) * OVERSAMPLING
    dt = 1.0 / (log_rate * OVERSAMPLING)
    t = np.asarray(
        (np.arange(n + 2 * MARGIN) - MARGIN) * dt, dtype=np.float64
    )  # derivatives at the ends need neighbours
    hand, air = _phases(kind, t, duration)
    flown = _flown_path(kind, t, rng, air)
    place = flown + smooth3(t, rng, (0.3, 1.8), rng.uniform(0.02, 0.06), roll_off=1.0) * hand[:, None]
    velocity = np.gradient(place, dt, axis=0)
    force_n = np.gradient(velocity, dt, axis=0) - GRAVITY_N
    # Drag is linear in the speed where rotors blow: the thrust carries weight, acceleration and drag.
    speed = np.gradient(flown, dt, axis=0)
    thrust_n = np.gradient(speed, dt, axis=0) - GRAVITY_N + rng.uniform(0.15, 0.45) * speed
    wobble = smooth3(t, rng, (0.3, 6.0), np.radians(rng.uniform(0.8, 2.5)), roll_off=1.0)
    attitude = _flying(thrust_n, _yaw(kind, t, rng, air))
    if kind in TURNED:
        attitude = product(attitude, _turned(kind, t, rng, duration))
    attitude = product(attitude, Rotation.from_rotvec(wobble * (air + hand)[:, None]))
    throttle = _throttle(kind, t, rng, air, force_n)
    rotor_hz = _rotors(t, rng, throttle)
    load = (rotor_hz.mean(axis=1) / FULL_SPEED_HZ) ** 2  # the current follows the rotors' load
    current = rng.uniform(25.0, 45.0) * load**1.5 + _avionics(t, rng)
    field_n = _earth_field(rng)
    inside = slice(MARGIN, MARGIN + n)
    return World(
        kind=kind,
        t=t[inside],
        attitude=attitude[inside],
        place=place[inside],
        velocity=velocity[inside],
        force=attitude.inv().apply(force_n)[inside],
        rate=_rates(attitude, dt)[inside],
        field_n=field_n,
        field=attitude[inside].inv().apply(np.tile(field_n, (n, 1))),
        temperature=_temperature(kind, t, rng, duration)[inside],
        throttle=throttle[inside],
        current=current[inside],
        rotor_hz=rotor_hz[inside],
        rotor_angle=(2.0 * np.pi * np.cumsum(rotor_hz, axis=0) * dt)[inside],
    )


def _phases(kind: MissionKind, t: Array, duration: float) -> tuple[Array, Array]:
    """How much the vehicle is in the hand, and in the air; 0..1."""
    none = np.zeros_like(t)
    if kind == MissionKind.TUMBLE:
        return window(t, 1.0, duration - 1.0), none
    if kind == MissionKind.HOVER:
        return none, np.ones_like(t)
    if kind == MissionKind.FLIGHT:
        return none, window(t, 0.08 * duration, 0.95 * duration, 0.07 * duration)
    first, second = (0.46 * duration, 0.68 * duration), (0.74 * duration, 0.97 * duration)
    return window(t, 1.0, 0.42 * duration), window(t, *first, 0.07 * duration) + window(t, *second, 0.07 * duration)


def _flown_path(kind: MissionKind, t: Array, rng: Rng, air: Array) -> Array:
    if kind == MissionKind.HOVER:
        return smooth3(t, rng, (0.04, 0.5), np.array([0.35, 0.35, 0.15]))
    size = np.array([4.0, 4.0, 1.5]) * rng.uniform(0.6, 1.2)
    climb = np.array([0.0, 0.0, -rng.uniform(2.0, 6.0)])
    flown: Array = (smooth3(t, rng, (0.03, 0.2), size) + climb) * air[:, None]
    return flown


def _yaw(kind: MissionKind, t: Array, rng: Rng, air: Array) -> Array:
    yaw = np.full_like(t, rng.uniform(-np.pi, np.pi))
    if kind == MissionKind.HOVER:
        return yaw + smooth(t, rng, (0.02, 0.3), np.radians(rng.uniform(8.0, 40.0)))
    turns = np.zeros_like(t)
    for start in np.sort(rng.uniform(8.0, t[-1] - 8.0, 6)):
        turns += np.radians(rng.choice([-180.0, -90.0, 90.0, 180.0])) * ease(t, start, start + rng.uniform(1.5, 4.0))
    return yaw + turns + smooth(t, rng, (0.05, 0.8), np.radians(6.0)) * air


def _flying(force_n: Array, yaw: Array) -> Rotation:
    """Attitude whose -z axis carries the specific force at that heading."""
    z = -force_n / np.linalg.norm(force_n, axis=1, keepdims=True)
    ahead = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=1)
    y = np.cross(z, ahead)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return Rotation.from_matrix(np.stack([np.cross(y, z), y, z], axis=2))


def _turned(kind: MissionKind, t: Array, rng: Rng, duration: float) -> Rotation:
    """By hand through attitudes and back to level: ten poses with quick turns between."""
    end = duration if kind == MissionKind.TUMBLE else 0.42 * duration
    poses = Rotation.concatenate([Rotation.identity(), Rotation.random(10, random_state=rng), Rotation.identity()])
    knots = np.linspace(1.5, end - 1.5, len(poses))
    step = float(knots[1] - knots[0])
    hold = rng.uniform(0.15, 0.5)
    progress = np.zeros_like(t)
    for k in knots[:-1]:
        progress += ease(t, float(k) + hold * step, float(k) + step)
    return Slerp(np.arange(len(poses)), poses)(np.clip(progress, 0.0, len(poses) - 1.0))


def product(first: Rotation, second: Rotation) -> Rotation:
    """``first * second`` of many, by Hamilton's rule on whole columns."""
    a, b = first.as_quat().T, second.as_quat().T
    x = a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1]
    y = a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0]
    z = a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3]
    w = a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2]
    return Rotation.from_quat(np.stack([x, y, z, w], axis=1))


def _rates(attitude: Rotation, dt: float) -> Array:
    """Body rates by central differences of the attitude; exact to (rate dt)^2."""
    step = product(attitude[:-1].inv(), attitude[1:]).as_rotvec() / dt
    middle = 0.5 * (step[1:] + step[:-1])
    return np.vstack([step[:1], middle, step[-1:]])


def _throttle(kind: MissionKind, t: Array, rng: Rng, air: Array, force_n: Array) -> Array:
    if kind == MissionKind.TUMBLE:
        return np.zeros_like(t)
    hover = rng.uniform(0.38, 0.5)
    thrust = np.linalg.norm(force_n, axis=1) / GRAVITY_N[2]
    busy = smooth(t, rng, (0.05, 1.0), 0.04)
    for start in rng.uniform(0.1 * t[-1], 0.9 * t[-1], 3):
        busy += rng.uniform(-0.1, 0.14) * window(t, start, start + rng.uniform(4.0, 9.0), 1.0)
    on = np.clip(air * 4.0, 0.0, 1.0)  # full thrust before the machine leaves the ground
    return np.asarray(np.clip(hover * thrust + busy, 0.15, 0.8) * on)


def _rotors(t: Array, rng: Rng, throttle: Array) -> Array:
    asked = FULL_SPEED_HZ * np.sqrt(throttle)
    alpha = 1.0 - math.exp(-float(t[1] - t[0]) / 0.05)  # a motor's mechanical time constant
    speed = lfilter([alpha], [1.0, alpha - 1.0], asked, zi=[(1.0 - alpha) * asked[0]])[0]
    apart = np.stack([1.0 + smooth(t, rng, (0.1, 2.0), 0.012) + rng.normal(0, 0.008) for _ in range(ROTORS)], axis=1)
    return np.asarray(speed[:, None] * apart)


def _avionics(t: Array, rng: Rng) -> Array:
    """What flows without the rotors: electronics, and a payload (transmitter, gimbal, heater) that is switched."""
    current = 0.45 + np.abs(0.1 * smooth(t, rng, (0.2, 4.0), 1.0))
    for start in rng.uniform(0.05, 0.8, 2) * t[-1]:
        current += rng.uniform(1.0, 4.0) * window(t, start, start + rng.uniform(5.0, 15.0), 0.1)
    return np.asarray(current)


def _earth_field(rng: Rng) -> Array:
    size, dip, declination = rng.uniform(30.0, 62.0), np.radians(rng.uniform(-70, 75)), np.radians(rng.uniform(-25, 25))
    level = size * math.cos(dip)
    return np.array([level * math.cos(declination), level * math.sin(declination), size * math.sin(dip)])


def _temperature(kind: MissionKind, t: Array, rng: Rng, duration: float) -> Array:
    """Heated and cooled again where it is handled, warming up in the air; degC of the board."""
    span = rng.uniform(6.0, 26.0)
    u = t / duration
    if kind in TURNED:
        profile = np.sin(np.pi * np.clip(u / rng.uniform(0.9, 1.2), 0.0, 1.0)) ** rng.uniform(0.8, 1.6)
    else:
        profile = 1.0 - np.exp(-u / rng.uniform(0.25, 0.8))
        profile = profile + 0.15 * smooth(t, rng, (0.02, 0.08), 1.0)
    return np.asarray(rng.uniform(15.0, 38.0) + span * profile)
