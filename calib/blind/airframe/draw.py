"""Vehicles drawn from a seed: sizes as small drones have them, from the forces that they should show in hover."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mavcal.calib.blind.airframe.vehicle import (
    FRAMES,
    GRAVITY,
    SEA_LEVEL,
    Battery,
    Drive,
    Hull,
    Propeller,
    Vehicle,
)

Rng = np.random.Generator
Range = tuple[float, float]


@dataclass(frozen=True)
class Size:
    """A class of vehicles: ranges that are drawn from log-uniformly.

    `mass` kg, `arm` m, `radius` of the propeller over the arm, `power` full thrust over weight, `lag` s upwards.
    """

    frames: tuple[str, ...]
    mass: Range
    arm: Range
    radius: Range
    power: Range
    lag: Range


COMMON = Size(("quad-x", "quad-x", "quad-plus"), (1.1, 3.0), (0.20, 0.30), (0.50, 0.62), (1.9, 2.8), (0.018, 0.05))
"""What most owners fly: 9 to 13 inches. Source of the lags: AIRFRAME 2, typical values of the literature."""
FOREIGN = (
    Size(("quad-x",), (0.5, 0.8), (0.10, 0.13), (0.48, 0.58), (4.5, 7.0), (0.012, 0.022)),  # 5 inch racer
    Size(("quad-x",), (6.0, 14.0), (0.40, 0.60), (0.50, 0.62), (1.8, 2.3), (0.06, 0.11)),  # 18 to 28 inches
    Size(("hexa-x",), (2.5, 6.0), (0.30, 0.42), (0.38, 0.46), (1.9, 2.6), (0.03, 0.07)),
    Size(("octa-x",), (5.0, 11.0), (0.40, 0.55), (0.30, 0.36), (1.9, 2.6), (0.04, 0.08)),
)


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """Drawn so that its logarithm is uniform."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def draw_vehicle(rng: Rng, size: Size = COMMON) -> Vehicle:
    """A vehicle of that class; the forces that it shows in hover lie in the ranges of AIRFRAME 2."""
    frame = FRAMES[str(rng.choice(size.frames))]
    mass, arm = log_uniform(rng, *size.mass), log_uniform(rng, *size.arm)
    radius = arm * log_uniform(rng, *size.radius)
    up = log_uniform(rng, *size.lag)
    count = len(frame.places)
    power = log_uniform(rng, *size.power)
    tip = rng.uniform(95.0, 140.0)  # m/s of the blade tips in hover
    hover = tip / radius
    thrust = mass * GRAVITY / (count * hover**2)
    drive = Drive(
        top=hover * math.sqrt(power),
        expo=rng.uniform(0.3, 0.75),
        up=up,
        down=up * rng.uniform(1.0, 1.8),
        filter=rng.uniform(0.0005, 0.003),
        delay=0.0025 * int(rng.integers(1, 4)),
        exponent=rng.uniform(1.2, 2.0),
    )
    return Vehicle(
        frame=frame.name,
        rotors=frame.rotors(arm, rng.uniform(0.0, 0.03)),
        propeller=_propeller(rng, mass, count, hover, thrust, radius),
        drive=drive,
        battery=_battery(rng, mass, count * 0.02 * thrust * hover**3),
        hull=_hull(rng, mass, arm, count),
        density=1.0,
        ground=float(rng.choice([0.0, rng.uniform(1.0, 3.0)])),
    )


def _propeller(rng: Rng, mass: float, count: int, hover: float, thrust: float, radius: float) -> Propeller:
    per_rotor = mass / (count * hover)
    # About 6 g at 10 inches, more with the square of the radius; a slender rod about its middle.
    blade = 0.006 * (radius / 0.127) ** 2 * rng.uniform(0.8, 1.4)
    return Propeller(
        thrust=thrust,
        torque_arm=radius * rng.uniform(0.10, 0.16),
        inflow=per_rotor * rng.uniform(0.2, 0.6),
        lift=rng.uniform(0.7, 1.2),
        drag=per_rotor * log_uniform(rng, 0.15, 0.5),
        flapping=per_rotor * rng.uniform(0.002, 0.02) * radius,
        inertia=blade * radius**2 / 3.0,
        radius=radius,
    )


def _battery(rng: Rng, mass: float, shaft: float) -> Battery:
    """Full for 8 to 20 minutes of hover; internal resistance for a drop of 2 to 6 % in hover."""
    cells = 4 if mass < 4.0 else 6
    full = 4.15 * cells
    current = shaft / 0.75 / full
    return Battery(
        full=full,
        resistance=rng.uniform(0.02, 0.06) * full / current,
        capacity=current * rng.uniform(480.0, 1200.0),
        fall=0.16 * full,
    )


def _hull(rng: Rng, mass: float, arm: float, count: int) -> Hull:
    # About a quarter of the mass sits at the motors, the rest in a box of a third of the arm.
    rim, core = 0.25 * mass, 0.75 * mass
    flat = 0.5 * rim * arm**2 + core * (0.33 * arm) ** 2 / 3.0
    inertia = (flat * rng.uniform(0.8, 1.2), flat * rng.uniform(0.9, 1.4), 1.8 * flat * rng.uniform(0.85, 1.15))
    cross = flat * 0.03
    area = tuple(2.0 * mass * log_uniform(rng, 0.012, 0.05) / SEA_LEVEL for _ in range(3))
    rotary = rng.uniform(0.2, 1.0)  # 1/s beside what the rotors damp
    return Hull(
        mass=mass,
        inertia=inertia,
        products=(cross * rng.uniform(-1, 1), cross * rng.uniform(-1, 1), cross * rng.uniform(-1, 1)),
        centre=(arm * rng.uniform(-0.01, 0.01), arm * rng.uniform(-0.01, 0.01), 0.0),
        area=(area[0], area[1], area[2]),
        damping=(rotary * inertia[0], rotary * inertia[1], rotary * inertia[2]),
    )


def without_battery(vehicle: Vehicle) -> Vehicle:
    """The same at a voltage that never changes."""
    return replace(vehicle, battery=replace(vehicle.battery, resistance=0.0, fall=0.0))
