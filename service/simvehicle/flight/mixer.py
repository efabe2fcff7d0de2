"""ArduCopter's way from roll, pitch, yaw and throttle to pulses.

``AP_MotorsMatrix.cpp`` and ``AP_Motors_Thrust_Linearization.cpp``: while nothing is at its limit::

    LiftMax = (1-e) b + e b^2,   b = voltage / MOT_BAT_VOLT_MAX, filtered at 0.5 Hz
    th_i    = (throttle + roll rf_i + pitch pf_i + yaw yf_i) / LiftMax / density ratio
    c_i     = ((e-1) + sqrt((1-e)^2 + 4 e LiftMax th_i)) / (2 e) / b
    pulse   = PWM_MIN + (PWM_MAX - PWM_MIN) (SPIN_MIN + (SPIN_MAX - SPIN_MIN) c_i)
"""

from __future__ import annotations

import math

from mavcal.service.simvehicle.flight.frame import Rotor
from mavcal.service.simvehicle.flight.parameters import FlightParameters

_VOLTAGE_FILTER_HZ = 0.5
_DENSITY_LIMITS = (0.5, 1.25)
_YAW_ROOM = 0.2
"""What yaw may always have of the range: MOT_YAW_HEADROOM 200."""


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
        """Pulses of motors that turn without lift: a `share` of MOT_SPIN_ARM."""
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
        """Outputs within their limits: roll and pitch first, then yaw, then the throttle nearest to the wanted one."""
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
