"""Messages of ArduPilot, and the streams that carry them.

`ArduPilotReadings` are the sensors at the instants of one tick, converted once for all messages that carry them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle.ardupilot_sensors import ArduPilotSensors
from mavcal.service.simvehicle.corrections import as_float32, truncated
from mavcal.service.simvehicle.rotation import Array, body_from_ned, euler_from_quaternions
from mavcal.service.simvehicle.streams import ardupilot_interval_ms, ardupilot_stream
from mavcal.service.simvehicle.telemetry import (
    AutopilotMessages,
    Block,
    Floats,
    ImuIntegers,
    Readings,
    Telemetry,
    make_block,
    microseconds,
    milliseconds,
    pressure_hpa,
)
from mavcal.service.simvehicle.vehicle import FlightController, MavlinkChannel

BIAS_STEP_S = 0.1  # vehicle time between two looks at the accelerometer
BIAS_TIME_CONSTANT_S = 8.0  # a third of 0.38 m/s² was left after 8 s upright, as captured
UPRIGHT = 0.8  # |cosine| between an axis and the vertical from which its bias is learned
BIAS_LIMIT = 1.0  # m/s², EK3_ACC_BIAS_LIM
G = 9.80665
MAG_DEFECT = 1000.0  # mGauss times this, where Gauss would be mGauss divided by it

CAPABILITIES = 64495
VERSION = 0x04070000
GIT_HASH = b"90700977"
HIGHRES_FIELDS = 0x1FFF
SENSORS_HEALTH = 1196530703
SENSORS_PRESENT = 1399979023
SENSORS_ENABLED = 1380031503
RAW_SENSORS_GROUP = (
    dialect.MAVLINK_MSG_ID_RAW_IMU,
    dialect.MAVLINK_MSG_ID_SCALED_IMU2,
    dialect.MAVLINK_MSG_ID_SCALED_IMU3,
    dialect.MAVLINK_MSG_ID_SCALED_PRESSURE,
)
STREAM_GROUPS: dict[int, tuple[int, ...]] = {
    dialect.MAV_DATA_STREAM_RAW_SENSORS: RAW_SENSORS_GROUP,
    dialect.MAV_DATA_STREAM_EXTENDED_STATUS: (
        dialect.MAVLINK_MSG_ID_SYS_STATUS,
        dialect.MAVLINK_MSG_ID_GPS_RAW_INT,
    ),
    dialect.MAV_DATA_STREAM_POSITION: (
        dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    ),
    dialect.MAV_DATA_STREAM_RAW_CONTROLLER: (dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,),
    dialect.MAV_DATA_STREAM_EXTRA1: (dialect.MAVLINK_MSG_ID_ATTITUDE, dialect.MAVLINK_MSG_ID_SIMSTATE),
    dialect.MAV_DATA_STREAM_EXTRA2: (dialect.MAVLINK_MSG_ID_VFR_HUD,),
    dialect.MAV_DATA_STREAM_EXTRA3: (
        dialect.MAVLINK_MSG_ID_SYSTEM_TIME,
        dialect.MAVLINK_MSG_ID_BATTERY_STATUS,
        dialect.MAVLINK_MSG_ID_VIBRATION,
    ),
}
HEALTH_BITS = {
    "gyro": dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO,
    "accel": dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL,
    "mag": dialect.MAV_SYS_STATUS_SENSOR_3D_MAG,
}


class TiltEstimate:
    """Accelerometer bias (3,), body frame, m/s², that ArduPilot's estimator has learnt and subtracts.

    On the ground EKF3 learns the bias of an axis only while that axis is within 37 deg of the vertical
    (``NavEKF3_core::CovariancePrediction``: ``fabsF(prevTnb[index][2]) > 0.8``, else the state is held); at boot it
    knows none. A new INS_ACCOFFS leaves what it learned: the attitude is then wrong by that much. It stays so at rest
    (2.2 deg for 34 s, unchanged within 0.01 deg) until the axis stands upright again or the vehicle is restarted.
    """

    def __init__(self, sensors: ArduPilotSensors) -> None:
        self._sensors = sensors
        self.boot()

    def boot(self) -> None:
        """Reset to zero bias: after a restart the attitude is the accelerometer's."""
        self.bias = np.zeros(3)
        self._time = 0.0

    def advance(self, until: float, *, flying: bool) -> None:
        """Update the bias from the primary accelerometer up to a vehicle time; in flight on every axis."""
        dt = until - self._time
        if dt < BIAS_STEP_S:
            return
        self._time = until
        state = self._sensors.world.state(np.array([until]))
        read = self._sensors.imu(self._sensors.primary, state, noise_scale=0.0).accel[0]
        error = read - state.force[0]
        if not np.isfinite(read).all() or not read.any():
            return  # a dead sensor teaches nothing
        down = body_from_ned(state.q, np.array([0.0, 0.0, 1.0]))[0]
        learned = np.ones(3, dtype=bool) if flying else np.abs(down) > UPRIGHT
        follow = 1.0 - math.exp(-dt / BIAS_TIME_CONSTANT_S)
        self.bias = np.clip(self.bias + follow * learned * (error - self.bias), -BIAS_LIMIT, BIAS_LIMIT)

    def unbiased(self, force: Array) -> Array:
        """Corrected accelerations (N, 3) minus the bias."""
        return np.asarray(force - self.bias)


