"""A flight on one grid: commands of the motors, motion of the vehicle, and the rows that can be judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import prev_fast_len
from scipy.interpolate import CubicSpline
from scipy.ndimage import binary_dilation
from scipy.spatial.transform import Rotation

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.airframe.answer import Geometry
from mavcal.calib.airframe.commands import MotorCommands
from mavcal.calib.airframe.signals import kept_below, spline
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

GRID_HZ: Final = 100.0
"""Rate of the common grid, Hz. Source: filters of 20 to 40 Hz; fits at 200 Hz were the same."""
CLEAR_M: Final = 1.0
"""Height above the ground, m, above which a flight counts as airborne. Chosen, not measured: above most ground
effect."""
GAP_S: Final = 0.06
"""Longest step between samples of an inertial unit or of the commands that is interpolated. Source: AIRFRAME 6, a gap
masks 0.1 s around it; 50 Hz is the slowest rate that is judged."""
REST_AGREES: Final = 0.03
"""Largest difference, m/s2, of a correct accelerometer at rest from gravity. Source: local gravity differs from the
standard by 0.03 at the poles and at the equator."""
_STATE_GAP_S: Final = 0.25
"""The same for the estimator's velocity and attitude, which change slowly. Source: logged at 10 Hz and more."""
_EDGE_S: Final = 0.1
_MARGIN_S: Final = 1.0
"""Time, s, left out after the start and before the end of the airborne span. Chosen, not measured: contact with the
ground."""
_LEAST_S: Final = 20.0
"""Shortest flight, s, that is judged. Chosen, not measured: two manoeuvres of the standard flight."""
_LIMITED_S: Final = 0.1
_LATE_S: Final = 0.5
"""Time, s, left out after a command at its limit: a rate-limited motor is still approaching it. Measured: with less, a
wrong inertia was reported beside such a motor."""
_STANDING: Final = 0.02
"""Mean command below which motors are stopped. Chosen, not measured: far below lift-off."""
_REST_S: Final = 1.0
_ROTATING: Final = 0.05
"""Rate, rad/s, below which a disarmed vehicle is at rest. Chosen, not measured: a hundredth of a flight's rates."""
CUTOFFS: Final[Mapping[Sensor, tuple[str, str]]] = {
    Sensor.ACCEL: ("INS_ACCEL_FILTER", "IMU_ACCEL_CUTOFF"),
    Sensor.GYRO: ("INS_GYRO_FILTER", "IMU_GYRO_CUTOFF"),
}
"""Parameters with the corner of each filter, Hz, of ArduPilot and of PX4."""


@dataclass(frozen=True, eq=False)
class Rest:
    """Mean specific force (3,) of each inertial unit while the vehicle stood disarmed, m/s2, and its standard error."""

    means: Mapping[int, Array]
    sd: float


@dataclass(frozen=True, eq=False)
class FlownFlight:
    """One flight on the grid `t` (N,), in body axes (FRD).

    `force` (N, 3) and `rate` (N, 3) are as logged, filtered; `acceleration` (N, 3) is the rate's derivative; `unit` is
    the inertial unit. `others` are the forces of further units (N, 3). `c` (N, n) are the commands, low-passed against
    aliasing on the grid; `velocity` (N, 3) north, east, down; `q` (N, 4) body to local. `voltage` (N,), nan where it
    was not logged; `height` (N,) above the start, nan likewise. `usable` (N,) leaves out limits, gaps and resets.
    `cutoff_hz` by sensor, 0: not filtered. `estimated`: the velocity is the estimator's, not the GPS's.
    """

    t: Array
    force: Array
    rate: Array
    acceleration: Array
    unit: int
    others: Mapping[int, Array]
    c: Array
    velocity: Array
    q: Array
    voltage: Array
    height: Array
    usable: Mask
    limited: Mask
    rest: Rest | None
    cutoff_hz: Mapping[Sensor, float]
    command_hz: float
    inertial_hz: float
    geometry: Geometry
    commands: MotorCommands
    ardupilot: bool
    estimated: bool = True

    @property
    def fs(self) -> float:
        """Rate of the grid, Hz."""
        return float(1.0 / (self.t[1] - self.t[0]))

    @property
    def has_voltage(self) -> bool:
        """Whether the battery's voltage was logged."""
        return bool(np.isfinite(self.voltage).all())

    @property
    def gravity(self) -> float:
        """Gravity, m/s2."""
        return STANDARD_GRAVITY


