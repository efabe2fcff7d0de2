"""A flight: vehicle, air, battery and autopilot in one loop; what it records is truth and what the loop itself felt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter

from mavcal.calib.blind.airframe.body import Body, Matrix
from mavcal.calib.blind.airframe.drive import Drives, Supply
from mavcal.calib.blind.airframe.forces import Forces
from mavcal.calib.blind.airframe.mission import Mission
from mavcal.calib.blind.airframe.pilot import Felt, Pilot, Tuning
from mavcal.calib.blind.airframe.vehicle import GRAVITY, Vector, Vehicle

Array = NDArray[np.float64]

LOOP_HZ = 400
SUBSTEPS = 3
LOOP_S = 1.0 / LOOP_HZ
STEP_S = LOOP_S / SUBSTEPS
LEGS = 0.12
"""Height of the rotors above the ground when it stands, m. Chosen, not measured: that of a small quadrotor."""


@dataclass(frozen=True, eq=False)
class Events:
    """What changes in flight, by loop: (N,) or (N, motors) over the longest duration. None: nothing of that kind.

    `mass` is relative; `tilt` (N, 2) in rad of motor `tilted`; `gain` multiplies thrust; `held` is true where an output
    repeats the last command; `band` is a dead band of the speed controllers; `wake` multiplies the loss of thrust in
    a descent.
    """

    mass: Array | None = None
    tilt: Array | None = None
    tilted: int = 0
    held: NDArray[np.bool_] | None = None
    band: float = 0.0
    wake: Array | None = None


@dataclass(frozen=True, eq=False)
class Errors:
    """Of what the autopilot feels, by loop: velocity (N, 3) m/s, tilt and heading (N, 3) rad in the body, gyro (N, 3)
    rad/s before its filter, whose cutoff is `cutoff` Hz; height (N,) m.
    """

    velocity: Array
    attitude: Array
    gyro: Array
    height: Array
    cutoff: float


@dataclass(frozen=True, eq=False)
class Flown:
    """One row a loop: `t` s; truth of force and rate as means over the loop before `t`; the rest at `t`.

    `force` is the specific force at the centre of mass (m/s2), `rate` rad/s, `spin` rad/s2, in the body; `felt_rate`
    what the loop's gyro filter gave; `command` 0..1; `velocity`, `place` north east down; `attitude` w x y z; `voltage`
    V; `current` A.
    """

    t: Array
    force: Array
    rate: Array
    spin: Array
    felt_rate: Array
    command: Array
    velocity: Array
    place: Array
    attitude: Array
    voltage: Array
    current: Array
    grounded: NDArray[np.bool_]
    speeds: Array


def fly(
    vehicle: Vehicle, tuning: Tuning, mission: Mission, air: Array, errors: Errors, events: Events | None = None
) -> Flown:
    """Fly it. `air` (N, 3) and `errors` are by loop and at least as long as the mission may take."""
    events = events or Events()
    world = _World(vehicle, mission, events)
    pilot = Pilot(vehicle, tuning, mission, LOOP_S)
    gyro = LowPass(errors.cutoff)
    winds, velocity_errors = air.tolist(), errors.velocity.tolist()
    attitude_errors, gyro_errors, height_errors = errors.attitude.tolist(), errors.gyro.tolist(), errors.height.tolist()
    rows: list[tuple[float, ...]] = []
    commands = [0.0] * len(vehicle.rotors)
    for k in range(min(len(winds), round(mission.longest * LOOP_HZ))):
        if pilot.done:
            break
        body = world.body
        felt_rate = gyro.step(world.means[3:6], gyro_errors[k])
        felt = Felt(
            velocity=_sum(body.velocity, velocity_errors[k]),
            body=_turned(body.rotation, attitude_errors[k]),
            rate=felt_rate,
            height=-body.place[2] + height_errors[k],
            grounded=body.grounded,
            voltage_ratio=world.supply.ratio,
        )
        asked = pilot.step(felt)
        if events.held is None or not events.held[k]:
            commands = asked
        supply = world.supply
        state = (*body.velocity, *body.place, *body.q, supply.voltage, supply.current, float(body.grounded))
        rows.append((*state, *felt_rate, *world.means, *asked, *world.drives.speeds))
        world.step(k, commands, winds[k])
    return _flown(rows, len(vehicle.rotors))


class _World:
    """Everything but the autopilot. `means` are of force, rate and spin over the last loop."""

    def __init__(self, vehicle: Vehicle, mission: Mission, events: Events) -> None:
        self.forces = Forces(vehicle)
        self.drives = Drives(vehicle, STEP_S, events.band)
        self.supply = Supply(vehicle, self.forces)
        self.body = Body.of(vehicle, mission.heading)
        self.means = [0.0, 0.0, -GRAVITY, *[0.0] * 6]
        self._mass, self._events = vehicle.hull.mass, events

    def step(self, k: int, commands: Sequence[float], wind: Vector) -> None:
        """One loop of the autopilot."""
        events, body, drives, forces = self._events, self.body, self.drives, self.forces
        if events.mass is not None:
            body.mass = self._mass * float(events.mass[k])
        if events.tilt is not None:
            forces.tilts[events.tilted] = (float(events.tilt[k, 0]), float(events.tilt[k, 1]))
        wake = 0.0 if events.wake is None else float(events.wake[k])
        ratio = self.supply.ratio
        sums = [0.0] * 9
        for _ in range(SUBSTEPS):
            drives.step(commands, ratio)
            through = body.through(wind)
            if wake:
                forces.gain = in_wake(through, wake)
            before = body.turn
            body.step(forces(drives.speeds, drives.gaining, through, before, LEGS - body.place[2]), STEP_S)
            for axis in range(3):
                sums[axis] += body.force[axis]
                sums[3 + axis] += 0.5 * (before[axis] + body.turn[axis])
                sums[6 + axis] += body.spin[axis]
        self.supply.step(drives.speeds, LOOP_S)
        self.means = [x / SUBSTEPS for x in sums]


class LowPass:
    """Second-order Butterworth filter of three numbers at the loop's rate, as autopilots have it before their log."""

    def __init__(self, cutoff: float) -> None:
        b, a = butter(2, cutoff, fs=LOOP_HZ)
        self._b, self._a = [float(x) for x in b], [float(x) for x in a]
        self._state = [(0.0, 0.0)] * 3

    def step(self, values: Sequence[float], noise: Sequence[float]) -> Vector:
        """The next sample of the sum of both."""
        (b0, b1, b2), (_, a1, a2) = self._b, self._a
        out = []
        for axis in range(3):
            x = values[axis] + noise[axis]
            first, second = self._state[axis]
            y = b0 * x + first
            self._state[axis] = (b1 * x - a1 * y + second, b2 * x - a2 * y)
            out.append(y)
        return out[0], out[1], out[2]


