"""Readings of the inertial units, and the estimator's state: the truth with slow errors. No filter is run.

Inertial units have the errors of SIM_*, noise, and the firmware's two-pole low-pass::

    accel  f / SIM_ACCn_SCAL + SIM_ACCn_BIAS        gyro  w (1 + SIM_GYRn_SCALE / 100) + SIM_GYRn_BIAS

(``SIM_Aircraft``, ``AP_InertialSensor_SITL.cpp``; a scale of zero means none.)
"""

from __future__ import annotations

import math

from mavcal.service.simvehicle.flight.air import Noise
from mavcal.service.simvehicle.flight.airframe import Airframe, Quaternion, euler_of
from mavcal.service.simvehicle.flight.frame import Vector
from mavcal.service.simvehicle.flight.parameters import FlightParameters

ACCEL_NOISE, GYRO_NOISE = 0.0058, 0.0004
"""Standard deviations of a raw sample, m/s2 and rad/s: those of SITL's uniform noise of +-0.01 and +-0.0007. More gyro
noise would feed back through the controller, and bias a fit of torque to commands."""
VELOCITY_ERROR, PLACE_ERROR, TILT_ERROR, HEADING_ERROR = 0.02, 0.1, 0.0007, 0.004
"""Standard deviations of the estimate, m/s, m, rad. Chosen: those of SITL's estimator in calm flight, where its
velocity is 0.02 to 0.05 m/s off."""
_ERROR_TAU = 4.0
"""Time constant of these errors, s. Chosen, not measured."""


class LowPass:
    """Three channels through the firmware's two-pole Butterworth filter (``LowPassFilter2p.cpp``)."""

    def __init__(self, rate_hz: float, cutoff_hz: float) -> None:
        self._b0 = 1.0
        self._b1 = self._b2 = self._a1 = self._a2 = 0.0
        if 0.0 < cutoff_hz < 0.5 * rate_hz:
            ohm = math.tan(math.pi * cutoff_hz / rate_hz)
            c = 1.0 + 2.0 * math.cos(0.25 * math.pi) * ohm + ohm * ohm
            self._b0 = self._b2 = ohm * ohm / c
            self._b1 = 2.0 * self._b0
            self._a1 = 2.0 * (ohm * ohm - 1.0) / c
            self._a2 = (1.0 - 2.0 * math.cos(0.25 * math.pi) * ohm + ohm * ohm) / c
        self._delays = [0.0] * 6

    def apply(self, x: float, y: float, z: float) -> Vector:
        """The filtered sample."""
        x1, x2, y1, y2, z1, z2 = self._delays
        a1, a2, b0, b1, b2 = self._a1, self._a2, self._b0, self._b1, self._b2
        x0, y0, z0 = x - a1 * x1 - a2 * x2, y - a1 * y1 - a2 * y2, z - a1 * z1 - a2 * z2
        self._delays = [x0, x1, y0, y1, z0, z1]
        return b0 * x0 + b1 * x1 + b2 * x2, b0 * y0 + b1 * y1 + b2 * y2, b0 * z0 + b1 * z1 + b2 * z2

    def settle(self, x: float, y: float, z: float) -> None:
        """Set the filter to the steady state of this sample."""
        gain = 1.0 + self._a1 + self._a2
        self._delays = [x / gain, x / gain, y / gain, y / gain, z / gain, z / gain]


