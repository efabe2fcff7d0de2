"""ArduPilot's sensors at the instants of one tick, converted once for all messages that carry them."""

from __future__ import annotations

import numpy as np

from mavcal.service.simvehicle.ardupilot_ekf import TiltEstimate
from mavcal.service.simvehicle.ardupilot_sensors import ArduPilotSensors, ImuReading
from mavcal.service.simvehicle.corrections import as_float32, truncated
from mavcal.service.simvehicle.rotation import euler_from_quaternions
from mavcal.service.simvehicle.telemetry import Block, make_block
from mavcal.service.simvehicle.world import MotionState

G = 9.80665
MAG_DEFECT = 1000.0  # mGauss times this, where Gauss would be mGauss divided by it

Rows = list[list[int]]
Floats = list[list[float]]


class Readings:
    """The sensors at the instants of one tick: every message of an instant carries the same sample."""

    def __init__(self, sensors: ArduPilotSensors, tilt: TiltEstimate, times: list[float]) -> None:
        self._sensors, self._tilt = sensors, tilt
        self.state: MotionState = sensors.world.state(np.asarray(times))
        self._imus: dict[int, ImuReading] = {}
        self._integers: dict[int, tuple[Rows, Rows, Rows, list[int]]] = {}
        self._floats: tuple[Floats, ...] | None = None
        self._euler: list[list[float]] | None = None
        self._block: Block | None = None

    def imu(self, instance: int) -> ImuReading:
        """One IMU's corrected readings."""
        if instance not in self._imus:
            self._imus[instance] = self._sensors.imu(instance, self.state)
        return self._imus[instance]

    @property
    def block(self) -> Block:
        """Attitude and the like."""
        if self._block is None:
            sensors = self._sensors
            primary, trim = self.imu(sensors.primary), sensors.table.vector("AHRS_TRIM")
            force = self._tilt.unbiased(primary.accel)
            self._block = make_block(sensors.world, self.state, force, primary.gyro, trim)
        return self._block

    def integers(self, instance: int) -> tuple[Rows, Rows, Rows, list[int]]:
        """mG, mrad/s, mGauss and centidegrees as the C++ casts make them."""
        if instance not in self._integers:
            imu = self.imu(instance)
            mag = self._sensors.compass(instance, self.state.t)
            self._integers[instance] = (
                truncated(imu.accel, 1000.0, G).tolist(),
                truncated(imu.gyro, 1000.0).tolist(),
                truncated(mag, 1.0).tolist(),
                truncated(imu.temperature, 100.0).tolist(),
            )
        return self._integers[instance]

    def floats(self) -> tuple[Floats, ...]:
        """HIGHRES_IMU of the primary: its magnetometer in Gauss, or a million times that."""
        if self._floats is None:
            sensors = self._sensors
            imu = self.imu(sensors.primary)
            factor = MAG_DEFECT if sensors.world.config.highres_mag_defect else 1.0 / MAG_DEFECT
            mag = sensors.compass(0, self.state.t) * factor
            self._floats = tuple(as_float32(v).tolist() for v in (imu.accel, imu.gyro, mag))
        return self._floats

    def true_euler(self) -> list[list[float]]:
        """True roll, pitch, yaw."""
        if self._euler is None:
            self._euler = euler_from_quaternions(self.state.q).tolist()
        return self._euler