@dataclass(frozen=True, eq=False)
class EstimatorError:
    """By how much the vehicle's estimator was off at `t` (K,).

    `velocity` (K, 3) is its excess, m/s, north, east, down; `turn` (K, 3) is the rotation, rad, from the true attitude
    to its own, in the same axes.
    """

    t: Array
    velocity: Array
    turn: Array

    def taken_off(self, flight: FlownFlight) -> FlownFlight:
        """The flight with that error removed."""
        off, turn = (np.column_stack([np.interp(flight.t, self.t, x) for x in e.T]) for e in (self.velocity, self.turn))
        right = Rotation.from_rotvec(-turn) * Rotation.from_quat(flight.q[:, [1, 2, 3, 0]])
        return replace(flight, velocity=flight.velocity - off, q=right.as_quat()[:, [3, 0, 1, 2]])


@dataclass(frozen=True)
class Unflown:
    """Why a recording cannot be used for the airframe, and what would be needed."""

    reason: str
    need: str


LOG_BITS: Final = "LOG_BITMASK with bits 0, 2, 4, 7, 9, 10, 12, 17 and 18, LOG_DISARMED = 1"
PROFILE_BITS: Final = "SDLOG_PROFILE with bits 0 and 4 (high rate) or 3 (system identification)"


def needed_log(recording: Recording) -> str:
    """Log settings with which an airframe can be judged."""
    return PROFILE_BITS if recording.identity.autopilot == "px4" else LOG_BITS


def dropped(recording: Recording) -> float:
    """Fraction of the fastest accelerometer's samples lost by the log; 0 without an accelerometer."""
    found = [c.t for c in (*recording.channels, *recording.dynamics) if c.sensor == Sensor.ACCEL and len(c.t) > 1]
    whole = [1.0 + float(t[-1] - t[0]) / float(np.median(np.diff(t))) for t in found]
    return max((1.0 - len(t) / n for t, n in zip(found, whole, strict=True) if n == max(whole)), default=0.0)


