"""Forces and moments that the air puts on a vehicle: rotors one by one, hull, ground.

Written for one state at a time in plain numbers, because a flight asks for it more than a hundred thousand times.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from mavcal.calib.blind.airframe.vehicle import SEA_LEVEL, Vector, Vehicle

Six = tuple[float, float, float, float, float, float]

NEAREST = 0.5
"""Heights below this many radii count as it, because the source term has a pole. Chosen, not measured: a quarter of the
height at which Cheeseman and Bennett (1955) give up."""
FARTHEST = 6.0
"""Radii above which the ground is not felt: less than 0.2 % of thrust."""


class Forces:
    """What the air does to `vehicle`. `gain` multiplies every rotor's thrust: a wake, for one.

    Rotors are seen from the centre of mass. `tilts` may be changed between calls.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        hull, blade, rho = vehicle.hull, vehicle.propeller, vehicle.density
        cx, cy, cz = hull.centre
        self.tilts = [rotor.tilt for rotor in vehicle.rotors]
        self.gain = 1.0
        self._rows = [
            (r.x - cx, r.y - cy, r.z - cz, float(r.spin), r.factor * rho * blade.thrust) for r in vehicle.rotors
        ]
        self._blade = blade
        self._rho = rho
        self._drag = tuple(0.5 * rho * SEA_LEVEL * area for area in hull.area)
        self._damping, self._torque = hull.damping, hull.torque
        self._pull = rho * hull.pull
        self._plate = None
        if hull.plate is not None:
            angle, area = hull.plate
            self._plate = math.cos(angle), math.sin(angle), 0.5 * rho * SEA_LEVEL * area
        disc = math.pi * blade.radius**2
        self._induced = blade.thrust / (2.0 * SEA_LEVEL * disc * len(self._rows))
        self._ground = vehicle.ground

    def __call__(self, speeds: Sequence[float], gaining: Sequence[float], air: Vector, turn: Vector, h: float) -> Six:
        """Force (N) and moment (N m) about the centre of mass.

        Parameters
        ----------
        speeds, gaining
            Of each rotor, rad/s and rad/s2.
        air, turn
            Velocity through the air, m/s, and body rates, rad/s, both in the body.
        h
            Height of the rotors above the ground, m.
        """
        vx, vy, vz = air
        p, q, r = turn
        blade = self._blade
        inflow, drag, flap = blade.inflow * self._rho, blade.drag * self._rho, blade.flapping * self._rho
        arm, rotor_inertia = blade.torque_arm, blade.inertia
        gained = inflow * blade.lift * self._induced_loss(speeds, vx * vx + vy * vy)
        near = self.gain * self._near_ground(h)
        fx = fy = fz = mx = my = mz = spun = 0.0
        for (x, y, z, spin, thrust), (tx, ty), speed, gain in zip(self._rows, self.tilts, speeds, gaining, strict=True):
            ux, uy, uz = vx + q * z - r * y, vy + r * x - p * z, vz + p * y - q * x
            lift = near * (thrust * speed * speed + (inflow * uz + gained) * speed)
            a = tx * lift - drag * speed * ux
            b = ty * lift - drag * speed * uy
            fx += a
            fy += b
            fz -= lift
            mx -= y * lift + z * b + flap * speed * uy
            my += x * lift + z * a + flap * speed * ux
            mz += x * b - y * a + spin * (arm * lift + rotor_inertia * gain)
            spun -= spin * speed
        momentum = rotor_inertia * spun
        hx, hy, hz = self._on_hull(vx, vy, vz)
        dx, dy, dz = self._damping
        tx, ty, tz = self._torque
        return (
            fx + hx,
            fy + hy,
            fz + hz,
            mx - q * momentum - dx * p + tx,
            my + p * momentum - dy * q + ty,
            mz - dz * r + tz,
        )

    def power(self, speeds: Sequence[float]) -> float:
        """Shaft power of all rotors in still air, W."""
        arm = self._blade.torque_arm
        return sum(arm * thrust * speed**3 for (*_, thrust), speed in zip(self._rows, speeds, strict=True))

    def _induced_loss(self, speeds: Sequence[float], plane: float) -> float:
        """By how much the induced velocity falls in forward flight, m/s; `plane` is the squared speed in the disc.

        Glauert's hypothesis with a level disc: v_i^2 = sqrt(V^4/4 + v_h^4) - V^2/2.
        """
        hover = self._induced * sum(speed * speed for speed in speeds)
        if hover <= 0.0:
            return 0.0
        half = 0.5 * plane
        return math.sqrt(hover) - math.sqrt(math.sqrt(half * half + hover * hover) - half)

    def _near_ground(self, h: float) -> float:
        """Thrust over that far from the ground: Cheeseman and Bennett's source, times its strength."""
        radius = self._blade.radius
        if self._ground == 0.0 or h > FARTHEST * radius:
            return 1.0
        ratio = radius / (4.0 * max(h, NEAREST * radius))
        return 1.0 / (1.0 - self._ground * ratio * ratio)

    def _on_hull(self, vx: float, vy: float, vz: float) -> Vector:
        cx, cy, cz = self._drag
        k = self._pull
        fx, fy = -(cx * abs(vx) + k) * vx, -(cy * abs(vy) + k) * vy
        if self._plate is not None:
            nx, ny, c = self._plate
            across = nx * vx + ny * vy
            push = -c * across * abs(across)
            fx += push * nx
            fy += push * ny
        return fx, fy, -(cz * abs(vz) + k) * vz