class InertialUnit:
    """One accelerometer and gyroscope. `number` counts from 1, as SIM_ACC1 does."""

    def __init__(self, number: int, parameters: FlightParameters, rate_hz: float, noise: Noise) -> None:
        self._number, self._noise = number, noise
        self._accel = LowPass(rate_hz, parameters["INS_ACCEL_FILTER"])
        self._gyro = LowPass(rate_hz, parameters["INS_GYRO_FILTER"])
        self.accel: Vector = (0.0, 0.0, 0.0)
        self.gyro: Vector = (0.0, 0.0, 0.0)
        self.read(parameters)

    def read(self, parameters: FlightParameters) -> None:
        """Take the parameters in force."""
        n = self._number
        scale = parameters.vector(f"SIM_ACC{n}_SCAL")
        self._accel_gain = tuple(1.0 / (one or 1.0) for one in scale)
        self._accel_bias = parameters.vector(f"SIM_ACC{n}_BIAS")
        self._gyro_gain = tuple(1.0 + 0.01 * one for one in parameters.vector(f"SIM_GYR{n}_SCALE"))
        self._gyro_bias = parameters.vector(f"SIM_GYR{n}_BIAS")
        self._accel_sd = ACCEL_NOISE + parameters[f"SIM_ACC{n}_RND"]
        self._gyro_sd = GYRO_NOISE + parameters[f"SIM_GYR{n}_RND"]

    def settle(self, force: Vector) -> None:
        """Set the filters to the steady state at rest."""
        fx, fy, fz = (self._accel_gain[k] * force[k] + self._accel_bias[k] for k in range(3))
        self.accel, self.gyro = (fx, fy, fz), self._gyro_bias
        self._accel.settle(*self.accel)
        self._gyro.settle(*self.gyro)

    def sample(self, force: Vector, rate: list[float]) -> None:
        """One filtered reading."""
        noise, gain, bias, sd = self._noise, self._accel_gain, self._accel_bias, self._accel_sd
        self.accel = self._accel.apply(
            gain[0] * force[0] + bias[0] + sd * noise(),
            gain[1] * force[1] + bias[1] + sd * noise(),
            gain[2] * force[2] + bias[2] + sd * noise(),
        )
        gain, bias, sd = self._gyro_gain, self._gyro_bias, self._gyro_sd
        self.gyro = self._gyro.apply(
            gain[0] * rate[0] + bias[0] + sd * noise(),
            gain[1] * rate[1] + bias[1] + sd * noise(),
            gain[2] * rate[2] + bias[2] + sd * noise(),
        )


class Wander:
    """A slow error: first-order coloured noise, one number an axis."""

    def __init__(self, sd: tuple[float, ...], noise: Noise) -> None:
        self._sd, self._noise = sd, noise
        self.value = [0.0] * len(sd)

    def advance(self, dt: float) -> None:
        """Advance by `dt` seconds."""
        keep = math.exp(-dt / _ERROR_TAU)
        fresh = math.sqrt(1.0 - keep * keep)
        for k, sd in enumerate(self._sd):
            self.value[k] = keep * self.value[k] + fresh * sd * self._noise()


class Estimate:
    """Estimated attitude, velocity and position of `airframe`. World north east down, body to world."""

    def __init__(self, airframe: Airframe, noise: Noise) -> None:
        self._airframe = airframe
        sd = (*(VELOCITY_ERROR,) * 3, *(PLACE_ERROR,) * 3, TILT_ERROR, TILT_ERROR, HEADING_ERROR)
        self._errors = Wander(sd, noise)
        self.follow(resting=True)

    def wander(self, dt: float) -> None:
        """Advance the errors of attitude, velocity and position."""
        self._errors.advance(dt)

    def follow(self, *, resting: bool) -> None:
        """Take over the true state plus the errors; a vehicle at rest has none in velocity."""
        e, frame = self._errors.value, self._airframe
        share = 0.0 if resting else 1.0
        v, p = frame.velocity, frame.place
        self.velocity = [v[0] + share * e[0], v[1] + share * e[1], v[2] + share * e[2]]
        self.place = [p[0] + e[3], p[1] + e[4], p[2] + e[5]]
        w, x, y, z = frame.q
        a, b, c = 0.5 * e[6], 0.5 * e[7], 0.5 * e[8]
        self.q: Quaternion = (
            w - a * x - b * y - c * z,
            x + a * w + b * z - c * y,
            y + b * w + c * x - a * z,
            z + c * w + a * y - b * x,
        )
        self.euler = euler_of(self.q)


_METRES_PER_DEGREE = 111_319.5


def degrees_from_metres(latitude: float, longitude: float, north: float, east: float) -> tuple[float, float]:
    """Latitude and longitude at an offset north and east of a place, on a flat Earth."""
    return (
        latitude + north / _METRES_PER_DEGREE,
        longitude + east / (_METRES_PER_DEGREE * math.cos(math.radians(latitude))),
    )


def metres_from_degrees(latitude: float, longitude: float, there: float, beside: float) -> tuple[float, float]:
    """Distance north and east of a place at which latitude `there` and longitude `beside` lie; the inverse."""
    return (
        (there - latitude) * _METRES_PER_DEGREE,
        (beside - longitude) * _METRES_PER_DEGREE * math.cos(math.radians(latitude)),
    )
