"""From velocity to attitude to body rate to pulses: the cascade of ArduCopter in its simplest form, and its mixer.

Gains have the firmware's names (PSC_VELXY_P, ATC_ANG_RLL_P, ATC_RAT_RLL_P ...). Targets of attitude are shaped, so that
the rate follows with feed-forward.

The mixer is that of ``AP_MotorsMatrix.cpp`` and ``AP_Motors_Thrust_Linearization.cpp``. While nothing is at its limit::

    LiftMax = (1-e) b + e b^2,   b = voltage / MOT_BAT_VOLT_MAX, filtered at 0.5 Hz
    th_i    = (throttle + roll rf_i + pitch pf_i + yaw yf_i) / LiftMax / density ratio
    c_i     = ((e-1) + sqrt((1-e)^2 + 4 e LiftMax th_i)) / (2 e) / b
    pulse   = PWM_MIN + (PWM_MAX - PWM_MIN) (SPIN_MIN + (SPIN_MAX - SPIN_MIN) c_i)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mavcal.service.simvehicle.flight.frame import GRAVITY, Rotor, Vector
from mavcal.service.simvehicle.flight.parameters import FlightParameters

_CENTI = math.radians(0.01)
_RATE_MOST = math.radians(220.0)
"""Highest rate of a shaped target. Chosen, not measured: below the 360 deg/s of acro."""
_FILTER_HZ = 20.0
"""Filters of the desired rate and of its derivative: ATC_RAT_RLL_FLTT, ATC_RAT_RLL_FLTD."""
_I_MOST = 0.25
_CLIMB_I = 1.0
"""PSC_ACCZ_I."""
_CLIMB_I_MOST = 5.0
"""m/s2; PSC_ACCZ_IMAX 800 cm/s2, less what would saturate the throttle."""
_SIDE_I_MOST = 3.0
_HOVER_TAU = 10.0
"""Time constant of MOT_HOVER_LEARN (``AP_MotorsMulticopter.cpp``)."""
_HOVER_LIMITS = (0.125, 0.6875)
_SIDE_JERK = 15.0
"""PSC_JERK_XY."""
_VOLTAGE_FILTER_HZ = 0.5
_DENSITY_LIMITS = (0.5, 1.25)
_YAW_ROOM = 0.2
"""Share of the range that yaw may always use: MOT_YAW_HEADROOM 200."""


def wrapped(angle: float) -> float:
    """The angle between -pi and pi."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@dataclass
class AxisShape:
    """A target angle that moves with limited rate and acceleration."""

    angle: float = 0.0
    rate: float = 0.0

    def towards(self, wanted: float, tau: float, most: float, dt: float) -> None:
        """One step; `most` is the greatest acceleration, rad/s2."""
        error = wrapped(wanted - self.angle)
        braking = math.sqrt(2.0 * most * abs(error))  # faster than that it could not stop any more
        rate = min(abs(error) / tau, _RATE_MOST, braking)
        rate = math.copysign(rate, error)
        self.rate += min(max(rate - self.rate, -most * dt), most * dt)
        self.angle = wrapped(self.angle + self.rate * dt)


