"""The air: density by height, steady wind, turbulence; and the battery, whose voltage sags."""

from __future__ import annotations

import math

import numpy as np

from mavcal.service.simvehicle.flight.frame import Frame
from mavcal.service.simvehicle.flight.parameters import FlightParameters

SEA_LEVEL_DENSITY = 1.225
SEA_LEVEL_PRESSURE = 101325.0
SEA_LEVEL_KELVIN = 288.15
LAPSE = 0.0065
"""International standard atmosphere (ISO 2533)."""
_BLOCK = 4096
"""Random numbers drawn at once. Chosen: a call of numpy costs as much as a hundred numbers."""
GUST_VERTICAL = 0.5
"""Ratio of vertical to horizontal gusts. Chosen, not measured: near the ground vertical gusts are smaller."""


def temperature(altitude: float) -> float:
    """Temperature of the standard atmosphere, K."""
    return SEA_LEVEL_KELVIN - LAPSE * altitude


def pressure(altitude: float) -> float:
    """Pressure of the standard atmosphere, Pa."""
    return float(SEA_LEVEL_PRESSURE * (temperature(altitude) / SEA_LEVEL_KELVIN) ** 5.2559)


def density(altitude: float) -> float:
    """Density of the standard atmosphere, kg/m3."""
    return float(SEA_LEVEL_DENSITY * (temperature(altitude) / SEA_LEVEL_KELVIN) ** 4.2559)


class Noise:
    """Standard normal numbers, one at a time, drawn in blocks."""

    def __init__(self, seed: int) -> None:
        self._draw = np.random.default_rng(seed)
        self._left: list[float] = []

    def __call__(self) -> float:
        """The next number."""
        if not self._left:
            self._left = self._draw.standard_normal(_BLOCK).tolist()
        return self._left.pop()


class Wind:
    """Velocity of the air, m/s north east down: SIM_WIND_SPD from SIM_WIND_DIR, and coloured gusts.

    SIM_WIND_TURB is the standard deviation of the horizontal gusts, m/s, and SIM_WIND_TC their time constant, s.
    """

    def __init__(self, parameters: FlightParameters, noise: Noise) -> None:
        self._noise = noise
        self._gust = [0.0, 0.0, 0.0]
        self.read(parameters)

    def read(self, parameters: FlightParameters) -> None:
        """Take the parameters in force."""
        speed, towards = parameters["SIM_WIND_SPD"], math.radians(parameters["SIM_WIND_DIR"] + 180.0)
        self._steady = (speed * math.cos(towards), speed * math.sin(towards))
        self._sd = parameters["SIM_WIND_TURB"]
        self._tau = max(parameters["SIM_WIND_TC"], 0.1)

    def advance(self, dt: float) -> tuple[float, float, float]:
        """Velocity of the air `dt` seconds later."""
        north, east = self._steady
        if self._sd <= 0.0:
            return north, east, 0.0
        keep = math.exp(-dt / self._tau)
        fresh = self._sd * math.sqrt(1.0 - keep * keep)
        gust = self._gust
        for k in range(3):
            gust[k] = keep * gust[k] + fresh * self._noise()
        return north + gust[0], east + gust[1], GUST_VERTICAL * gust[2]


_CHARGE = (0.0, 0.1, 0.2, 0.5, 0.9, 1.0)
_OPEN_CIRCUIT = (0.72, 0.83, 0.86, 0.905, 0.965, 1.0)
"""Open-circuit voltage relative to a full pack, against the remaining charge. Chosen, not measured: the curve of a
lithium polymer pack, flat in the middle."""
_VOLTAGE_FILTER_HZ = 10.0
"""``SIM_Battery.cpp``."""


class Battery:
    """Terminal voltage: SIM_BATT_VOLTAGE without a capacity, else the open-circuit voltage less I R."""

    def __init__(self, frame: Frame, parameters: FlightParameters) -> None:
        self._capacity = frame.battery_capacity
        self._resistance = frame.battery_resistance
        self._full = frame.full_voltage
        self._constant = parameters["SIM_BATT_VOLTAGE"]
        self._used = 0.0
        self.voltage = self._constant if self._capacity <= 0.0 else frame.full_voltage
        self.current = 0.0
        self.used_mah = 0.0

    def draw(self, current: float, dt: float) -> None:
        """Draw a current (A) for `dt` seconds."""
        self.current = current
        self.used_mah += current * dt / 3.6
        if self._capacity <= 0.0:
            return
        self._used += current * dt / 3600.0 / self._capacity
        charge = min(max(1.0 - self._used, 0.0), 1.0)
        wanted = _open_circuit(charge) * self._full - current * self._resistance
        self.voltage += (wanted - self.voltage) * (1.0 - math.exp(-2.0 * math.pi * _VOLTAGE_FILTER_HZ * dt))


def _open_circuit(charge: float) -> float:
    k = 1
    while charge > _CHARGE[k]:
        k += 1
    share = (charge - _CHARGE[k - 1]) / (_CHARGE[k] - _CHARGE[k - 1])
    return _OPEN_CIRCUIT[k - 1] + share * (_OPEN_CIRCUIT[k] - _OPEN_CIRCUIT[k - 1])