def flown(
    recording: Recording, geometry: Geometry, commands: MotorCommands, *, from_ground: bool = False
) -> FlownFlight | Unflown:
    """The airborne span of a recording on one grid, or why there is none; `from_ground`: with take-off and landing."""
    need = needed_log(recording)
    inertial = _inertial(recording, commands)
    velocity, attitude = state_of(recording, Sensor.VELOCITY), state_of(recording, Sensor.ATTITUDE)
    if inertial is None:
        return Unflown("no accelerometer and gyroscope of one unit at 20 Hz or more", need)
    if velocity is None or attitude is None:
        return Unflown("no velocity and attitude of the estimator at 4 Hz or more", need)
    unit, accel, gyro = inertial
    span = _airborne(recording, commands, from_ground=from_ground)
    if span is None:
        return Unflown("the vehicle does not fly in this recording", "a flight of 20 s or more")
    start = max(span[0], *(c.t[0] for c in (accel, gyro, velocity, attitude)), commands.t[0])
    end = min(span[1], *(c.t[-1] for c in (accel, gyro, velocity, attitude)), commands.t[-1])
    if end - start < _LEAST_S:
        return Unflown(
            f"only {max(end - start, 0.0):.0f} s in the air with everything logged", "a flight of 20 s or more"
        )
    t = np.arange(start, end, 1.0 / GRID_HZ)
    if not from_ground:  # else the landing would be cut off
        t = t[: prev_fast_len(len(t), real=True)]
    usable = ~(
        _gaps(t, accel.t, GAP_S) | _gaps(t, gyro.t, GAP_S) | _gaps(t, commands.t, max(GAP_S, 2.5 / commands.rate_hz))
        | _gaps(t, velocity.t, _STATE_GAP_S) | _gaps(t, attitude.t, _STATE_GAP_S)
    )  # fmt: skip
    limited = _after(_wide(_held(t, commands.t, commands.limited.astype(np.float64)) > 0.5, _LIMITED_S), _LATE_S)
    turning = _curve(gyro)
    return FlownFlight(
        t=t,
        force=_curve(accel)(t),
        rate=turning(t),
        acceleration=turning(t, 1),
        unit=unit,
        others=_others(recording, unit, t),
        c=on_grid(t, commands.t, commands.c, commands.rate_hz),
        velocity=spline(velocity.t, velocity.values)(t),
        q=_turned(t, attitude),
        voltage=_voltage(recording, t),
        height=_height(recording, t),
        usable=usable & ~limited,
        limited=limited,
        rest=_at_rest(recording, commands),
        cutoff_hz=_cutoffs(recording, accel, gyro),
        command_hz=commands.rate_hz,
        inertial_hz=float(1.0 / np.median(np.diff(gyro.t))),
        geometry=geometry,
        commands=commands,
        ardupilot=recording.identity.autopilot == "ardupilot",
        estimated=any(velocity is c for c in recording.dynamics),
    )


def _inertial(recording: Recording, commands: MotorCommands) -> tuple[int, Channel, Channel] | None:
    """The fastest unit: its number, accelerometer and gyroscope."""
    found = []
    streams = (*recording.channels, *recording.dynamics)
    for unit in sorted({c.instance for c in streams if c.sensor == Sensor.ACCEL}):
        pair = []
        for sensor in (Sensor.ACCEL, Sensor.GYRO):
            own = [
                c for c in streams if c.sensor == sensor and c.instance == unit and c.unit != "counts" and len(c) > 50
            ]
            # a filtered stream has its filter named; a bare one of a driver carries no calibration
            own = [c for c in own if c.stage != Stage.RAW or recording.identity.autopilot is None]
            if own:
                pair.append(max(own, key=lambda c: len(c)))
        if len(pair) == 2 and min(_rate(c) for c in pair) >= 20.0:
            found.append((unit, pair[0], pair[1]))
    if not found:
        return None
    gyro = max((f[2] for f in found), key=_rate)
    rest = _at_rest(recording, commands)
    true = [f for f in found if rest is not None and f[0] in rest.means and abs(_off(rest.means[f[0]])) < REST_AGREES]
    # a unit that reads gravity at rest is believed before a faster one that does not
    unit, accel, _ = max(true or found, key=lambda f: _rate(f[1]))
    return unit, accel, gyro


def _off(mean: Array) -> float:
    return float(np.linalg.norm(mean)) - STANDARD_GRAVITY


def _rate(channel: Channel) -> float:
    step = float(np.median(np.diff(channel.t))) if len(channel) > 1 else np.inf
    return 1.0 / step if step > 0.0 else 0.0


def state_of(recording: Recording, sensor: Sensor) -> Channel | None:
    """The estimator's series, or else that of the GPS or of the attitude message."""
    own = [c for c in recording.dynamics if c.sensor == sensor]
    every = own or [c for c in recording.channels if c.sensor == sensor]
    good = [c for c in every if len(c) > 10 and _rate(c) >= 4.0]
    if sensor == Sensor.ATTITUDE:  # the attitude message may be faster than the estimator's quaternion
        good += [c for c in recording.channels if c.sensor == sensor and len(c) > 10 and _rate(c) >= 4.0]
    return max(good, key=lambda c: round(_rate(c))) if good else None


