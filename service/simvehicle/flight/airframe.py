"""The rigid body and its rotors, with SITL's equations (``SIM_Frame.cpp``, ``SIM_Motor.cpp``).

Plain floats throughout: at some hundred steps a second numpy would cost ten times as much.

::

    T_i    = rho/2 A/n [(V/V_full)^2 v_max^2 ((1-e) c + e c^2) - max(0, inflow)^2]
    drag_i = mdrag sqrt(rho disc/n) sqrt(T_i) v_i,   v_i = air velocity + omega x r_i
    body   = rho/2 CdA v|v| axis by axis
    yaw_i  = factor 0.05 diagonal c_i T_i
    near the ground, not SITL's: T_i / (1 - (radius / 4 z)^2), z = height of the rotors (Cheeseman and Bennett 1955)
"""

from __future__ import annotations

import math

from mavcal.service.simvehicle.flight.air import density
from mavcal.service.simvehicle.flight.frame import GRAVITY, YAW_PER_THRUST, Frame, Rotor, Vector
from mavcal.service.simvehicle.flight.parameters import FlightParameters

_TURN_DAMPING = math.radians(400.0)
"""Angular damping apart from the rotors', per refRotRate (``SIM_Frame.cpp``)."""
LEGS_M = 0.15
"""Height of the rotors on the ground, m. Chosen: legs of a vehicle of SITL's default size."""
Quaternion = tuple[float, float, float, float]


