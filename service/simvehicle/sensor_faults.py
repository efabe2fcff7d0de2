"""Sensors that fail: stuck at their last value, not a number, or absent."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from mavcal.service.simvehicle.errors import ControlError
from mavcal.service.simvehicle.rotation import Array
from mavcal.service.simvehicle.world import ImuReading


class SensorFault(StrEnum):
    """How a sensor fails."""

    STUCK = "stuck"  # values and temperature freeze, messages and time stamps go on
    NAN = "nan"
    ABSENT = "absent"


SENSORS = ("accel", "gyro", "mag")


class SensorFaults:
    """Failing sensors, and the last reading of each that is stuck."""

    def __init__(self) -> None:
        self._faults: dict[tuple[str, int], SensorFault] = {}
        self._last: dict[tuple[str, int], Array] = {}

    def set(self, sensor: str, instance: int, fault: SensorFault) -> None:
        """Let a sensor fail from now on."""
        if sensor not in SENSORS:
            raise ControlError(f"unknown sensor {sensor!r}; known: {', '.join(SENSORS)}")
        self._faults[(sensor, instance)] = fault

    def clear(self) -> None:
        """All sensors work again."""
        self._faults.clear()

    def absent(self, sensor: str, instance: int) -> bool:
        """Whether the firmware does not see this sensor at all."""
        return self._faults.get((sensor, instance)) is SensorFault.ABSENT

    def stuck(self, sensor: str, instance: int) -> bool:
        """Whether this sensor repeats itself."""
        return self._faults.get((sensor, instance)) is SensorFault.STUCK

    def any(self, sensor: str) -> bool:
        """Whether a sensor of this kind fails."""
        return any(kind == sensor for kind, _ in self._faults)

    def fails(self, sensor: str, instance: int) -> bool:
        """Whether this sensor fails in any way."""
        return (sensor, instance) in self._faults

    def imu(self, instance: int, accel: Array, gyro: Array, temperature: Array) -> ImuReading:
        """Corrected readings of an inertial unit with the faults of its sensors applied."""
        if self.stuck("accel", instance):
            temperature = np.full_like(temperature, temperature[0])
        return ImuReading(self.apply("accel", instance, accel), self.apply("gyro", instance, gyro), temperature)

    def apply(self, sensor: str, instance: int, values: Array) -> Array:
        """Corrected readings (N, 3) of a sensor with its fault applied."""
        key = (sensor, instance)
        fault = self._faults.get(key)
        if fault is None:
            if len(values):
                self._last[key] = values[-1].copy()
            return values
        if fault is SensorFault.STUCK:
            return np.tile(self._last.setdefault(key, values[0].copy()), (len(values), 1))
        return np.full_like(values, np.nan) if fault is SensorFault.NAN else np.zeros_like(values)