class ArduPilotReadings(Readings):
    """ArduPilot's sensors at the instants of one tick."""

    def __init__(self, sensors: ArduPilotSensors, tilt: TiltEstimate, times: list[float]) -> None:
        super().__init__(sensors, times)
        self._sensors, self._tilt = sensors, tilt

    @cached_property
    def block(self) -> Block:
        """Attitude, motion and motor state."""
        sensors = self._sensors
        primary, trim = self.imu(sensors.primary), sensors.table.vector("AHRS_TRIM")
        return make_block(sensors.world, self.state, self._tilt.unbiased(primary.accel), primary.gyro, trim)

    def _as_integers(self, instance: int) -> ImuIntegers:
        imu = self.imu(instance)
        mag = self._sensors.compass(instance, self.state.t)
        return (
            truncated(imu.accel, 1000.0, G).tolist(),
            truncated(imu.gyro, 1000.0).tolist(),
            truncated(mag, 1.0).tolist(),
            truncated(imu.temperature, 100.0).tolist(),
        )

    @cached_property
    def highres(self) -> tuple[Floats, ...]:
        """HIGHRES_IMU of the primary: its magnetometer in Gauss, or a million times that."""
        sensors = self._sensors
        imu = self.imu(sensors.primary)
        factor = MAG_DEFECT if sensors.world.config.highres_mag_defect else 1.0 / MAG_DEFECT
        mag = sensors.compass(0, self.state.t) * factor
        return tuple(as_float32(v).tolist() for v in (imu.accel, imu.gyro, mag))

    @cached_property
    def true_euler(self) -> list[list[float]]:
        """True roll, pitch, yaw."""
        angles: list[list[float]] = euler_from_quaternions(self.state.q).tolist()
        return angles


Builder = Callable[[ArduPilotReadings, int], Any]