class Airframe:
    """Position, attitude and rates of the rigid body. World north east down, ground at 0; body forward right down."""

    def __init__(self, frame: Frame, rotors: tuple[Rotor, ...], altitude: float, heading: float) -> None:
        self._frame, self._altitude = frame, altitude
        self.q: Quaternion = (math.cos(0.5 * heading), 0.0, 0.0, math.sin(0.5 * heading))
        self.place = [0.0, 0.0, 0.0]
        self.velocity = [0.0, 0.0, 0.0]
        self.rate = [0.0, 0.0, 0.0]
        self.force: Vector = (0.0, 0.0, -GRAVITY)
        """Specific force in body axes, m/s2: reading of an ideal accelerometer at the centre of mass."""
        self.on_ground = True
        self.drives = [0.0] * len(rotors)
        self.current = 0.0
        self._multiplied = [1.0] * len(rotors)
        self._derive(frame, rotors)

    def _derive(self, frame: Frame, rotors: tuple[Rotor, ...]) -> None:
        weight = frame.mass * GRAVITY
        rho = density(frame.reference_altitude)
        power = frame.reference_current * frame.reference_voltage
        outflow = 2.0 * power / weight
        self._area = weight / (0.5 * rho * outflow * outflow * len(rotors))
        self._fastest2 = outflow * outflow / frame.hover_throttle
        self._power_per_thrust = power / weight
        tilt, speed = math.radians(frame.reference_angle), frame.reference_speed
        # In the rotors' plane, hence the cosine twice; with SITL's defaults this gives its c_2 of 0.0336 1/m.
        momentum = frame.momentum_drag * math.sqrt(rho * frame.disc_area * weight / math.cos(tilt)) * speed
        body = weight * math.tan(tilt) - momentum * math.cos(tilt) ** 2
        self._drag_area = max(body, 0.0) / (0.5 * rho * speed * speed)
        self._drag_per_rotor = frame.momentum_drag * math.sqrt(frame.disc_area / len(rotors))
        yaw = YAW_PER_THRUST * frame.diagonal_size
        self._rotors = tuple((*rotor.position, rotor.yaw_factor * yaw) for rotor in rotors)
        self._inertia = frame.inertia
        turn_rate = frame.reference_turn_rate  # 0: none of its own, as in SIM_Frame.cpp
        self._damping = _TURN_DAMPING / turn_rate if turn_rate > 0.0 else 0.0
        self._span = (frame.spin_max - frame.spin_min) * (frame.pwm_max - frame.pwm_min)
        self._idle = frame.pwm_min + frame.spin_min * (frame.pwm_max - frame.pwm_min)

    def read(self, parameters: FlightParameters) -> None:
        """Take SIM_ENGINE_FAIL and SIM_ENGINE_MUL: the outputs of these motors are multiplied above 1000 us."""
        mask, factor = int(parameters["SIM_ENGINE_FAIL"]), parameters["SIM_ENGINE_MUL"]
        self._multiplied = [factor if mask >> k & 1 else 1.0 for k in range(len(self._multiplied))]

    def advance(self, pwm: list[int], voltage: float, wind: Vector, dt: float) -> None:
        """Integrate `dt` seconds with these pulses, us, and this wind, m/s north east down."""
        frame = self._frame
        w, x, y, z = self.q
        r00, r01, r02 = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        r10, r11, r12 = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        r20, r21, r22 = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        vn, ve, vd = self.velocity
        an, ae, ad = vn - wind[0], ve - wind[1], vd - wind[2]
        u, v, s = r00 * an + r10 * ae + r20 * ad, r01 * an + r11 * ae + r21 * ad, r02 * an + r12 * ae + r22 * ad
        p, q, r = self.rate
        rho = density(self._altitude - self.place[2])
        scale = (voltage / frame.full_voltage) ** 2 * self._fastest2 * self._ground_effect()
        e, half, drag_rotor = frame.expo, 0.5 * rho * self._area, self._drag_per_rotor * math.sqrt(rho)
        change = frame.slew_max * dt
        follow = 1.0 if frame.motor_tau <= 0.0 else 1.0 - math.exp(-dt / frame.motor_tau)
        fx = fy = fz = mx = my = mz = thrusts = 0.0
        drives = self.drives
        for k, (rx, ry, rz, yaw) in enumerate(self._rotors):
            pulse = 1000.0 + self._multiplied[k] * (pwm[k] - 1000.0)
            c = min(max((pulse - self._idle) / self._span, 0.0), 1.0)
            c = drives[k] + min(max(c - drives[k], -change), change)
            c = drives[k] = drives[k] + follow * (c - drives[k])
            um, vm, sm = u + q * rz - r * ry, v + r * rx - p * rz, s + p * ry - q * rx
            thrust = scale * ((1.0 - e) * c + e * c * c)
            if sm < 0.0:
                thrust -= sm * sm
            thrust = max(thrust, 0.0) * half
            thrusts += thrust
            drag = drag_rotor * math.sqrt(thrust)
            dx, dy, dz = -drag * um, -drag * vm, -drag * sm - thrust
            fx, fy, fz = fx + dx, fy + dy, fz + dz
            mx += ry * dz - rz * dy
            my += rz * dx - rx * dz
            mz += rx * dy - ry * dx + yaw * c * thrust
        body = 0.5 * rho * self._drag_area
        mass = frame.mass
        fx, fy, fz = (fx - body * u * abs(u)) / mass, (fy - body * v * abs(v)) / mass, (fz - body * s * abs(s)) / mass
        self.current = self._power_per_thrust * thrusts / max(voltage, 1.0)
        down = GRAVITY + r20 * fx + r21 * fy + r22 * fz
        if self.on_ground and down >= 0.0:
            self._rest()
            return
        self.on_ground = False
        self.force = (fx, fy, fz)
        ix, iy, iz = self._inertia
        p += (mx / ix - self._damping * p) * dt
        q += (my / iy - self._damping * q) * dt
        r += (mz / iz - self._damping * r) * dt
        self.rate = [p, q, r]
        vn += (r00 * fx + r01 * fy + r02 * fz) * dt
        ve += (r10 * fx + r11 * fy + r12 * fz) * dt
        vd += down * dt
        self.velocity = [vn, ve, vd]
        place = self.place
        place[0] += vn * dt
        place[1] += ve * dt
        place[2] += vd * dt
        h = 0.5 * dt
        self.q = _unit(
            w - h * (x * p + y * q + z * r),
            x + h * (w * p + y * r - z * q),
            y + h * (w * q + z * p - x * r),
            z + h * (w * r + x * q - y * p),
        )
        if place[2] >= 0.0:
            self.on_ground = True
            self._rest()

    def _ground_effect(self) -> float:
        """Ratio of the thrust at the present height to the thrust far from the ground."""
        near = self._frame.ground_radius / (4.0 * (LEGS_M - self.place[2]))
        return 1.0 / (1.0 - near * near)

    def _rest(self) -> None:
        """Set the vehicle level on the ground; its heading stays."""
        w, _, _, z = self.q
        self.q = _unit(w, 0.0, 0.0, z)
        self.place[2] = 0.0
        self.velocity, self.rate, self.force = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], (0.0, 0.0, -GRAVITY)


def _unit(w: float, x: float, y: float, z: float) -> Quaternion:
    length = math.sqrt(w * w + x * x + y * y + z * z)
    return w / length, x / length, y / length, z / length


def euler_of(q: Quaternion) -> Vector:
    """Roll, pitch, yaw, rad."""
    w, x, y, z = q
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
    return roll, pitch, math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def in_body(q: Quaternion, vector: Vector) -> Vector:
    """A world vector in body axes."""
    w, x, y, z = q
    n, e, d = vector
    return (
        (1 - 2 * (y * y + z * z)) * n + 2 * (x * y + w * z) * e + 2 * (x * z - w * y) * d,
        2 * (x * y - w * z) * n + (1 - 2 * (x * x + z * z)) * e + 2 * (y * z + w * x) * d,
        2 * (x * z + w * y) * n + 2 * (y * z - w * x) * e + (1 - 2 * (x * x + y * y)) * d,
    )
