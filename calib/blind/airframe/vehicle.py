"""A vehicle as physics has it: rotors, drive, battery and hull, in SI."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

GRAVITY = 9.80665
SEA_LEVEL = 1.225
"""Density of the standard atmosphere at sea level, kg/m3."""

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Rotor:
    """Where a rotor sits about the frame's centre (m, x forward, y right, z down) and which way it turns.

    `spin` is +1 for a rotor that turns counter-clockwise seen from above: its reaction is about +z. `factor` multiplies
    thrust and torque of its propeller; `tilt` (rad) leans the thrust forward and to the right.
    """

    x: float
    y: float
    z: float
    spin: int
    factor: float = 1.0
    tilt: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Propeller:
    """Blade forces of one rotor at sea level, speed W in rad/s.

    Parameters
    ----------
    thrust
        N s2: thrust is `thrust` W^2 in still air.
    torque_arm
        m: torque over thrust.
    inflow
        N s/(rad/s m/s): thrust lost for each m/s of axial climb and rad/s.
    lift
        Share of momentum theory's gain in forward flight; 1 is Glauert's.
    drag
        N s/(rad/s m/s): H-force against the air's velocity in the rotor plane.
    flapping
        N m s/(rad/s m/s): hub moment that raises the leading edge.
    inertia
        kg m2 of rotor and bell about the shaft.
    radius
        m.
    """

    thrust: float
    torque_arm: float
    inflow: float
    lift: float
    drag: float
    flapping: float
    inertia: float
    radius: float


@dataclass(frozen=True)
class Drive:
    """Motor and speed controller: from command 0..1 to rotor speed.

    Parameters
    ----------
    top
        rad/s at full command and full voltage.
    expo
        Static thrust is (1 - expo) c + expo c^2 of the full one, as thrust stands measure it.
    back_emf
        Instead of `expo`: share of the voltage at full speed that is back-EMF; the rest feeds the load, which grows
        with the square of the speed. None: the curve of `expo`.
    up, down
        s, first order on rotor speed.
    filter
        s, first order on the command in the speed controller.
    delay
        s, pure.
    slew
        Largest change of the command, 1/s.
    exponent
        Of static thrust in voltage over full voltage.
    """

    top: float
    expo: float
    up: float
    down: float
    filter: float
    delay: float
    slew: float = math.inf
    exponent: float = 2.0
    back_emf: float | None = None

    def share_of_top(self, command: float) -> float:
        """Rotor speed at full voltage over the top speed, static."""
        if command <= 0.0:
            return 0.0
        if self.back_emf is None:
            return math.sqrt((1.0 - self.expo) * command + self.expo * command * command)
        a = self.back_emf
        return (math.sqrt(a * a + 4.0 * (1.0 - a) * command) - a) / (2.0 * (1.0 - a))


@dataclass(frozen=True)
class Battery:
    """Open-circuit voltage falls linearly with the charge that was drawn; below it is the drop over the resistance."""

    full: float  # V
    resistance: float  # ohm
    capacity: float  # C
    fall: float  # V from full to empty
    efficiency: float = 0.75  # shaft power over electrical power

    @property
    def constant(self) -> bool:
        """Whether the voltage never changes, as in simulators without a battery."""
        return self.resistance == 0.0 and self.fall == 0.0

    def voltage(self, drawn: float, current: float) -> float:
        """At the terminals, V, after `drawn` coulombs and under `current` A."""
        return self.full - self.fall * drawn / self.capacity - self.resistance * current

    def current(self, power: float, drawn: float) -> float:
        """A that give that shaft power, W: the smaller root of power = efficiency (V_oc - I R) I."""
        source = self.full - self.fall * drawn / self.capacity
        wanted = power / self.efficiency
        if self.resistance == 0.0:
            return wanted / source
        inside = max(source * source - 4.0 * self.resistance * wanted, 0.0)
        return (source - math.sqrt(inside)) / (2.0 * self.resistance)


@dataclass(frozen=True)
class Hull:
    """The rigid body.

    `inertia` and `products` (xy, xz, yz; kg m2) are about the centre of mass, which lies at `centre` (m) from the
    frame's centre. `area` is drag area C_d A (m2) along each axis, `damping` N m s, `torque` a constant moment, N m.
    `plate` is a sail: (direction from the nose, rad; C_d A, m2). `pull` is a drag linear in the velocity, N s/m.
    """

    mass: float
    inertia: Vector
    products: Vector
    centre: Vector
    area: Vector
    damping: Vector
    torque: Vector = (0.0, 0.0, 0.0)
    plate: tuple[float, float] | None = None
    pull: float = 0.0


@dataclass(frozen=True)
class Vehicle:
    """All of it. `frame` is its name, such as ``quad-x``; `density` is the air's over that at sea level.

    `ground` is the strength of the ground effect: 1 is one rotor alone after Cheeseman and Bennett (1955), several
    rotors together have more; 0: none.
    """

    frame: str
    rotors: tuple[Rotor, ...]
    propeller: Propeller
    drive: Drive
    battery: Battery
    hull: Hull
    density: float = 1.0
    ground: float = 0.0
    facts: Mapping[str, float] = field(default_factory=dict)

    @property
    def arm(self) -> float:
        """Longest distance of a rotor from the frame's centre in the rotor plane, m."""
        return max(math.hypot(rotor.x, rotor.y) for rotor in self.rotors)

    @property
    def top_thrust(self) -> float:
        """Of one rotor of factor 1 at full command and full voltage in still air, N."""
        return self.propeller.thrust * self.drive.top**2 * self.density

    @property
    def weight(self) -> float:
        """N."""
        return self.hull.mass * GRAVITY


@dataclass(frozen=True)
class Frame:
    """A layout: its name, ArduPilot's numbers of it, and (angle from the nose to the right, degrees; spin) by motor."""

    name: str
    frame_class: int
    frame_type: int
    places: tuple[tuple[float, int], ...]

    def rotors(self, arm: float, height: float) -> tuple[Rotor, ...]:
        """Rotors at `arm` m from the centre and `height` m above it."""
        return tuple(
            Rotor(arm * math.cos(math.radians(angle)), arm * math.sin(math.radians(angle)), -height, spin)
            for angle, spin in self.places
        )


FRAMES: Mapping[str, Frame] = {
    frame.name: frame
    for frame in (
        Frame("quad-x", 1, 1, ((45.0, 1), (-135.0, 1), (-45.0, -1), (135.0, -1))),
        Frame("quad-plus", 1, 0, ((90.0, 1), (-90.0, 1), (0.0, -1), (180.0, -1))),
        Frame("hexa-x", 2, 1, ((90.0, -1), (-90.0, 1), (-30.0, -1), (150.0, 1), (30.0, 1), (-150.0, -1))),
        Frame(
            "octa-x",
            3,
            1,
            (
                *((22.5, -1), (-157.5, -1), (67.5, 1), (157.5, 1)),
                *((-22.5, 1), (-112.5, 1), (-67.5, -1), (112.5, -1)),
            ),
        ),
    )
}
"""Order and spins of ArduPilot's frames. Source: libraries/AP_Motors/AP_MotorsMatrix.cpp, setup_quad_matrix,
setup_hexa_matrix, setup_octa_matrix, read at 90700977c5."""