def _airborne(recording: Recording, commands: MotorCommands, *, from_ground: bool) -> tuple[float, float] | None:
    """The longest span, armed, with running motors and above the ground; or from the motors' start to their stop."""
    t, lift = commands.t, commands.c.mean(axis=1)
    running = lift > 0.02
    for event in recording.events:
        if event.kind == "disarmed":
            later = [e.t for e in recording.events if e.kind == "armed" and e.t > event.t]
            running &= ~((t >= event.t) & (t < min(later, default=np.inf)))
    if not running.any():
        return None
    if not from_ground:
        running &= lift > 0.5 * float(np.median(lift[running]))
        height = _height(recording, t)
        if np.isfinite(height).any():
            running &= np.nan_to_num(height, nan=0.0) > CLEAR_M
        else:
            running &= _between_passes(recording, t)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], running, [False]]).astype(np.int8)))
    spans = list(zip(edges[::2], edges[1::2], strict=True))
    if not spans:
        return None
    merged = [spans[0]]
    for first, last in spans[1:]:  # a motor that stops for a moment does not end a flight
        if t[first] - t[merged[-1][1] - 1] < _MARGIN_S:
            merged[-1] = (merged[-1][0], last)
        else:
            merged.append((first, last))
    first, last = max(merged, key=lambda s: t[s[1] - 1] - t[s[0]])
    margin = 0.0 if from_ground else _MARGIN_S
    return float(t[first]) + margin, float(t[last - 1]) - margin


def _height(recording: Recording, t: Array) -> Array:
    """Height, m, above the lowest position, since a log may begin in the air; nan where no position was logged."""
    places = [c for c in recording.dynamics if c.sensor == Sensor.PLACE and len(c) > 1]
    if places:
        best = max(places, key=len)
        return np.asarray(np.interp(t, best.t, best.values[:, 2].max() - best.values[:, 2]))
    gps = [c for c in recording.channels if c.sensor == Sensor.POSITION and len(c) > 1]
    if gps:
        return np.asarray(np.interp(t, gps[0].t, gps[0].values[:, 2] - gps[0].values[:, 2].min()))
    return np.full(len(t), np.nan)


def _between_passes(recording: Recording, t: Array) -> Mask:
    """Mask from the first to the last row above the ground by a rangefinder, which may be out of range in between."""
    found = [c for c in recording.dynamics if c.sensor == Sensor.HEIGHT and (c.values[:, 0] > CLEAR_M).any()]
    if not found:
        return np.ones(len(t), dtype=bool)
    clear = found[0].t[found[0].values[:, 0] > CLEAR_M]
    return np.asarray((t >= clear[0]) & (t <= clear[-1]))


def _gaps(t: Array, stamps: Array, longest: float) -> Mask:
    """Where the nearest samples on both sides are further apart than `longest`."""
    after = np.clip(np.searchsorted(stamps, t), 1, len(stamps) - 1)
    return _wide((stamps[after] - stamps[after - 1]) > longest, _EDGE_S)


def _wide(rows: Mask, seconds: float) -> Mask:
    if not rows.any():
        return rows
    return np.asarray(binary_dilation(rows, iterations=max(int(seconds * GRID_HZ), 1)))


def _after(rows: Mask, seconds: float) -> Mask:
    """`rows`, extended by so many seconds after each."""
    last = np.maximum.accumulate(np.where(rows, np.arange(len(rows)), -len(rows)))
    return np.asarray(np.arange(len(rows)) - last <= seconds * GRID_HZ)


def _held(t: Array, stamps: Array, values: Array) -> Array:
    return np.asarray(values[np.clip(np.searchsorted(stamps, t, side="right") - 1, 0, len(stamps) - 1)])


def _curve(channel: Channel) -> CubicSpline:
    return spline(channel.t, kept_below(channel.values, _rate(channel), GRID_HZ))