class RateAxis:
    """PID of one body rate."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._integral = self._slope = self._wanted = 0.0
        self._last: float | None = None

    def read(self, parameters: FlightParameters) -> None:
        """Take the gains in force."""
        self._p, self._i, self._d = (parameters[f"ATC_RAT_{self._name}_{gain}"] for gain in "PID")

    def output(self, wanted: float, is_: float, *, hold: bool, dt: float) -> float:
        """Input of the mixer; with `hold` the integrator stands still."""
        alpha = dt / (dt + 1.0 / (2.0 * math.pi * _FILTER_HZ))
        self._wanted += alpha * (wanted - self._wanted)
        error = self._wanted - is_
        last = error if self._last is None else self._last
        self._last = error
        self._slope += alpha * ((error - last) / dt - self._slope)
        if not hold:
            self._integral = min(max(self._integral + self._i * error * dt, -_I_MOST), _I_MOST)
        return min(max(self._p * error + self._integral + self._d * self._slope, -1.0), 1.0)

    def reset(self) -> None:
        """Clear the integrators."""
        self._integral = self._slope = self._wanted = 0.0
        self._last = None


class Controller:
    """The cascade's targets and its inputs for the mixer. Angles rad, rates rad/s, velocities north east down m/s."""

    def __init__(self, parameters: FlightParameters) -> None:
        self.rates = (RateAxis("RLL"), RateAxis("PIT"), RateAxis("YAW"))
        self.shapes = (AxisShape(), AxisShape(), AxisShape())
        self.attitude = [0.0, 0.0, 0.0]
        self.wanted_rate: Vector = (0.0, 0.0, 0.0)
        self.climb_target = self.acceleration_target = 0.0
        self.outputs: Vector = (0.0, 0.0, 0.0)
        self.throttle = 0.0
        self.hover = parameters["MOT_THST_HOVER"]
        self._climb_integral = 0.0
        self._side = [0.0, 0.0]
        self._side_integral = [0.0, 0.0]
        self.read(parameters)

    def read(self, parameters: FlightParameters) -> None:
        """Take the gains in force."""
        for axis in self.rates:
            axis.read(parameters)
        self._angle_p = tuple(parameters[f"ATC_ANG_{name}_P"] for name in ("RLL", "PIT", "YAW"))
        self._angle_accel = tuple(parameters[f"ATC_ACCEL_{name}_MAX"] * _CENTI for name in "RPY")
        self._tau = parameters["ATC_INPUT_TC"]
        self._lean_most = parameters["ANGLE_MAX"] * _CENTI
        self._side_p, self._side_i = parameters["PSC_VELXY_P"], parameters["PSC_VELXY_I"]
        self._climb_p, self._climb_accel = parameters["PSC_VELZ_P"], 0.01 * parameters["WPNAV_ACCEL_Z"]
        self._side_accel = 0.01 * parameters["WPNAV_ACCEL"]
        self._learns = parameters["MOT_HOVER_LEARN"] > 0

    def reset(self, yaw: float) -> None:
        """Targets and integrators of a vehicle at rest: level, zero."""
        for axis, shape in zip(self.rates, self.shapes, strict=True):
            axis.reset()
            shape.angle = shape.rate = 0.0
        self.shapes[2].angle = yaw
        self.attitude = [0.0, 0.0, yaw]
        self._side, self._side_integral, self._climb_integral = [0.0, 0.0], [0.0, 0.0], 0.0
        self.climb_target = self.throttle = 0.0
        self.outputs = (0.0, 0.0, 0.0)

    def lifted_off(self) -> None:
        """Continue with the throttle at lift-off."""
        self._climb_integral = min(max((self.throttle / self.hover - 1.0) * GRAVITY, -_CLIMB_I_MOST), _CLIMB_I_MOST)
        self.climb_target = 0.0

    def follow_velocity(self, north: float, east: float, velocity: list[float], yaw: float, dt: float) -> None:
        """Lean so that the horizontal velocity becomes the wanted one."""
        for k, wanted in enumerate((north, east)):
            error = wanted - velocity[k]
            integral = self._side_integral[k] + self._side_i * error * dt
            self._side_integral[k] = min(max(integral, -_SIDE_I_MOST), _SIDE_I_MOST)
            accel = min(max(self._side_p * error, -self._side_accel), self._side_accel) + self._side_integral[k]
            self._side[k] += min(max(accel - self._side[k], -_SIDE_JERK * dt), _SIDE_JERK * dt)
        c, s = math.cos(yaw), math.sin(yaw)
        ahead, right = c * self._side[0] + s * self._side[1], c * self._side[1] - s * self._side[0]
        pitch = math.atan2(-ahead, GRAVITY)
        roll = math.atan2(right * math.cos(pitch), GRAVITY)
        most = self._lean_most
        self.attitude[0], self.attitude[1] = min(max(roll, -most), most), min(max(pitch, -most), most)

    def level_off(self) -> None:
        """Follow a velocity from the present one, with cleared integrators."""
        self._side = [0.0, 0.0]
        self._side_integral = [0.0, 0.0]

    def climb(self, wanted_up: float, velocity_down: float, euler: Vector, dt: float) -> None:
        """Throttle for a climb of `wanted_up` m/s."""
        step = self._climb_accel * dt
        before = self.climb_target
        self.climb_target += min(max(wanted_up - before, -step), step)
        error = self.climb_target + velocity_down
        integral = self._climb_integral + _CLIMB_I * error * dt
        self._climb_integral = min(max(integral, -_CLIMB_I_MOST), _CLIMB_I_MOST)
        feed = (self.climb_target - before) / dt
        self.acceleration_target = feed + self._climb_p * error
        lean = max(math.cos(euler[0]) * math.cos(euler[1]), 0.5)
        wanted = self.hover * (1.0 + (self.acceleration_target + self._climb_integral) / GRAVITY) / lean
        self.throttle = min(max(wanted, 0.0), 1.0)
        if self._learns and abs(velocity_down) < 0.6 and lean > 0.996 and self.throttle > 0.0:
            self.hover += dt / (dt + _HOVER_TAU) * (self.throttle - self.hover)
            self.hover = min(max(self.hover, _HOVER_LIMITS[0]), _HOVER_LIMITS[1])

    def hold_attitude(self, euler: Vector, gyro: Vector, *, limited: bool, dt: float) -> None:
        """Rates towards the desired attitude, and the mixer inputs for these rates."""
        angles, slopes = [], []
        for shape, wanted, is_, p, most in zip(
            self.shapes, self.attitude, euler, self._angle_p, self._angle_accel, strict=True
        ):
            shape.towards(wanted, self._tau, most, dt)
            slopes.append(shape.rate + p * wrapped(shape.angle - is_))
            angles.append(is_)
        sin_roll, cos_roll = math.sin(angles[0]), math.cos(angles[0])
        sin_pitch, cos_pitch = math.sin(angles[1]), math.cos(angles[1])
        self.wanted_rate = (
            slopes[0] - sin_pitch * slopes[2],
            cos_roll * slopes[1] + sin_roll * cos_pitch * slopes[2],
            -sin_roll * slopes[1] + cos_roll * cos_pitch * slopes[2],
        )
        roll, pitch, yaw = (
            axis.output(wanted, is_, hold=limited, dt=dt)
            for axis, wanted, is_ in zip(self.rates, self.wanted_rate, gyro, strict=True)
        )
        self.outputs = (roll, pitch, yaw)


