"""The ArduPilot personality: ArduCopter 4.7-dev of October 2025."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle import ardupilot_parameters as names
from mavcal.service.simvehicle.ardupilot_commands import GIT_HASH, ArduPilotCommands
from mavcal.service.simvehicle.ardupilot_protocol import ArduPilotParameters
from mavcal.service.simvehicle.ardupilot_readings import Readings
from mavcal.service.simvehicle.ardupilot_sensors import ArduPilotSensors
from mavcal.service.simvehicle.config import Calibration, VehicleConfig
from mavcal.service.simvehicle.parameters import Parameter, ParameterTable
from mavcal.service.simvehicle.streams import ardupilot_interval_ms, ardupilot_stream
from mavcal.service.simvehicle.telemetry import (
    Block,
    Telemetry,
    microseconds,
    milliseconds,
    pressure_hpa,
)
from mavcal.service.simvehicle.vehicle import Channel, Vehicle
from mavcal.service.simvehicle.wire import Received

BASE_MODE_DISARMED, ARMED_BIT = 81, 128
STATISTICS_FIRST_S, STATISTICS_PERIOD_S = 30.43, 31.0
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


class ArduPilotVehicle(Vehicle):
    """ArduCopter: casts parameters, truncates streams, averages its compass over 100 ms."""

    def __init__(self, config: VehicleConfig) -> None:
        super().__init__(config)
        self.parameters = ArduPilotParameters(self)
        self.sensors = ArduPilotSensors(self.world, self.table, self.faults)
        self.telemetry = Telemetry(self)
        self.commands = ArduPilotCommands(self)
        if config.calibration is Calibration.EARLIER:
            self.commands.accel_ids_stored = set(range(config.imu_count))
        self._builders: dict[int, Callable[[Readings, int], Any]] = {
            dialect.MAVLINK_MSG_ID_RAW_IMU: self._raw_imu,
            dialect.MAVLINK_MSG_ID_SCALED_IMU: self._scaled_imu(dialect.MAVLink_scaled_imu_message, 0),
            dialect.MAVLINK_MSG_ID_SCALED_IMU2: self._scaled_imu(dialect.MAVLink_scaled_imu2_message, 1),
            dialect.MAVLINK_MSG_ID_SCALED_IMU3: self._scaled_imu(dialect.MAVLink_scaled_imu3_message, 2),
            dialect.MAVLINK_MSG_ID_HIGHRES_IMU: self._highres_imu,
            dialect.MAVLINK_MSG_ID_SIMSTATE: self._simstate,
            dialect.MAVLINK_MSG_ID_SYS_STATUS: lambda r, i: self.sys_status(r.block.current[i]),
            **{k: _of_block(builder) for k, builder in self.telemetry.builders.items()},
            **{k: _of_instant(builder) for k, builder in self.commands.periodic.items()},
        }

    # --- Vehicle

    def make_table(self) -> ParameterTable:
        """See Vehicle."""
        return ParameterTable(names.ardupilot_table(self.config), self._listed)

    def _listed(self, name: str) -> bool:
        return not names.hidden_by_group(name, self.table.mapping())

    def load_parameters(self, parameters: list[Parameter]) -> None:
        """See Vehicle. A table that names our accelerometers says that they were calibrated and stored."""
        super().load_parameters(parameters)
        ids = names.ACCEL_IDS[: self.config.imu_count]
        self.commands.accel_ids_stored = {k for k, i in enumerate(ids) if self.table.get(names.id_name("ACC", k)) == i}

    def flush_saves(self) -> None:
        """See Vehicle."""
        self.parameters.flush()

    def device_ids(self) -> dict[str, tuple[int, ...]]:
        """See Vehicle."""
        return {"accel": names.ACCEL_IDS, "gyro": names.GYRO_IDS, "mag": names.MAG_IDS}

    def foreign_set(self, name: str, value: float) -> None:
        """See Vehicle."""
        self.parameters.set(name, value)

    def start_onboard_calibration(self) -> None:
        """See Vehicle."""
        self.commands.mag_calibration.start(0, autosave=False)

    def boot(self) -> None:
        """See Vehicle: latch what needs a reboot, calibrate the gyros unless told not to, begin to talk."""
        self.sensors.detect()
        self.commands.boot()
        self.parameters.boot()
        if self.table.get("INS_GYR_CAL", 1.0) == 1:
            self.commands.store_gyro_offsets(announce=False)
        self.every(1.0, lambda: self.broadcast(self.heartbeat()), first=1.0)
        self.every(10.0, lambda: self.broadcast(self._timesync()))
        self.every(STATISTICS_PERIOD_S, self._statistics, first=STATISTICS_FIRST_S)
        self.at(0.5, lambda: self.say(self.banner()[0]))

    def handle(self, channel: Channel, received: Received) -> None:
        """See Vehicle."""
        if self.commands.deaf:
            return
        name, message = received.name, received.message
        if name.startswith("PARAM_"):
            self.parameters.handle(channel, received)
        elif name == "REQUEST_DATA_STREAM":
            self._request_data_stream(channel, message)
        elif name in ("COMMAND_LONG", "COMMAND_INT"):
            self.commands.handle(channel, received)
        elif name == "TIMESYNC" and message.tc1 == 0:
            now = int(self.time * 1e9)
            self.send(channel, dialect.MAVLink_timesync_message(now, int(message.ts1)))

    def stop_onboard_calibration(self) -> None:
        """See Vehicle."""
        self.commands.mag_calibration.cancel()

    def sense(self, until: float) -> None:
        """See Vehicle."""
        self.sensors.reader.advance(until)

    def emit(self, due: list[tuple[float, int, Channel, int]], times: list[float]) -> None:
        """See Vehicle."""
        if self.commands.stalled:
            return
        readings = Readings(self, times)
        position = {moment: i for i, moment in enumerate(times)}
        for moment, _, channel, message_id in due:
            message = self._builders[message_id](readings, position[moment])
            if message is not None:
                channel.send(message)

    def heartbeat(self) -> Any:
        """See Vehicle: a copter on the ground says STANDBY even when armed."""
        mode = BASE_MODE_DISARMED + (ARMED_BIT if self.armed else 0)
        status = dialect.MAV_STATE_ACTIVE if self.telemetry.flying else dialect.MAV_STATE_STANDBY
        return dialect.MAVLink_heartbeat_message(
            dialect.MAV_TYPE_QUADROTOR, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, 0, status, 3
        )

    def in_force(self) -> dict[str, Any]:
        """See Vehicle."""
        return {p.name: self.table.get(p.name) for p in self.table}

    # --- streams

    def set_interval(self, channel: Channel, message_id: int, interval_us: float) -> tuple[bool, str]:
        """SET_MESSAGE_INTERVAL of a known message: whether it is granted, and a text that says why not."""
        if interval_us <= 0:
            channel.streams.pop(message_id, None)
            return True, ""
        interval_ms = ardupilot_interval_ms(interval_us, self.table.get("SCHED_LOOP_RATE", 400.0))
        if interval_ms is None:
            return False, f"Requested rate for message ID {message_id} too fast. Increase SCHED_LOOP_RATE"
        channel.streams[message_id] = ardupilot_stream(message_id, interval_ms, self.time)
        return True, ""

    def knows_message(self, message_id: int) -> bool:
        """Whether this message can be sent at all."""
        return message_id in self._builders

    def interval_us(self, channel: Channel, message_id: int) -> int:
        """What MESSAGE_INTERVAL says: 0 for a message that is unknown, −1 for one that is off."""
        if message_id not in self._builders:
            return 0
        stream = channel.streams.get(message_id)
        return -1 if stream is None else stream.interval_us

    def one(self, message_id: int) -> Any:
        """One message of this instant, for REQUEST_MESSAGE; None if it cannot be sent."""
        builder = self._builders.get(message_id)
        return None if builder is None else builder(Readings(self, [self.time]), 0)

    def _request_data_stream(self, channel: Channel, message: Any) -> None:
        groups = STREAM_GROUPS if message.req_stream_id == dialect.MAV_DATA_STREAM_ALL else [message.req_stream_id]
        for group in groups:
            for message_id in STREAM_GROUPS.get(group, ()):
                if not message.start_stop or message.req_message_rate == 0:
                    channel.streams.pop(message_id, None)
                    continue
                interval_ms = max(1000 // int(message.req_message_rate), 1)
                channel.streams[message_id] = ardupilot_stream(message_id, interval_ms, self.time)

    # --- messages

    def banner(self) -> list[str]:
        """What is said before a parameter list."""
        serial = self.uid2().hex()[:32]
        return [f"ArduCopter V4.7.0-dev ({GIT_HASH.decode()})", serial, "Frame: QUAD/PLUS"]

    def sys_status(self, amps: float) -> Any:
        """SYS_STATUS."""
        volts = self.telemetry.battery_volts(amps)
        return dialect.MAVLink_sys_status_message(
            SENSORS_PRESENT, SENSORS_ENABLED, SENSORS_HEALTH, 100, int(volts * 1000), int(amps * 100), 95,
            0, 0, 0, 0, 0, 0, 0, 0, 0,
        )  # fmt: skip

    def _statistics(self) -> None:
        """Runtime, told to everybody unasked each half minute."""
        if "STAT_RUNTIME" in self.table:
            total = int(self.table.saved["STAT_RUNTIME"]) + int(self.time)
            self.table.store("STAT_RUNTIME", total)
            self.parameters.announce(["STAT_RUNTIME"])

    def _timesync(self) -> Any:
        return dialect.MAVLink_timesync_message(0, int(self.time * 1e9) + 1)

    def _raw_imu(self, r: Readings, i: int) -> Any:
        accel, gyro, mag, temperature = r.integers(0)
        return dialect.MAVLink_raw_imu_message(
            microseconds(r.block.t[i]), *accel[i], *gyro[i], *mag[i], 0, temperature[i]
        )

    def _scaled_imu(self, message_class: Any, instance: int) -> Callable[[Readings, int], Any]:
        def build(r: Readings, i: int) -> Any:
            accel, gyro, mag, temperature = r.integers(instance)
            return message_class(milliseconds(r.block.t[i]), *accel[i], *gyro[i], *mag[i], temperature[i])

        return build

    def _highres_imu(self, r: Readings, i: int) -> Any:
        accel, gyro, mag = r.floats()
        pressure = pressure_hpa(self.config.altitude_m)
        temperature = self.telemetry.baro_temperature(r.block.t[i])
        return dialect.MAVLink_highres_imu_message(
            microseconds(r.block.t[i]), *accel[i], *gyro[i], *mag[i], pressure, 0.0, 0.0, temperature,
            HIGHRES_FIELDS, self.sensors.primary,
        )  # fmt: skip

    def _simstate(self, r: Readings, i: int) -> Any:
        state = r.state
        roll, pitch, yaw = r.true_euler()[i]
        force, rate = state.force[i].tolist(), state.rate[i].tolist()
        lat, lon = round(self.config.latitude_deg * 1e7), round(self.config.longitude_deg * 1e7)
        return dialect.MAVLink_simstate_message(roll, pitch, yaw, *force, *rate, lat, lon)


def _of_block(builder: Callable[[Block, int], Any]) -> Callable[[Readings, int], Any]:
    return lambda readings, i: builder(readings.block, i)


def _of_instant(builder: Callable[[], Any]) -> Callable[[Readings, int], Any]:
    return lambda _readings, _i: builder()
