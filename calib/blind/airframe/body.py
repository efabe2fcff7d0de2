"""The rigid body: Newton and Euler, and flat ground below."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.blind.airframe.vehicle import GRAVITY, Vector, Vehicle

Array = NDArray[np.float64]
Matrix = tuple[Vector, Vector, Vector]

GROUND_S = 0.03
"""Time in which the ground takes up a motion, s. Chosen, not measured: rubber feet."""
LEVELLING = 8.0
"""With which flat ground levels what stands on it, 1/s. Chosen, not measured: within half a second."""


@dataclass
class Body:
    """State of the rigid body, which stands on the ground at first: velocity (m/s) and place (m) north east down.

    `turn` (rad/s), `force` (specific, m/s2) and `spin` (rad/s2) are of the last step, in the body.
    """

    mass: float
    inertia: Matrix
    inverse: Matrix
    velocity: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    place: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    q: list[float] = field(default_factory=lambda: [1.0, 0.0, 0.0, 0.0])
    turn: Vector = (0.0, 0.0, 0.0)
    rotation: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    force: Vector = (0.0, 0.0, -GRAVITY)
    spin: Vector = (0.0, 0.0, 0.0)
    grounded: bool = True

    @classmethod
    def of(cls, vehicle: Vehicle, heading: float) -> Body:
        """Of a vehicle at rest with its nose at `heading`, rad."""
        (ix, iy, iz), (xy, xz, yz) = vehicle.hull.inertia, vehicle.hull.products
        tensor = np.array([[ix, xy, xz], [xy, iy, yz], [xz, yz, iz]])
        body = cls(vehicle.hull.mass, _rows(tensor), _rows(np.linalg.inv(tensor)))
        body.q = [math.cos(0.5 * heading), 0.0, 0.0, math.sin(0.5 * heading)]
        body.rotation = rotation_of(*body.q)
        return body

    def through(self, wind: Vector) -> Vector:
        """Velocity through the air, in the body."""
        if self.grounded:
            return 0.0, 0.0, 0.0
        a, b, c = self.velocity[0] - wind[0], self.velocity[1] - wind[1], self.velocity[2] - wind[2]
        (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = self.rotation
        return r00 * a + r10 * b + r20 * c, r01 * a + r11 * b + r21 * c, r02 * a + r12 * b + r22 * c

    def step(self, wrench: tuple[float, ...], dt: float) -> None:
        """Semi-implicit Euler; the attitude by the mean of the rates before and after."""
        (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = self.rotation
        fx, fy, fz = wrench[0] / self.mass, wrench[1] / self.mass, wrench[2] / self.mass
        an = r00 * fx + r01 * fy + r02 * fz
        ae = r10 * fx + r11 * fy + r12 * fz
        ad = r20 * fx + r21 * fy + r22 * fz + GRAVITY
        v, x = self.velocity, self.place
        p, q, r = self.turn
        self.grounded = x[2] >= 0.0 and ad > -0.05
        if self.grounded:
            an, ae, ad = -v[0] / GROUND_S, -v[1] / GROUND_S, -max(v[2], 0.0) / GROUND_S
            fx = r00 * an + r10 * ae + r20 * (ad - GRAVITY)
            fy = r01 * an + r11 * ae + r21 * (ad - GRAVITY)
            fz = r02 * an + r12 * ae + r22 * (ad - GRAVITY)
            # Flat ground levels it.
            self.spin = (-LEVELLING * r21 - p) / GROUND_S, (LEVELLING * r20 - q) / GROUND_S, -r / GROUND_S
        else:
            self.spin = self._angular(wrench[3], wrench[4], wrench[5])
        self.force = fx, fy, fz
        self.turn = p + self.spin[0] * dt, q + self.spin[1] * dt, r + self.spin[2] * dt
        for axis, a in enumerate((an, ae, ad)):
            x[axis] += (v[axis] + 0.5 * a * dt) * dt
            v[axis] += a * dt
        if self.grounded:
            x[2] = max(0.0, min(x[2], 0.002))
        half = 0.25 * dt
        self._turn_by((p + self.turn[0]) * half, (q + self.turn[1]) * half, (r + self.turn[2]) * half)

    def _angular(self, mx: float, my: float, mz: float) -> Vector:
        """Euler's equation."""
        p, q, r = self.turn
        i0, i1, i2 = self.inertia
        hx = i0[0] * p + i0[1] * q + i0[2] * r
        hy = i1[0] * p + i1[1] * q + i1[2] * r
        hz = i2[0] * p + i2[1] * q + i2[2] * r
        mx, my, mz = mx - q * hz + r * hy, my - r * hx + p * hz, mz - p * hy + q * hx
        j0, j1, j2 = self.inverse
        return (
            j0[0] * mx + j0[1] * my + j0[2] * mz,
            j1[0] * mx + j1[1] * my + j1[2] * mz,
            j2[0] * mx + j2[1] * my + j2[2] * mz,
        )

    def _turn_by(self, x: float, y: float, z: float) -> None:
        """Turn by half angles x, y, z about the body's axes."""
        w = 1.0 - 0.5 * (x * x + y * y + z * z)
        a, b, c, d = self.q
        a, b, c, d = (
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        )
        size = 1.0 / math.sqrt(a * a + b * b + c * c + d * d)
        self.q = [a * size, b * size, c * size, d * size]
        self.rotation = rotation_of(*self.q)


def _rows(matrix: Array) -> Matrix:
    a, b, c = (tuple(float(x) for x in row) for row in matrix)
    return a, b, c  # type: ignore[return-value]


def rotation_of(w: float, x: float, y: float, z: float) -> Matrix:
    """From the body to the world, of a unit quaternion."""
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
