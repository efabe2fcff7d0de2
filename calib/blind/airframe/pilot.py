"""The autopilot: velocity over attitude over rate, a mixer, and its own belief in the thrust curve."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mavcal.calib.blind.airframe.body import Matrix
from mavcal.calib.blind.airframe.mission import Leg, LegKind, Mission
from mavcal.calib.blind.airframe.vehicle import GRAVITY, Vector, Vehicle

MOST_TILT = math.tan(math.radians(38.0))
MOST_RATE, MOST_YAW_RATE = 4.0, 1.6  # rad/s
MOST_ACCELERATION, MOST_CLIMB_ACCELERATION = 4.5, 3.5  # m/s2, of the set-point
FLOOR = 2.5
"""m above which it keeps but for landing. Chosen, not measured, as the limits above: usual settings."""
SPOOL = 0.3
"""Of the throttle before it is airborne, 1/s."""
MOST_TRIM = 0.35
"""Of the command, by the integrators of rate."""
YAW_ROOM = 0.15
"""Of the command that yaw may always have."""
YAW_FILTER_S = 0.064
"""Of the yaw rate's error: 2.5 Hz, the default of ArduPilot's ATC_RAT_YAW_FLTE. Rotors that gain speed turn the vehicle
far stronger than their drag does, and a loop without it rings."""
_LEAST_KICK_S = 1e-3
"""For a vehicle whose rotors have no inertia of their own. Chosen, not measured: it never sets the gain."""


@dataclass(frozen=True)
class Tuning:
    """Gains and beliefs; both flights of a case have the same, as a simulator has the vehicle's parameters.

    `rate` (P by axis, s), `rate_i` and `rate_d` relative to it (1/s, s); `attitude` and `yaw` 1/s; `velocity` 1/s;
    `hover` throttle and `expo` that it believes in; `compensates` whether it corrects for the voltage.
    """

    rate: Vector
    rate_i: float
    rate_d: float
    attitude: float
    yaw: float
    velocity: float
    hover: float
    expo: float
    compensates: bool


@dataclass(frozen=True)
class Felt:
    """What the autopilot knows at one time. `body` is the rotation to north-east-down, `height` m above the ground."""

    velocity: Vector
    body: Matrix
    rate: Vector
    height: float
    grounded: bool
    voltage_ratio: float


def mixer(vehicle: Vehicle) -> list[Vector]:
    """Roll, pitch and yaw factors of each motor, the largest 0.5 an axis."""
    rows = [(-r.y, r.x, float(r.spin)) for r in vehicle.rotors]
    most = [max(abs(row[axis]) for row in rows) for axis in range(3)]
    return [(0.5 * r / most[0], 0.5 * p / most[1], 0.5 * y / most[2]) for r, p, y in rows]


class Pilot:
    """Flies `mission` and gives commands 0..1; `done` once it has."""

    def __init__(self, vehicle: Vehicle, tuning: Tuning, mission: Mission, dt: float) -> None:
        self._factors = mixer(vehicle)
        self._tuning, self._legs, self._dt = tuning, mission.legs, dt
        self._index, self._entered, self._now = 0, 0.0, 0.0
        self._heading = self._yaw = mission.heading
        self._wanted = [0.0, 0.0, 0.0]
        self._sum = [0.0, 0.0, 0.0]
        self._rate_sum = [0.0, 0.0, 0.0]
        self._last_rate = (0.0, 0.0, 0.0)
        self._slope = [0.0, 0.0, 0.0]
        self._yaw_error = 0.0
        self._throttle = 0.0
        self._airborne = False
        self._touched = 0.0

    @property
    def leg(self) -> Leg:
        """The present one."""
        return self._legs[self._index]

    @property
    def done(self) -> bool:
        """Whether the last leg is over."""
        return self._index == len(self._legs) - 1 and self._now - self._entered >= self.leg.seconds

    def step(self, felt: Felt) -> list[float]:
        """Commands for the next `dt`."""
        self._now += self._dt
        self._progress(felt)
        if self.leg.kind is LegKind.REST or self._touched > 0.3:
            return [0.0] * len(self._factors)
        if not self._airborne:
            return self._spooling(felt)
        aim, throttle = self._aim(felt)
        return self._mixed(self._torques(felt, aim), throttle, felt.voltage_ratio)

    def _progress(self, felt: Felt) -> None:
        leg, spent = self.leg, self._now - self._entered
        over = spent >= leg.seconds
        if leg.kind is LegKind.TAKE_OFF:
            over = over or felt.height >= leg.height
        if leg.kind is LegKind.LAND:
            self._touched = self._touched + self._dt if felt.grounded else 0.0
            over = over or self._touched > 1.0
        if over and self._index < len(self._legs) - 1:
            self._index += 1
            self._entered = self._now
            self._heading = self._yaw = self._yaw + self.leg.turn
            self._touched = 0.0

    def _spooling(self, felt: Felt) -> list[float]:
        """Throttle rises until it lifts; the integrators begin where that is."""
        self._throttle += SPOOL * self._dt
        if not felt.grounded:
            self._airborne = True
            self._sum[2] = -GRAVITY * (self._throttle / self._tuning.hover - 1.0)
        return self._mixed((0.0, 0.0, 0.0), self._throttle, felt.voltage_ratio)

    def _aim(self, felt: Felt) -> tuple[Vector, float]:
        """The direction that the body's down axis should have, north east down, and the throttle."""
        target = self._target(felt)
        tuning, dt = self._tuning, self._dt
        push = [0.0, 0.0, 0.0]
        for axis in range(3):
            most = (MOST_CLIMB_ACCELERATION if axis == 2 else MOST_ACCELERATION) * dt
            moved = max(-most, min(most, target[axis] - self._wanted[axis]))
            self._wanted[axis] += moved
            error = self._wanted[axis] - felt.velocity[axis]
            gain = tuning.velocity * (1.5 if axis == 2 else 1.0)
            if self.leg.kind is not LegKind.ROCK:
                self._sum[axis] += 0.4 * gain * error * dt
                self._sum[axis] = max(-5.0, min(5.0, self._sum[axis]))
            push[axis] = gain * error + self._sum[axis] + moved / dt
        lift = max(0.3 * GRAVITY, GRAVITY - push[2])
        flat = math.hypot(push[0], push[1])
        if flat > MOST_TILT * lift:
            push[0], push[1] = push[0] * MOST_TILT * lift / flat, push[1] * MOST_TILT * lift / flat
        down: Vector
        if self.leg.kind is LegKind.ROCK:
            down = self._rocked()
            return down, tuning.hover * lift / GRAVITY
        length = math.sqrt(push[0] ** 2 + push[1] ** 2 + lift**2)
        down = (-push[0] / length, -push[1] / length, lift / length)
        return down, tuning.hover * length / GRAVITY

    def _target(self, felt: Felt) -> Vector:
        """Velocity that the leg asks for, north east down."""
        leg = self.leg
        if leg.kind is LegKind.TAKE_OFF:
            return 0.0, 0.0, -2.0
        if leg.kind is LegKind.LAND:
            return 0.0, 0.0, min(2.5, max(0.35, 0.7 * (felt.height - 0.8)))
        if leg.kind is LegKind.LOW:
            return 0.0, 0.0, min(2.0, max(-0.5, 0.7 * (felt.height - leg.height)))
        forward, right, up = leg.velocity
        down = min(-up, max(0.0, 1.5 * (felt.height - FLOOR)))
        c, s = math.cos(self._heading), math.sin(self._heading)
        return c * forward - s * right, s * forward + c * right, down

    def _rocked(self) -> Vector:
        roll, pitch, side = self.leg.rock
        sign = 1.0 if self._now - self._entered < side else -1.0
        x, y = sign * math.sin(pitch), -sign * math.sin(roll)
        c, s = math.cos(self._heading), math.sin(self._heading)
        return c * x - s * y, s * x + c * y, math.sqrt(1.0 - x * x - y * y)

    def _torques(self, felt: Felt, down: Vector) -> Vector:
        """Roll, pitch and yaw for the mixer."""
        tuning, dt = self._tuning, self._dt
        (r00, r01, _), (r10, r11, _), (r20, r21, _) = felt.body
        lean_x = r00 * down[0] + r10 * down[1] + r20 * down[2]
        lean_y = r01 * down[0] + r11 * down[1] + r21 * down[2]
        off = math.remainder(self._yaw - math.atan2(r10, r00), 2.0 * math.pi)
        wanted = (
            max(-MOST_RATE, min(MOST_RATE, -tuning.attitude * lean_y)),
            max(-MOST_RATE, min(MOST_RATE, tuning.attitude * lean_x)),
            max(-MOST_YAW_RATE, min(MOST_YAW_RATE, tuning.yaw * off)),
        )
        out = [0.0, 0.0, 0.0]
        for axis in range(3):
            error = wanted[axis] - felt.rate[axis]
            if axis == 2:
                self._yaw_error += dt / (dt + YAW_FILTER_S) * (error - self._yaw_error)
                error = self._yaw_error
            most = MOST_TRIM / tuning.rate[axis]
            self._rate_sum[axis] = max(-most, min(most, self._rate_sum[axis] + tuning.rate_i * error * dt))
            slope = (felt.rate[axis] - self._last_rate[axis]) / dt
            self._slope[axis] += 0.12 * (slope - self._slope[axis])  # about 50 rad/s
            damped = tuning.rate_d * self._slope[axis] if axis < 2 else 0.0
            out[axis] = tuning.rate[axis] * (error + self._rate_sum[axis] - damped)
        self._last_rate = felt.rate
        return out[0], out[1], out[2]

    def _mixed(self, torques: Vector, throttle: float, voltage_ratio: float) -> list[float]:
        """Commands: yaw gives way to roll and pitch, and the throttle to both."""
        roll, pitch, yaw = torques
        level = [f[0] * roll + f[1] * pitch for f in self._factors]
        most, top = max(abs(x) for x in level), self._most_thrust(voltage_ratio)
        if most > 0.5 * top:
            level = [x * 0.5 * top / most for x in level]
            most = 0.5 * top
        room = max(YAW_ROOM, min(throttle, top - throttle) - most)
        turned = max(-2.0 * room, min(2.0 * room, yaw))
        parts = [x + f[2] * turned for x, f in zip(level, self._factors, strict=True)]
        throttle = max(-min(parts), min(top - max(parts), throttle)) if throttle > 0.1 else throttle
        return [self._command(throttle + x, voltage_ratio) for x in parts]

    def _most_thrust(self, voltage_ratio: float) -> float:
        """Share of full thrust beyond which a command would exceed 1, and steering with it end."""
        if not self._tuning.compensates:
            return 1.0
        return (1.0 - self._tuning.expo) * voltage_ratio + self._tuning.expo * voltage_ratio**2

    def _command(self, thrust: float, voltage_ratio: float) -> float:
        """The command that gives this share of full thrust by the curve that the autopilot believes in."""
        share, e = max(0.0, min(1.0, thrust)), self._tuning.expo
        if e > 0.0:
            share = (math.sqrt((1.0 - e) ** 2 + 4.0 * e * share) - (1.0 - e)) / (2.0 * e)
        return min(1.0, share / voltage_ratio if self._tuning.compensates else share)