def in_wake(through: Vector, strength: float) -> float:
    """Thrust over that in clean air, where a vehicle sinks into its own wake: slowly forward, fast down."""
    sinking = min(1.0, max(0.0, (through[2] - 0.8) / 1.5))
    clear = (through[0] ** 2 + through[1] ** 2) / 9.0
    return 1.0 - strength * sinking / (1.0 + clear)


def _sum(a: Sequence[float], b: Sequence[float]) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _turned(rotation: Matrix, error: Sequence[float]) -> Matrix:
    """The rotation after a small one of `error` in the body."""
    x, y, z = error
    a, b, c = [(r[0] + z * r[1] - y * r[2], r[1] - z * r[0] + x * r[2], r[2] + y * r[0] - x * r[1]) for r in rotation]
    return a, b, c


def _flown(rows: list[tuple[float, ...]], motors: int) -> Flown:
    table = np.array(rows)
    ends = np.cumsum([3, 3, 4, 1, 1, 1, 3, 3, 3, 3, motors, motors])
    velocity, place, attitude, voltage, current, grounded, felt, force, rate, spin, command, speeds = np.split(
        table, ends[:-1], axis=1
    )
    return Flown(
        t=np.arange(len(table), dtype=np.float64) * LOOP_S,
        force=force,
        rate=rate,
        spin=spin,
        felt_rate=felt,
        command=command,
        velocity=velocity,
        place=place,
        attitude=attitude,
        voltage=voltage[:, 0],
        current=current[:, 0],
        grounded=grounded[:, 0] > 0.0,
        speeds=speeds,
    )
