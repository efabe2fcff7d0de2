"""What a model of forces and torques sees of a vehicle in hover: the numbers that labels are made of.

All of them are read off the generator's own forces. Hover is where the motors, all at one command and at the voltage of
a minute into the flight, carry the weight. Derivatives are differences about it with the rotor speeds held. The ratio
of a label is the real number over the simulated one, both at the simulated vehicle's hover voltage.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from mavcal.calib.blind.airframe.body import Body
from mavcal.calib.blind.airframe.forces import Forces, Six
from mavcal.calib.blind.airframe.pilot import mixer
from mavcal.calib.blind.airframe.vehicle import Vector, Vehicle

FAR = 1e3
"""Height above the ground where it is not felt, m."""
STILL: Vector = (0.0, 0.0, 0.0)
SPAN = 0.15
"""Of the command about hover over which the thrust curve is fitted: the span that AIRFRAME 5.8 asks a log to have."""
FASTEST = 8.0
"""Speed up to which drag and translational lift are fitted, m/s: that of the missions."""
SLOW = 1e-3
"""Speed at which the square of it does not count, m/s."""
SPENT_S = 60.0


@dataclass(frozen=True)
class Seen:
    """Everything over mass or inertia.

    Parameters
    ----------
    thrust
        m/s2 at full command, at the hover voltage, by the curve fitted about hover.
    expo
        Of that curve.
    exponent
        Of thrust in voltage.
    rotor_drag, body_drag
        1/s and 1/m: forward and sideways, mean; linear at rest, and the square that is left at the fastest speed.
    inflow
        1/s: lift lost a m/s of climb.
    lift
        1/m: lift gained a squared m/s of level flight, least squares.
    lever
        x, y: collective over differential response, m: proportional to inertia over mass and arm.
    yaw
        Yaw response over the collective one, 1/m.
    damping
        1/s, by axis.
    trim
        rad/s2 at equal commands, by axis.
    """

    thrust: float
    expo: float
    exponent: float
    rotor_drag: float
    body_drag: float
    inflow: float
    lift: float
    lever: tuple[float, float]
    yaw: float
    damping: Vector
    trim: Vector


def hover_ratio(vehicle: Vehicle) -> float:
    """Voltage over the full one, a minute into hover."""
    battery = vehicle.battery
    speed = math.sqrt(vehicle.weight / _strength(vehicle))
    power = Forces(vehicle).power([speed] * len(vehicle.rotors))
    drawn = battery.current(power, 0.0) * SPENT_S
    return battery.voltage(drawn, battery.current(power, drawn)) / battery.full


def _strength(vehicle: Vehicle) -> float:
    """Thrust of all rotors over the square of one common speed, N s2."""
    return vehicle.propeller.thrust * vehicle.density * math.fsum(rotor.factor for rotor in vehicle.rotors)


def speed_of(vehicle: Vehicle, command: float, ratio: float) -> float:
    """Steady rotor speed, rad/s."""
    drive = vehicle.drive
    return drive.top * drive.share_of_top(command) * math.pow(ratio, 0.5 * drive.exponent)


def hover_command(vehicle: Vehicle, ratio: float) -> float:
    """The command at which all motors together carry the weight."""

    def excess(command: float) -> float:
        return _strength(vehicle) * speed_of(vehicle, command, ratio) ** 2 - vehicle.weight

    return float(brentq(excess, 0.0, 1.5))


@dataclass(frozen=True)
class _Probe:
    """Forces of one vehicle about hover; None speeds are those of hover."""

    vehicle: Vehicle
    forces: Forces
    speeds: tuple[float, ...]

    def at(self, air: Vector = STILL, turn: Vector = STILL, speeds: Sequence[float] | None = None) -> Six:
        own = self.speeds if speeds is None else speeds
        return self.forces(own, [0.0] * len(own), air, turn, FAR)

    def spin(self, wrench: Six) -> np.ndarray:
        """rad/s2 of those moments."""
        inverse = np.array(Body.of(self.vehicle, 0.0).inverse)
        found: np.ndarray = inverse @ np.array(wrench[3:])
        return found


def see(vehicle: Vehicle, ratio: float | None = None) -> Seen:
    """What a model sees of it, at that voltage over the full one; None: at that of its own hover.

    Two vehicles are compared at one voltage: what their batteries do is no difference of their thrust.
    """
    ratio = hover_ratio(vehicle) if ratio is None else ratio
    command = hover_command(vehicle, ratio)
    count, mass = len(vehicle.rotors), vehicle.hull.mass
    probe = _Probe(vehicle, Forces(vehicle), (speed_of(vehicle, command, ratio),) * count)
    still = probe.at()
    thrust, expo = _curve(vehicle, command, ratio)
    linear, square = _drag(probe)
    up = [-probe.at(air=(0.0, 0.0, w))[2] for w in (-SLOW, SLOW)]
    speeds = np.linspace(1.0, FASTEST, 8)
    gained = np.array([still[2] - probe.at(air=(float(v), 0.0, 0.0))[2] for v in speeds]) / mass
    collective, answers = _responses(vehicle, probe, command, ratio)
    damping = [
        float((probe.spin(probe.at(turn=_along(axis, -0.1))) - probe.spin(probe.at(turn=_along(axis, 0.1))))[axis])
        / 0.2
        for axis in range(3)
    ]
    trim = probe.spin(still)
    return Seen(
        thrust=thrust,
        expo=expo,
        exponent=vehicle.drive.exponent,
        rotor_drag=linear,
        body_drag=square,
        inflow=(up[1] - up[0]) / (2.0 * SLOW) / mass,
        lift=float(gained @ speeds**2 / (speeds**4).sum()),
        lever=(collective / answers[0], collective / answers[1]),
        yaw=answers[2] / collective,
        damping=(damping[0], damping[1], damping[2]),
        trim=(float(trim[0]), float(trim[1]), float(trim[2])),
    )


def _along(axis: int, size: float) -> Vector:
    x, y, z = (size if k == axis else 0.0 for k in range(3))
    return x, y, z


def _curve(vehicle: Vehicle, command: float, ratio: float) -> tuple[float, float]:
    """Full thrust over mass and expo of the curve (1 - e) c + e c^2 that fits about hover."""
    c = np.linspace(max(0.05, command - SPAN), min(1.0, command + SPAN), 13)
    lift = np.array([_strength(vehicle) * speed_of(vehicle, float(x), ratio) ** 2 for x in c]) / vehicle.hull.mass
    a, b = np.linalg.lstsq(np.column_stack([c, c * c]), lift, rcond=None)[0]
    return float(a + b), float(b / (a + b))


def _drag(probe: _Probe) -> tuple[float, float]:
    linear, square = [], []
    for axis in (0, 1):
        slow = [probe.at(air=_along(axis, v))[axis] for v in (-SLOW, SLOW)]
        fast = [probe.at(air=_along(axis, v))[axis] for v in (-FASTEST, FASTEST)]
        one = (slow[0] - slow[1]) / (2.0 * SLOW)
        linear.append(one)
        square.append(((fast[0] - fast[1]) / (2.0 * FASTEST) - one) / FASTEST)
    mass = probe.vehicle.hull.mass
    return sum(linear) / 2.0 / mass, sum(square) / 2.0 / mass


def _responses(vehicle: Vehicle, probe: _Probe, command: float, ratio: float) -> tuple[float, Vector]:
    """m/s2 a unit of collective command, and rad/s2 a unit of roll, pitch and yaw by the mixer's factors."""
    step = 1e-3

    def moved(pattern: Sequence[float]) -> tuple[Six, Six]:
        low, high = (
            probe.at(speeds=[speed_of(vehicle, command + sign * step * x, ratio) for x in pattern])
            for sign in (-1.0, 1.0)
        )
        return low, high

    factors = mixer(vehicle)
    low, high = moved([1.0] * len(factors))
    collective = (low[2] - high[2]) / (2.0 * step) / vehicle.hull.mass
    turned = []
    for axis in range(3):
        low, high = moved([f[axis] for f in factors])
        turned.append(float((probe.spin(high) - probe.spin(low))[axis]) / (2.0 * step))
    return collective, (turned[0], turned[1], turned[2])
