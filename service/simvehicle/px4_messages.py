"""Messages of PX4, the streams that carry them, and those sent by default.

`Px4Readings` are the sensors at the instants of one tick, converted once for all messages that carry them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle.corrections import as_float32, truncated
from mavcal.service.simvehicle.px4_sensors import GAUSS_PER_UT, Px4Sensors
from mavcal.service.simvehicle.rotation import Array, body_from_ned
from mavcal.service.simvehicle.streams import px4_stream
from mavcal.service.simvehicle.telemetry import (
    AutopilotMessages,
    Block,
    Floats,
    ImuIntegers,
    Readings,
    Rows,
    Telemetry,
    make_block,
    microseconds,
    milliseconds,
    pressure_hpa,
)
from mavcal.service.simvehicle.vehicle import FlightController, MavlinkChannel

BIAS_TIME_CONSTANT_S = 8.0  # how fast a bias estimate follows the true error
BIAS_WANDER_S = 30.0
ACCEL_WANDER = 0.05  # m/s²: rms of the estimate's own wandering at rest (0.02 … 0.16 seen)
GYRO_WANDER = 2.0e-4  # rad/s
MAG_WANDER = 0.002  # Gauss
ACCEL_LIMIT = 0.4  # m/s², EKF2_ABL_LIM
G = 9.80665
MGAUSS_PER_GAUSS = 1000.0
HIGHRES_MAG_HZ = 15.0
BARO_HZ = 20.0
ACCEL_GYRO_BITS, MAG_BITS, BARO_BITS = 63, 448, 6656

CAPABILITIES = 59647
VERSION = 0x01110040
GIT_HASH = bytes([0, 0, 0, 65, 200, 120, 22, 169])
STREAM_START_S = 0.02
SENSORS = 50348079

# Hz without being asked. The simulator build's ground-station link is as recorded; a radio's is slower.
SITL_STREAMS: dict[int, float] = {
    dialect.MAVLINK_MSG_ID_ATTITUDE: 50.0,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 50.0,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 50.0,
    dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 50.0,
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0,
    dialect.MAVLINK_MSG_ID_VFR_HUD: 4.0,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    dialect.MAVLINK_MSG_ID_SCALED_PRESSURE: 1.0,
    dialect.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    dialect.MAVLINK_MSG_ID_VIBRATION: 0.1,
}
RADIO_STREAMS: dict[int, float] = {
    dialect.MAVLINK_MSG_ID_ATTITUDE: 15.0,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1.0,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    dialect.MAVLINK_MSG_ID_VFR_HUD: 4.0,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    dialect.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    dialect.MAVLINK_MSG_ID_VIBRATION: 0.1,
}


class BiasEstimate:
    """Estimate of one vector bias: follows the error of the corrected sensor, and wanders."""

    def __init__(self, wander: float, limit: float, rng: np.random.Generator) -> None:
        self._wander_sd, self._limit, self._rng = wander, limit, rng
        self._estimate = np.zeros(3)
        self._wander = np.zeros(3)
        self._time = 0.0

    def advance(self, until: float, error: Array) -> Array:
        """The estimate at a time, given the present error of the corrected sensor (3,)."""
        dt = until - self._time
        if dt > 0:
            self._time = until
            follow = 1.0 - math.exp(-dt / BIAS_TIME_CONSTANT_S)
            self._estimate = self._estimate + follow * (error - self._estimate)
            keep = math.exp(-dt / BIAS_WANDER_S)
            self._wander = keep * self._wander
            self._wander = self._wander + self._rng.normal(0, self._wander_sd * math.sqrt(1 - keep * keep), 3)
        return np.clip(self._estimate + self._wander, -self._limit, self._limit)


class Estimator:
    """The three biases that PX4 subtracts from HIGHRES_IMU, which hide the errors that a calibration looks for."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([seed, 3])
        self.accel = BiasEstimate(ACCEL_WANDER, ACCEL_LIMIT, rng)
        self.gyro = BiasEstimate(GYRO_WANDER, 1.0, rng)
        self.mag = BiasEstimate(MAG_WANDER, 1.0, rng)


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