def on_grid(t: Array, stamps: Array, values: Array, rate: float) -> Array:
    """`values` (M, n) at `stamps` (M,), low-passed against aliasing, on the grid (N, n)."""
    kept = kept_below(values, rate, GRID_HZ)
    return np.column_stack([np.interp(t, stamps, column) for column in kept.T])


def _turned(t: Array, attitude: Channel) -> Array:
    """Unit quaternions on the grid, by a spline after sign continuation."""
    q = attitude.values.copy()
    flips = np.concatenate([[1.0], np.sign((q[1:] * q[:-1]).sum(axis=1) + 1e-300)])
    q *= np.cumprod(flips)[:, None]
    found = spline(attitude.t, q)(t)
    return np.asarray(found / np.linalg.norm(found, axis=1)[:, None])


def _others(recording: Recording, unit: int, t: Array) -> dict[int, Array]:
    """Forces of the other units, if fast enough for the low frequencies of a flight."""
    found: dict[int, Array] = {}
    for channel in recording.channels:
        own = channel.sensor == Sensor.ACCEL and channel.instance != unit and channel.stage == Stage.FILTERED
        if own and len(channel) > 50 and _rate(channel) >= 10.0:
            found.setdefault(channel.instance, _curve(channel)(t))
    return found


def _voltage(recording: Recording, t: Array) -> Array:
    found = [c for c in recording.dynamics if c.sensor == Sensor.VOLTAGE and len(c) > 1 and c.values.max() > 1.0]
    return np.interp(t, found[0].t, found[0].values[:, 0]) if found else np.full(len(t), np.nan)


def _at_rest(recording: Recording, commands: MotorCommands) -> Rest | None:
    """Means while the motors are stopped and the vehicle is still, before and after the flight."""
    means: dict[int, list[Array]] = {}
    arm = [(e.t, e.kind == "armed") for e in recording.events if e.kind in {"armed", "disarmed"}]
    streams = (*recording.channels, *recording.dynamics)
    logged = {c.instance for c in streams if c.sensor == Sensor.ACCEL and c.stage == Stage.FILTERED}
    for accel in (c for c in streams if c.sensor == Sensor.ACCEL and c.unit != "counts"):
        if logged and accel.stage != Stage.FILTERED:
            continue
        pair = (Sensor.GYRO, accel.instance, accel.stage)
        gyro = next((c for c in streams if (c.sensor, c.instance, c.stage) == pair), None)
        if gyro is None:
            continue
        running = _held(accel.t, commands.t, commands.c.mean(axis=1)) > _STANDING
        still = ~running
        for edge in np.flatnonzero(np.diff(running.astype(np.int8))):
            still &= np.abs(accel.t - accel.t[edge]) > 1.0
        armed, since = bool(arm) and not arm[0][1], -np.inf
        for at, now in (*arm, (np.inf, False)):
            if armed:
                still &= ~((accel.t >= since - 0.5) & (accel.t < at + 2.0))
            armed, since = now, at
        turning = np.linalg.norm(np.column_stack([np.interp(accel.t, gyro.t, g) for g in gyro.values.T]), axis=1)
        still &= turning < _ROTATING
        if still.sum() * float(np.median(np.diff(accel.t))) >= _REST_S:
            means.setdefault(accel.instance, []).append(np.median(accel.values[still], axis=0))
    if not means:
        return None
    return Rest({unit: np.mean(found, axis=0) for unit, found in means.items()}, 0.01)


def _cutoffs(recording: Recording, accel: Channel, gyro: Channel) -> dict[Sensor, float]:
    parameters = recording.parameters.final()
    made = {}
    for channel in (accel, gyro):
        names = CUTOFFS[channel.sensor]
        corner = next((float(parameters[n]) for n in names if n in parameters), 0.0)
        made[channel.sensor] = corner if channel.stage == Stage.FILTERED and corner > 0.0 else 0.0
    return made