class Mixer:
    """The factors of each motor, and the compensation for voltage and density."""

    def __init__(self, rotors: tuple[Rotor, ...], parameters: FlightParameters) -> None:
        roll = [math.cos(r.angle + 0.5 * math.pi) for r in rotors]
        pitch = [math.cos(r.angle) for r in rotors]
        most_roll, most_pitch = max(map(abs, roll)), max(map(abs, pitch))
        self._factors = tuple(
            (0.5 * a / most_roll, 0.5 * b / most_pitch, 0.5 * r.spin)
            for a, b, r in zip(roll, pitch, rotors, strict=True)
        )
        self.ratio = self.lift_max = 1.0
        self.limited = False
        self.read(parameters)

    def read(self, parameters: FlightParameters) -> None:
        """Take the parameters in force."""
        self._expo = min(max(parameters["MOT_THST_EXPO"], -1.0), 1.0)
        self._spin = parameters["MOT_SPIN_ARM"], parameters["MOT_SPIN_MIN"], parameters["MOT_SPIN_MAX"]
        self._pwm = parameters["MOT_PWM_MIN"], parameters["MOT_PWM_MAX"]
        self._most = parameters["MOT_BAT_VOLT_MAX"]
        self._least = max(parameters["MOT_BAT_VOLT_MIN"], 0.6 * self._most)

    def settle(self, voltage: float) -> None:
        """Set the filtered voltage to this one."""
        self.ratio = 1.0
        if self._most > self._least:
            self.ratio = min(max(voltage, self._least), self._most) / self._most
        self._lift()

    def follow(self, voltage: float, dt: float) -> None:
        """Filter the battery's voltage."""
        if self._most <= self._least:
            return
        wanted = min(max(voltage, self._least), self._most) / self._most
        share = 1.0 / (1.0 + 1.0 / (2.0 * math.pi * _VOLTAGE_FILTER_HZ * dt))
        self.ratio += share * (wanted - self.ratio)
        self._lift()

    def _lift(self) -> None:
        self.lift_max = (1.0 - self._expo) * self.ratio + self._expo * self.ratio * self.ratio

    def idle(self, share: float) -> list[int]:
        """Pulses of idling motors: a `share` of MOT_SPIN_ARM."""
        low, high = self._pwm
        return [int(low + (high - low) * self._spin[0] * share)] * len(self._factors)

    def pulses(self, roll: float, pitch: float, yaw: float, *, throttle: float, density_ratio: float) -> list[int]:
        """Pulses, us, as integers."""
        gain = 1.0 / self.lift_max / min(max(density_ratio, _DENSITY_LIMITS[0]), _DENSITY_LIMITS[1])
        th = [gain * (throttle + roll * rf + pitch * pf + yaw * yf) for rf, pf, yf in self._factors]
        low, high = min(th), max(th)
        self.limited = low < 0.0 or high > 1.0
        if self.limited:
            th = self._within(gain * roll, gain * pitch, gain * yaw, gain * throttle)
        return [self._pulse(one) for one in th]

    def _within(self, roll: float, pitch: float, yaw: float, throttle: float) -> list[float]:
        """Outputs within their limits: roll and pitch first, then yaw, then the throttle closest to the desired one."""
        tilt = [roll * rf + pitch * pf for rf, pf, _ in self._factors]
        tilt_scale = min(1.0, (1.0 - _YAW_ROOM) / max(max(tilt) - min(tilt), 1e-9))
        room = max(1.0 - tilt_scale * (max(tilt) - min(tilt)), _YAW_ROOM)
        yaw = min(max(yaw, -room), room)
        mixed = [tilt_scale * a + yaw * yf for a, (_, _, yf) in zip(tilt, self._factors, strict=True)]
        scale = min(1.0, 1.0 / max(max(mixed) - min(mixed), 1e-9))
        mixed = [scale * one for one in mixed]
        throttle = min(max(throttle, -min(mixed)), 1.0 - max(mixed))
        return [throttle + one for one in mixed]

    def _pulse(self, thrust: float) -> int:
        e, lift = self._expo, self.lift_max
        if e == 0.0:
            c = lift * thrust / self.ratio
        else:
            c = ((e - 1.0) + math.sqrt(max((1.0 - e) ** 2 + 4.0 * e * lift * thrust, 0.0))) / (2.0 * e) / self.ratio
        _, spin_min, spin_max = self._spin
        low, high = self._pwm
        return int(low + (high - low) * (spin_min + (spin_max - spin_min) * min(max(c, 0.0), 1.0)))