class ArduPilotMessages(AutopilotMessages[ArduPilotReadings]):
    """Builds every message of this autopilot, on its stream or one at a time.

    `momentary` are the builders of messages that do not come from the sensors, by message id.
    """

    def __init__(
        self,
        vehicle: FlightController,
        sensors: ArduPilotSensors,
        telemetry: Telemetry,
        momentary: Mapping[int, Callable[[], Any]],
    ) -> None:
        super().__init__(vehicle, telemetry)
        self._sensors = sensors
        self.tilt = TiltEstimate(sensors)
        self.builders |= {
            dialect.MAVLINK_MSG_ID_RAW_IMU: self._raw_imu,
            dialect.MAVLINK_MSG_ID_SCALED_IMU: self._scaled_imu(dialect.MAVLink_scaled_imu_message, 0),
            dialect.MAVLINK_MSG_ID_SCALED_IMU2: self._scaled_imu(dialect.MAVLink_scaled_imu2_message, 1),
            dialect.MAVLINK_MSG_ID_SCALED_IMU3: self._scaled_imu(dialect.MAVLink_scaled_imu3_message, 2),
            dialect.MAVLINK_MSG_ID_HIGHRES_IMU: self._highres_imu,
            dialect.MAVLINK_MSG_ID_SIMSTATE: self._simstate,
            dialect.MAVLINK_MSG_ID_SYS_STATUS: lambda r, i: self._sys_status(r.block.current[i]),
            dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _of_instant(self.version),
            dialect.MAVLINK_MSG_ID_HEARTBEAT: _of_instant(vehicle.heartbeat),
            **{k: _of_instant(builder) for k, builder in momentary.items()},
        }
        if not sensors.world.config.highres:
            del self.builders[dialect.MAVLINK_MSG_ID_HIGHRES_IMU]

    def readings(self, times: list[float]) -> ArduPilotReadings:
        """See AutopilotMessages."""
        return ArduPilotReadings(self._sensors, self.tilt, times)

    def version(self) -> Any:
        """AUTOPILOT_VERSION."""
        return self._telemetry.autopilot_version(CAPABILITIES, VERSION, GIT_HASH)

    # --- streams

    def set_interval(self, channel: MavlinkChannel, message_id: int, interval_us: float) -> tuple[bool, str]:
        """SET_MESSAGE_INTERVAL of a known message: whether it is granted, and a text that says why not."""
        if interval_us <= 0:
            channel.streams.pop(message_id, None)
            return True, ""
        interval_ms = ardupilot_interval_ms(interval_us, self._vehicle.table.get("SCHED_LOOP_RATE", 400.0))
        if interval_ms is None:
            return False, f"Requested rate for message ID {message_id} too fast. Increase SCHED_LOOP_RATE"
        channel.streams[message_id] = ardupilot_stream(
            message_id, interval_ms, self._vehicle.first_due(channel, message_id)
        )
        return True, ""

    def request_data_stream(self, channel: MavlinkChannel, message: Any) -> None:
        """REQUEST_DATA_STREAM: one group of messages, or all of them, at one rate."""
        groups = STREAM_GROUPS if message.req_stream_id == dialect.MAV_DATA_STREAM_ALL else [message.req_stream_id]
        for group in groups:
            for message_id in STREAM_GROUPS.get(group, ()):
                if not message.start_stop or message.req_message_rate == 0:
                    channel.streams.pop(message_id, None)
                    continue
                interval_ms = max(1000 // int(message.req_message_rate), 1)
                channel.streams[message_id] = ardupilot_stream(message_id, interval_ms, self._vehicle.time)

    # --- messages

    def _sys_status(self, amps: float) -> Any:
        volts = self._telemetry.battery_volts(amps)
        # the bit of the arming checks; always healthy while armed (GCS.cpp, update_sensor_status_flags)
        ready = self._vehicle.armed or not self._vehicle.arming_faults()
        health = SENSORS_HEALTH | dialect.MAV_SYS_STATUS_PREARM_CHECK if ready else SENSORS_HEALTH
        for kind, bit in HEALTH_BITS.items():  # of all units; of the compasses the first one alone (GCS.cpp)
            if self._sensors.unhealthy(kind):
                health &= ~bit
        return dialect.MAVLink_sys_status_message(
            SENSORS_PRESENT, SENSORS_ENABLED, health, 100, int(volts * 1000), int(amps * 100), 95,
            0, 0, 0, 0, 0, 0, 0, 0, 0,
        )  # fmt: skip

    def _raw_imu(self, r: ArduPilotReadings, i: int) -> Any:
        accel, gyro, mag, temperature = r.integers(0)
        return dialect.MAVLink_raw_imu_message(
            microseconds(r.block.t[i]), *accel[i], *gyro[i], *mag[i], 0, temperature[i]
        )

    def _scaled_imu(self, message_class: Any, instance: int) -> Builder:
        def build(r: ArduPilotReadings, i: int) -> Any:
            accel, gyro, mag, temperature = r.integers(instance)
            return message_class(milliseconds(r.block.t[i]), *accel[i], *gyro[i], *mag[i], temperature[i])

        return build

    def _highres_imu(self, r: ArduPilotReadings, i: int) -> Any:
        accel, gyro, mag = r.highres
        pressure = pressure_hpa(self._vehicle.config.altitude_m)
        temperature = self._telemetry.baro_temperature(r.block.t[i])
        return dialect.MAVLink_highres_imu_message(
            microseconds(r.block.t[i]), *accel[i], *gyro[i], *mag[i], pressure, 0.0, 0.0, temperature,
            HIGHRES_FIELDS, self._sensors.primary,
        )  # fmt: skip

    def _simstate(self, r: ArduPilotReadings, i: int) -> Any:
        state = r.state
        roll, pitch, yaw = r.true_euler[i]
        force, rate = state.force[i].tolist(), state.rate[i].tolist()
        lat, lon = round(self._vehicle.config.latitude_deg * 1e7), round(self._vehicle.config.longitude_deg * 1e7)
        return dialect.MAVLink_simstate_message(roll, pitch, yaw, *force, *rate, lat, lon)


def _of_instant(builder: Callable[[], Any]) -> Builder:
    return lambda _readings, _i: builder()
