"""The PX4 personality: main of October 2025, on hardware, or the simulator build where configured."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle import px4_parameters as names
from mavcal.service.simvehicle.config import VehicleConfig
from mavcal.service.simvehicle.parameters import Parameter, ParameterTable
from mavcal.service.simvehicle.px4_commands import Px4Commands
from mavcal.service.simvehicle.px4_ekf import Estimator
from mavcal.service.simvehicle.px4_gyrocal import GyroWriter
from mavcal.service.simvehicle.px4_protocol import Px4Parameters
from mavcal.service.simvehicle.px4_readings import Px4Readings
from mavcal.service.simvehicle.px4_sensors import Px4Sensors
from mavcal.service.simvehicle.streams import px4_stream
from mavcal.service.simvehicle.telemetry import Block, Telemetry, microseconds, milliseconds, pressure_hpa
from mavcal.service.simvehicle.vehicle import Channel, Vehicle
from mavcal.service.simvehicle.wire import Received

CAPABILITIES = 59647
VERSION = 0x01110040
GIT_HASH = bytes([0, 0, 0, 65, 200, 120, 22, 169])
BASE_MODE_DISARMED, ARMED_BIT = 29, 128
CUSTOM_MODE = 0x03040000
READY_AFTER_S = 3.9  # after boot HEARTBEAT says UNINIT for so long
FIRST_HEARTBEAT_S = 0.96
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


class Px4Vehicle(Vehicle):
    """PX4: bit-copied integers, thresholds in memory, streams minus biases, a background writer."""

    def __init__(self, config: VehicleConfig) -> None:
        super().__init__(config)
        self.sensors = Px4Sensors(self.world, self.table, self.faults)
        self.parameters = Px4Parameters(self, self._parameters_updated)
        self.commands = Px4Commands(self)
        self.estimator = Estimator(config.seed)
        self.telemetry = Telemetry(self)
        self.writer = GyroWriter(self)
        self.last_ticks = (-1.0, -1.0)
        self._builders: dict[int, Callable[[Px4Readings, int], Any]] = {
            dialect.MAVLINK_MSG_ID_SCALED_IMU: self._scaled_imu(dialect.MAVLink_scaled_imu_message, 0),
            dialect.MAVLINK_MSG_ID_SCALED_IMU2: self._scaled_imu(dialect.MAVLink_scaled_imu2_message, 1),
            dialect.MAVLINK_MSG_ID_SCALED_IMU3: self._scaled_imu(dialect.MAVLink_scaled_imu3_message, 2),
            dialect.MAVLINK_MSG_ID_HIGHRES_IMU: self._highres_imu,
            dialect.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            dialect.MAVLINK_MSG_ID_HEARTBEAT: lambda _r, _i: self.heartbeat(),
            dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: lambda _r, _i: self.version(),
            **{k: _of_block(builder) for k, builder in self.telemetry.builders.items()},
        }

    # --- Vehicle

    def make_table(self) -> ParameterTable:
        """See Vehicle."""
        return ParameterTable(names.px4_table(self.config))

    def load_parameters(self, parameters: list[Parameter]) -> None:
        """See Vehicle: PX4 lists by name, whatever the order of the file."""
        self.table.replace_all(parameters, by_name=True)

    def boot(self) -> None:
        """See Vehicle."""
        self.sensors.boot()
        self.parameters.boot()
        names.mark_used(self.table, thermal_runs=not self.config.sitl)
        self.commands.boot()
        self.writer.boot()
        self.estimator = Estimator(self.config.seed + self.boots)
        self.last_ticks = (-1.0, -1.0)
        unasked = SITL_STREAMS if self.config.sitl else RADIO_STREAMS
        for channel in self.channels:
            for message_id, rate in unasked.items():
                channel.streams[message_id] = px4_stream(message_id, 1e6 / rate, STREAM_START_S)
        self.every(1.0, self._beat, first=FIRST_HEARTBEAT_S)

    def _beat(self) -> None:
        if not self.parameters.frozen:
            self.broadcast(self.heartbeat())

    def handle(self, channel: Channel, received: Received) -> None:
        """See Vehicle. REQUEST_DATA_STREAM is not handled at all; a frozen vehicle knows only parameters."""
        name = received.name
        if name.startswith("PARAM_"):
            self.parameters.handle(channel, received)
        elif self.parameters.frozen:
            return
        elif name in ("COMMAND_LONG", "COMMAND_INT"):
            self.commands.handle(channel, received)
        elif name == "TIMESYNC" and received.message.tc1 == 0:
            now = int(self.time * 1e9)
            self.send(channel, dialect.MAVLink_timesync_message(now, int(received.message.ts1)))

    def stop_onboard_calibration(self) -> None:
        """See Vehicle."""
        self.commands.calibration.cancel()

    def sense(self, until: float) -> None:
        """See Vehicle."""
        self.sensors.reader.advance(until)
        if not self.parameters.frozen:
            self.writer.advance(until)

    def emit(self, due: list[tuple[float, int, Channel, int]], times: list[float]) -> None:
        """See Vehicle."""
        if self.parameters.frozen:
            return
        readings = Px4Readings(self, times)
        position = {moment: i for i, moment in enumerate(times)}
        for moment, _, channel, message_id in due:
            message = self._builders[message_id](readings, position[moment])
            if message is not None:
                channel.send(message)

    def heartbeat(self) -> Any:
        """See Vehicle."""
        mode = BASE_MODE_DISARMED + (ARMED_BIT if self.armed else 0)
        return dialect.MAVLink_heartbeat_message(
            dialect.MAV_TYPE_QUADROTOR, dialect.MAV_AUTOPILOT_PX4, mode, CUSTOM_MODE, self._status(), 3
        )

    def _status(self) -> int:
        if self.armed:
            return int(dialect.MAV_STATE_ACTIVE)
        if self.commands.calibration.shown:
            return int(dialect.MAV_STATE_CALIBRATING)
        return int(dialect.MAV_STATE_STANDBY if self.ready else dialect.MAV_STATE_UNINIT)

    @property
    def ready(self) -> bool:
        """Whether preflight checks pass: booted, and every sensor has a slot."""
        calibrated = all(m.slot is not None for m in (*self.sensors.accels, *self.sensors.gyros, *self.sensors.mags))
        return self.time > READY_AFTER_S and calibrated

    def in_force(self) -> dict[str, Any]:
        """See Vehicle: memory where it differs from what is stored."""
        values: dict[str, Any] = {p.name: self.table.get(p.name) for p in self.table}
        for memory in (*self.sensors.accels, *self.sensors.gyros, *self.sensors.mags):
            values |= memory.as_parameters()
        # The switches of temperature compensation act at a restart only.
        for sensor in ("A", "G"):
            values[f"TC_{sensor}_ENABLE"] = float(self.sensors.thermal_on[sensor])
        return values

    def flush_saves(self) -> None:
        """See Vehicle."""
        self.parameters.save()

    def device_ids(self) -> dict[str, tuple[int, ...]]:
        """See Vehicle."""
        return {"accel": names.ACCEL_IDS, "gyro": names.GYRO_IDS, "mag": names.MAG_IDS}

    def foreign_set(self, name: str, value: float) -> None:
        """See Vehicle."""
        self.parameters.write({name: value if self.table[name].is_float else int(value)})

    def reload_calibration(self) -> None:
        """See Vehicle."""
        self._parameters_updated()

    def start_onboard_calibration(self) -> None:
        """See Vehicle."""
        self.commands.calibration.wait_for_sides("mag")

    def _parameters_updated(self) -> None:
        self.sensors.update(armed=self.armed)
        names.mark_used(self.table, thermal_runs=not self.config.sitl)

    # --- streams

    def set_interval(self, channel: Channel, message_id: int, interval_us: float) -> bool:
        """SET_MESSAGE_INTERVAL: False for a message that this build does not stream."""
        if message_id not in self._builders:
            return False
        if interval_us < 0:
            channel.streams.pop(message_id, None)
        elif interval_us == 0:
            self._default_interval(channel, message_id)
        else:
            channel.streams[message_id] = px4_stream(message_id, interval_us, self.time)
        return True

    def _default_interval(self, channel: Channel, message_id: int) -> None:
        rate = (SITL_STREAMS if self.config.sitl else RADIO_STREAMS).get(message_id)
        if rate is None:
            channel.streams.pop(message_id, None)
        else:
            channel.streams[message_id] = px4_stream(message_id, 1e6 / rate, self.time)

    def interval_us(self, channel: Channel, message_id: int) -> int:
        """What MESSAGE_INTERVAL says: 0 unknown, −1 off."""
        if message_id not in self._builders:
            return 0
        stream = channel.streams.get(message_id)
        return -1 if stream is None else stream.interval_us

    def one(self, message_id: int) -> Any:
        """One message of this instant; None if it cannot be sent."""
        builder = self._builders.get(message_id)
        return None if builder is None else builder(Px4Readings(self, [self.time]), 0)

    # --- messages

    def version(self) -> Any:
        """AUTOPILOT_VERSION."""
        return self.telemetry.autopilot_version(CAPABILITIES, VERSION, GIT_HASH)

    def _sys_status(self, r: Px4Readings, i: int) -> Any:
        amps = r.block.current[i]
        volts = self.telemetry.battery_volts(amps)
        return dialect.MAVLink_sys_status_message(
            SENSORS, SENSORS, SENSORS, 80, int(volts * 1000), int(amps * 100), 95, 0, 0, 0, 0, 0, 0, 0, 0, 0
        )

    def _scaled_imu(self, message_class: Any, instance: int) -> Callable[[Px4Readings, int], Any]:
        def build(r: Px4Readings, i: int) -> Any:
            if not self.sensors.present(instance):
                return None
            accel, gyro, mag, temperature = r.integers(instance)
            return message_class(milliseconds(float(r.state.t[i])), *accel[i], *gyro[i], *mag[i], temperature[i])

        return build

    def _highres_imu(self, r: Px4Readings, i: int) -> Any:
        accel, gyro, mag, updated = r.highres()
        altitude = self.config.altitude_m
        temperature = self.telemetry.baro_temperature(float(r.state.t[i]))
        return dialect.MAVLink_highres_imu_message(
            microseconds(float(r.state.t[i])), *accel[i], *gyro[i], *mag[i], pressure_hpa(altitude), 0.0, altitude,
            temperature, updated[i], 0,
        )  # fmt: skip


def _of_block(builder: Callable[[Block, int], Any]) -> Callable[[Px4Readings, int], Any]:
    return lambda readings, i: builder(readings.block, i)