def tuned(vehicles: Sequence[Vehicle], expo: float, hover_error: float, *, compensates: bool) -> Tuning:
    """Gains that fly all of `vehicles`: by the strongest torque and the longest lag among them.

    The rate loop crosses over where lag, delay and lead leave it about 60 degrees; `hover_error` is relative, of
    the believed hover throttle.
    """
    late = max(v.drive.up + v.drive.delay + v.drive.filter for v in vehicles) + 0.012
    late = max(late, *(v.drive.down + v.drive.delay + v.drive.filter + 0.012 for v in vehicles))
    slew = min(v.drive.slew for v in vehicles)
    if slew < math.inf:
        late = max(late, 0.12 / slew)  # a tenth of the command takes as long
    cross = min(24.0, 0.9 / late)
    strongest = [0.0, 0.0, 0.0]
    for v in vehicles:
        for axis, power in enumerate(authority(v)):
            strongest[axis] = max(strongest[axis], power)
    mass = max(v.hull.mass for v in vehicles)
    turning = min(0.5 * cross, 1.2 / max(_LEAST_KICK_S, *(_kick(v) for v in vehicles)))
    lift = sum(rotor.factor for rotor in vehicles[0].rotors) * vehicles[0].top_thrust
    return Tuning(
        rate=(cross / strongest[0], cross / strongest[1], turning / strongest[2]),
        rate_i=0.25 * cross,
        rate_d=0.6 * (late - 0.012),
        attitude=cross / 3.2,
        yaw=turning / 2.5,
        velocity=min(1.6, cross / 7.0),
        hover=(1.0 + hover_error) * mass * GRAVITY / lift,
        expo=expo,
        compensates=compensates,
    )


def _kick(vehicle: Vehicle) -> float:
    """Time by which the rotors' own inertia leads their drag in yaw, s: J / (2 kappa k W) in hover."""
    blade = vehicle.propeller
    strength = blade.thrust * vehicle.density
    speed = math.sqrt(vehicle.weight / (strength * len(vehicle.rotors)))
    return blade.inertia / (2.0 * blade.torque_arm * strength * speed)


def authority(vehicle: Vehicle) -> Vector:
    """Angular acceleration for a full command of each axis, rad/s2, with thrust proportional to it."""
    rows = mixer(vehicle)
    thrust, arm = vehicle.top_thrust, vehicle.propeller.torque_arm
    x = sum(-r.y * f[0] for r, f in zip(vehicle.rotors, rows, strict=True))
    y = sum(r.x * f[1] for r, f in zip(vehicle.rotors, rows, strict=True))
    z = sum(arm * r.spin * f[2] for r, f in zip(vehicle.rotors, rows, strict=True))
    ix, iy, iz = vehicle.hull.inertia
    return thrust * x / ix, thrust * y / iy, thrust * z / iz
