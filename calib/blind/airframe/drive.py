"""From commands to rotor speeds: delay, speed controller, motor; and the battery that feeds them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from mavcal.calib.blind.airframe.forces import Forces
from mavcal.calib.blind.airframe.vehicle import Vehicle


class Drives:
    """All motors of a vehicle. `speeds` (rad/s) and `gaining` (rad/s2) are their state after the last step.

    `band` is a dead band of the speed controller: it follows a command only once that has moved by so much; 0: none.
    """

    def __init__(self, vehicle: Vehicle, dt: float, band: float = 0.0) -> None:
        drive, count = vehicle.drive, len(vehicle.rotors)
        self.speeds = [0.0] * count
        self.gaining = [0.0] * count
        self._drive, self._dt, self._band = drive, dt, band
        self._up, self._down = -math.expm1(-dt / drive.up), -math.expm1(-dt / drive.down)
        self._filter = -math.expm1(-dt / drive.filter) if drive.filter > 0.0 else 1.0
        self._step = drive.slew * dt
        self._line = deque([[0.0] * count for _ in range(round(drive.delay / dt))])
        self._taken = [0.0] * count
        self._slewed = [0.0] * count
        self._smooth = [0.0] * count

    def step(self, commands: Sequence[float], voltage_ratio: float) -> None:
        """One step of `dt` with commands 0..1 and the voltage over the full one."""
        drive, dt = self._drive, self._dt
        self._line.append(list(commands))
        wanted = self._line.popleft()
        top = drive.top * voltage_ratio ** (0.5 * drive.exponent)
        for k, target in enumerate(wanted):
            if abs(target - self._taken[k]) > self._band:
                self._taken[k] = target
            left = self._taken[k] - self._slewed[k]
            self._slewed[k] += max(-self._step, min(self._step, left))
            self._smooth[k] += self._filter * (self._slewed[k] - self._smooth[k])
            missing = top * drive.share_of_top(self._smooth[k]) - self.speeds[k]
            gained = missing * (self._up if missing > 0.0 else self._down)
            self.speeds[k] += gained
            self.gaining[k] = gained / dt


class Supply:
    """The battery over a flight: voltage (V) and current (A) after the last step."""

    def __init__(self, vehicle: Vehicle, forces: Forces) -> None:
        self._battery, self._forces = vehicle.battery, forces
        self.drawn = 0.0
        self.current = 0.0
        self.voltage = self._battery.full

    @property
    def ratio(self) -> float:
        """Voltage over the full one."""
        return self.voltage / self._battery.full

    def step(self, speeds: Sequence[float], dt: float) -> None:
        """Draw what those rotors take for `dt` s."""
        self.current = self._battery.current(self._forces.power(speeds), self.drawn)
        self.drawn += self.current * dt
        self.voltage = self._battery.voltage(self.drawn, self.current)
