"""What PX4 sends: its messages, the streams that carry them, and those that nobody has to ask for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle.px4_ekf import Estimator
from mavcal.service.simvehicle.px4_readings import NewFields, Px4Readings
from mavcal.service.simvehicle.px4_sensors import Px4Sensors
from mavcal.service.simvehicle.streams import px4_stream
from mavcal.service.simvehicle.telemetry import Block, Telemetry, microseconds, milliseconds, pressure_hpa
from mavcal.service.simvehicle.vehicle import FlightController, MavlinkChannel

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


Builder = Callable[[Px4Readings, int], Any]


class Px4Messages:
    """Builds every message of this autopilot, on its stream or one at a time."""

    def __init__(self, vehicle: FlightController, sensors: Px4Sensors, telemetry: Telemetry) -> None:
        self._vehicle, self._sensors, self._telemetry = vehicle, sensors, telemetry
        self._unasked = SITL_STREAMS if vehicle.config.sitl else RADIO_STREAMS
        self._estimator, self._fields = Estimator(vehicle.config.seed), NewFields()
        self._builders: dict[int, Builder] = {
            dialect.MAVLINK_MSG_ID_SCALED_IMU: self._scaled_imu(dialect.MAVLink_scaled_imu_message, 0),
            dialect.MAVLINK_MSG_ID_SCALED_IMU2: self._scaled_imu(dialect.MAVLink_scaled_imu2_message, 1),
            dialect.MAVLINK_MSG_ID_SCALED_IMU3: self._scaled_imu(dialect.MAVLink_scaled_imu3_message, 2),
            dialect.MAVLINK_MSG_ID_HIGHRES_IMU: self._highres_imu,
            dialect.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            dialect.MAVLINK_MSG_ID_HEARTBEAT: lambda _r, _i: vehicle.heartbeat(),
            dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: lambda _r, _i: self.version(),
            **{k: _of_block(builder) for k, builder in telemetry.builders.items()},
        }

    def boot(self) -> None:
        """The estimator begins from nothing, and every channel gets what nobody has to ask for."""
        vehicle = self._vehicle
        self._estimator, self._fields = Estimator(vehicle.config.seed + vehicle.boots), NewFields()
        for channel in vehicle.channels:
            for message_id, rate in self._unasked.items():
                channel.streams[message_id] = px4_stream(message_id, 1e6 / rate, STREAM_START_S)

    def emit(self, due: list[tuple[float, int, MavlinkChannel, int]], times: list[float]) -> None:
        """Send the messages (time, order, channel, message id) that fall due; `times` are their instants."""
        readings = self._readings(times)
        position = {moment: i for i, moment in enumerate(times)}
        for moment, _, channel, message_id in due:
            message = self._builders[message_id](readings, position[moment])
            if message is not None:
                channel.send(message)

    def _readings(self, times: list[float]) -> Px4Readings:
        return Px4Readings(self._sensors, self._estimator, self._fields, times, armed=self._vehicle.armed)

    # --- streams

    def set_interval(self, channel: MavlinkChannel, message_id: int, interval_us: float) -> bool:
        """SET_MESSAGE_INTERVAL: False for a message that this build does not stream."""
        if message_id not in self._builders:
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

    def interval_us(self, channel: MavlinkChannel, message_id: int) -> int:
        """What MESSAGE_INTERVAL says: 0 unknown, −1 off."""
        if message_id not in self._builders:
            return 0
        stream = channel.streams.get(message_id)
        return -1 if stream is None else stream.interval_us

    def one(self, message_id: int) -> Any:
        """One message of this instant; None if it cannot be sent."""
        builder = self._builders.get(message_id)
        return None if builder is None else builder(self._readings([self._vehicle.time]), 0)

    # --- messages

    def version(self) -> Any:
        """AUTOPILOT_VERSION."""
        return self._telemetry.autopilot_version(CAPABILITIES, VERSION, GIT_HASH)

    def _sys_status(self, r: Px4Readings, i: int) -> Any:
        amps = r.block.current[i]
        volts = self._telemetry.battery_volts(amps)
        # the bit of the arming checks is set among what is healthy alone (SYS_STATUS.hpp)
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
        """A magnetometer without an inertial unit of that number is sent all the same, the rest as zero."""
        if instance >= len(self._sensors.mags) or self._sensors.silent_mag(instance):
            return None
        mag = r.raw_mag(instance)[i]
        return message_class(milliseconds(float(r.state.t[i])), 0, 0, 0, 0, 0, 0, *mag, 0)

    def _highres_imu(self, r: Px4Readings, i: int) -> Any:
        accel, gyro, mag, updated = r.highres()
        altitude = self._vehicle.config.altitude_m
        temperature = self._telemetry.baro_temperature(float(r.state.t[i]))
        return dialect.MAVLink_highres_imu_message(
            microseconds(float(r.state.t[i])), *accel[i], *gyro[i], *mag[i], pressure_hpa(altitude), 0.0, altitude,
            temperature, updated[i], 0,
        )  # fmt: skip


def _of_block(builder: Callable[[Block, int], Any]) -> Builder:
    return lambda readings, i: builder(readings.block, i)