class Px4Readings(Readings):
    """PX4's sensors at the instants of one tick.

    `estimator` and `fields` remember what went before; `armed` decides about a compensation by thrust.
    """

    def __init__(
        self, sensors: Px4Sensors, estimator: Estimator, fields: NewFields, times: list[float], *, armed: bool
    ) -> None:
        super().__init__(sensors, times)
        self._sensors, self._estimator, self._fields, self._armed = sensors, estimator, fields, armed

    def _as_integers(self, instance: int) -> ImuIntegers:
        imu, mag = self.imu(instance), self.raw_mag(instance)
        temperature = np.round(imu.temperature * 100).astype(np.int64)
        temperature[temperature == 0] = 1  # 0 would mean "no temperature"
        return (
            truncated(imu.accel, 1000.0, G).tolist(),
            truncated(imu.gyro, 1000.0).tolist(),
            mag,
            np.clip(temperature, -32768, 32767).tolist(),
        )

    def raw_mag(self, instance: int) -> Rows:
        """Raw field, mGauss."""
        rows: Rows = truncated(self._sensors.raw_mag(instance, self.state.t), MGAUSS_PER_GAUSS).tolist()
        return rows

    @cached_property
    def unbiased(self) -> tuple[Array, Array]:
        """Primary accelerometer and gyroscope minus the estimated biases.

        A wrong level (SENS_BOARD_*_OFF) turns all of them alike, which no estimator can tell from a vehicle that stands
        askew: it follows the accelerometers.
        """
        imu, ekf, end = self.imu(self._sensors.primary), self._estimator, float(self.state.t[-1])
        turn = self._sensors.level.T
        accel_bias = ekf.accel.advance(end, _error(imu.accel, self.state.force @ turn))
        gyro_bias = ekf.gyro.advance(end, _error(imu.gyro, self.state.rate @ turn))
        return imu.accel - accel_bias, imu.gyro - gyro_bias

    @cached_property
    def highres(self) -> tuple[Floats, Floats, Floats, list[int]]:
        """HIGHRES_IMU: m/s², rad/s, Gauss, and which fields are new."""
        sensors, t = self._sensors, self.state.t
        accel, gyro = self.unbiased
        tick = np.floor(t * HIGHRES_MAG_HZ + 1e-6)
        mag: Array = np.zeros((len(t), 3))
        if sensors.mags:
            mag = sensors.mag(0, tick / HIGHRES_MAG_HZ, armed=self._armed)
            true = body_from_ned(sensors.world.motion.evaluate(t)[0], sensors.world.field) * GAUSS_PER_UT
            mag = mag - self._estimator.mag.advance(float(t[-1]), _error(mag, true))
        accel_rows, gyro_rows, mag_rows = (as_float32(v).tolist() for v in (accel, gyro, mag))
        return accel_rows, gyro_rows, mag_rows, self._fields.advance(tick, np.floor(t * BARO_HZ + 1e-6))

    @cached_property
    def block(self) -> Block:
        """Attitude and the like, from the estimator."""
        accel, gyro = self.unbiased
        return make_block(self._sensors.world, self.state, accel, gyro, np.zeros(3))


def _error(measured: Array, true: Array) -> Array:
    """Mean error of a block; a sensor that fails gives the estimator nothing."""
    error = np.mean(measured - true, axis=0)
    return np.asarray(np.where(np.isfinite(error), error, 0.0))


Builder = Callable[[Px4Readings, int], Any]


