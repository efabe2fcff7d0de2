"""PX4's sensors at the instants of one tick, converted once for all messages that carry them."""

from __future__ import annotations

import numpy as np

from mavcal.service.simvehicle.corrections import as_float32, truncated
from mavcal.service.simvehicle.px4_ekf import Estimator
from mavcal.service.simvehicle.px4_sensors import GAUSS_PER_UT, Px4Reading, Px4Sensors
from mavcal.service.simvehicle.rotation import Array, body_from_ned
from mavcal.service.simvehicle.telemetry import Block, make_block
from mavcal.service.simvehicle.world import MotionState

G = 9.80665
MGAUSS_PER_GAUSS = 1000.0
HIGHRES_MAG_HZ = 15.0
BARO_HZ = 20.0
ACCEL_GYRO_BITS, MAG_BITS, BARO_BITS = 63, 448, 6656

Rows = list[list[int]]
Floats = list[list[float]]


class NewFields:
    """Which fields of HIGHRES_IMU are new since the last one: a magnetometer and a barometer tick more slowly."""

    def __init__(self) -> None:
        self._mag = self._baro = -1.0

    def advance(self, mag_tick: Array, baro_tick: Array) -> list[int]:
        """`fields_updated` at each instant, given the ticks that its values are of."""
        new_mag = np.diff(mag_tick, prepend=self._mag) > 0
        new_baro = np.diff(baro_tick, prepend=self._baro) > 0
        self._mag, self._baro = float(mag_tick[-1]), float(baro_tick[-1])
        bits = ACCEL_GYRO_BITS + MAG_BITS * new_mag.astype(int) + BARO_BITS * new_baro.astype(int)
        return [int(b) for b in bits]


class Px4Readings:
    """Every message of an instant carries the same sample.

    `estimator` and `fields` remember what went before; `armed` decides about a compensation by thrust.
    """

    def __init__(
        self, sensors: Px4Sensors, estimator: Estimator, fields: NewFields, times: list[float], *, armed: bool
    ) -> None:
        self._sensors, self._estimator, self._fields, self._armed = sensors, estimator, fields, armed
        self.state: MotionState = sensors.world.state(np.asarray(times))
        self._imus: dict[int, Px4Reading] = {}
        self._integers: dict[int, tuple[Rows, Rows, Rows, list[int]]] = {}
        self._unbiased: tuple[Array, Array] | None = None
        self._highres: tuple[Floats, Floats, Floats, list[int]] | None = None
        self._block: Block | None = None

    def imu(self, instance: int) -> Px4Reading:
        """One IMU's corrected readings."""
        if instance not in self._imus:
            self._imus[instance] = self._sensors.imu(instance, self.state)
        return self._imus[instance]

    def integers(self, instance: int) -> tuple[Rows, Rows, Rows, list[int]]:
        """mG, mrad/s, raw mGauss and centidegrees."""
        if instance not in self._integers:
            imu = self.imu(instance)
            mag = self._sensors.raw_mag(instance, self.state.t)
            temperature = np.round(imu.temperature * 100).astype(np.int64)
            temperature[temperature == 0] = 1  # 0 would mean "no temperature"
            self._integers[instance] = (
                truncated(imu.accel, 1000.0, G).tolist(),
                truncated(imu.gyro, 1000.0).tolist(),
                truncated(mag, MGAUSS_PER_GAUSS).tolist(),
                np.clip(temperature, -32768, 32767).tolist(),
            )
        return self._integers[instance]

    def raw_mag(self, instance: int) -> Rows:
        """Raw mGauss alone."""
        rows: Rows = truncated(self._sensors.raw_mag(instance, self.state.t), MGAUSS_PER_GAUSS).tolist()
        return rows

    def unbiased(self) -> tuple[Array, Array]:
        """Primary accelerometer and gyroscope minus what the estimator takes for bias.

        A wrong level (SENS_BOARD_*_OFF) turns all of them alike, which no estimator can tell from a vehicle that stands
        askew: it follows the accelerometers.
        """
        if self._unbiased is None:
            imu, ekf, end = self.imu(self._sensors.primary), self._estimator, float(self.state.t[-1])
            turn = self._sensors.level.T
            accel_bias = ekf.accel.advance(end, _error(imu.accel, self.state.force @ turn))
            gyro_bias = ekf.gyro.advance(end, _error(imu.gyro, self.state.rate @ turn))
            self._unbiased = (imu.accel - accel_bias, imu.gyro - gyro_bias)
        return self._unbiased

    def highres(self) -> tuple[Floats, Floats, Floats, list[int]]:
        """HIGHRES_IMU: m/s², rad/s, Gauss, and which fields are new."""
        if self._highres is None:
            sensors, t = self._sensors, self.state.t
            accel, gyro = self.unbiased()
            tick = np.floor(t * HIGHRES_MAG_HZ + 1e-6)
            mag: Array = np.zeros((len(t), 3))
            if sensors.mags:
                taken = tick / HIGHRES_MAG_HZ
                mag = sensors.mag(0, taken, armed=self._armed)
                true = body_from_ned(sensors.world.motion.evaluate(t)[0], sensors.world.field) * GAUSS_PER_UT
                mag = mag - self._estimator.mag.advance(float(t[-1]), _error(mag, true))
            accel_rows, gyro_rows, mag_rows = (as_float32(v).tolist() for v in (accel, gyro, mag))
            self._highres = (accel_rows, gyro_rows, mag_rows, self._fields.advance(tick, np.floor(t * BARO_HZ + 1e-6)))
        return self._highres

    @property
    def block(self) -> Block:
        """Attitude and the like, from the estimator."""
        if self._block is None:
            accel, gyro = self.unbiased()
            self._block = make_block(self._sensors.world, self.state, accel, gyro, np.zeros(3))
        return self._block


def _error(measured: Array, true: Array) -> Array:
    """Mean error of a block; a sensor that fails gives the estimator nothing."""
    error = np.mean(measured - true, axis=0)
    return np.asarray(np.where(np.isfinite(error), error, 0.0))