class Px4Messages(AutopilotMessages[Px4Readings]):
    """Builds every message of this autopilot, on its stream or one at a time."""

    def __init__(self, vehicle: FlightController, sensors: Px4Sensors, telemetry: Telemetry) -> None:
        super().__init__(vehicle, telemetry)
        self._sensors = sensors
        self._unasked = SITL_STREAMS if vehicle.config.sitl else RADIO_STREAMS
        self._estimator, self._fields = Estimator(vehicle.config.seed), NewFields()
        self.builders |= {
            dialect.MAVLINK_MSG_ID_SCALED_IMU: self._scaled_imu(dialect.MAVLink_scaled_imu_message, 0),
            dialect.MAVLINK_MSG_ID_SCALED_IMU2: self._scaled_imu(dialect.MAVLink_scaled_imu2_message, 1),
            dialect.MAVLINK_MSG_ID_SCALED_IMU3: self._scaled_imu(dialect.MAVLink_scaled_imu3_message, 2),
            dialect.MAVLINK_MSG_ID_HIGHRES_IMU: self._highres_imu,
            dialect.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            dialect.MAVLINK_MSG_ID_HEARTBEAT: lambda _r, _i: vehicle.heartbeat(),
            dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: lambda _r, _i: self.version(),
        }

    def boot(self) -> None:
        """Reset the estimator, and start the streams that PX4 sends unasked on every channel."""
        vehicle = self._vehicle
        self._estimator, self._fields = Estimator(vehicle.config.seed + vehicle.boots), NewFields()
        for channel in vehicle.channels:
            for message_id, rate in self._unasked.items():
                channel.streams[message_id] = px4_stream(message_id, 1e6 / rate, STREAM_START_S)

    def readings(self, times: list[float]) -> Px4Readings:
        """See AutopilotMessages."""
        return Px4Readings(self._sensors, self._estimator, self._fields, times, armed=self._vehicle.armed)

    # --- streams

    def set_interval(self, channel: MavlinkChannel, message_id: int, interval_us: float) -> bool:
        """SET_MESSAGE_INTERVAL: False for a message that this build does not stream."""
        if message_id not in self.builders:
            return False
        if interval_us < 0:
            channel.streams.pop(message_id, None)
        elif interval_us == 0:
            self._default_interval(channel, message_id)
        else:
            channel.streams[message_id] = px4_stream(
                message_id, interval_us, self._vehicle.first_due(channel, message_id)
            )
        return True

    def _default_interval(self, channel: MavlinkChannel, message_id: int) -> None:
        rate = self._unasked.get(message_id)
        if rate is None:
            channel.streams.pop(message_id, None)
        else:
            channel.streams[message_id] = px4_stream(message_id, 1e6 / rate, self._vehicle.time)

    # --- messages

    def version(self) -> Any:
        """AUTOPILOT_VERSION."""
        return self._telemetry.autopilot_version(CAPABILITIES, VERSION, GIT_HASH)

    def _sys_status(self, r: Px4Readings, i: int) -> Any:
        amps = r.block.current[i]
        volts = self._telemetry.battery_volts(amps)
        # the bit of the arming checks is set only in the health mask (SYS_STATUS.hpp)
        ready = self._vehicle.armed or not self._vehicle.arming_faults()
        health = SENSORS | dialect.MAV_SYS_STATUS_PREARM_CHECK if ready else SENSORS
        return dialect.MAVLink_sys_status_message(
            SENSORS, SENSORS, health, 80, int(volts * 1000), int(amps * 100), 95, 0, 0, 0, 0, 0, 0, 0, 0, 0
        )

    def _scaled_imu(self, message_class: Any, instance: int) -> Builder:
        def build(r: Px4Readings, i: int) -> Any:
            if not self._sensors.present(instance):
                return self._mag_alone(message_class, instance, r, i)
            accel, gyro, mag, temperature = r.integers(instance)
            return message_class(milliseconds(float(r.state.t[i])), *accel[i], *gyro[i], *mag[i], temperature[i])

        return build

    def _mag_alone(self, message_class: Any, instance: int, r: Px4Readings, i: int) -> Any:
        """A magnetometer without an inertial unit of that number, sent with zeros for the rest."""
        if instance >= len(self._sensors.mags) or self._sensors.silent_mag(instance):
            return None
        mag = r.raw_mag(instance)[i]
        return message_class(milliseconds(float(r.state.t[i])), 0, 0, 0, 0, 0, 0, *mag, 0)

    def _highres_imu(self, r: Px4Readings, i: int) -> Any:
        accel, gyro, mag, updated = r.highres
        altitude = self._vehicle.config.altitude_m
        temperature = self._telemetry.baro_temperature(float(r.state.t[i]))
        return dialect.MAVLink_highres_imu_message(
            microseconds(float(r.state.t[i])), *accel[i], *gyro[i], *mag[i], pressure_hpa(altitude), 0.0, altitude,
            temperature, updated[i], 0,
        )  # fmt: skip
