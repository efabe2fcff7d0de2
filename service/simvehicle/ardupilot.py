"""The ArduPilot personality: ArduCopter 4.7-dev of October 2025."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle import ardupilot_parameters as names
from mavcal.service.simvehicle.ardupilot_calibration import MagCalibration, StoredCalibrations
from mavcal.service.simvehicle.ardupilot_commands import ArduPilotCommands
from mavcal.service.simvehicle.ardupilot_messages import GIT_HASH, ArduPilotMessages
from mavcal.service.simvehicle.ardupilot_protocol import ArduPilotParameters
from mavcal.service.simvehicle.ardupilot_sensors import ArduPilotSensors
from mavcal.service.simvehicle.config import Calibration, VehicleConfig
from mavcal.service.simvehicle.parameters import ParameterTable, SimParameter
from mavcal.service.simvehicle.telemetry import Telemetry
from mavcal.service.simvehicle.vehicle import FlightController, MavlinkChannel
from mavcal.service.simvehicle.wire import Received

BASE_MODE_DISARMED, ARMED_BIT = 81, 128
STATISTICS_FIRST_S, STATISTICS_PERIOD_S = 30.43, 31.0


class ArduPilotVehicle(FlightController):
    """ArduCopter: casts parameters, truncates streams, averages its compass over 100 ms."""

    device_ids = MappingProxyType({"accel": names.ACCEL_IDS, "gyro": names.GYRO_IDS, "mag": names.MAG_IDS})

    def __init__(self, config: VehicleConfig) -> None:
        super().__init__(config)
        self.parameters = ArduPilotParameters(self)
        self.sensors = ArduPilotSensors(self.world, self.table, self.faults)
        self.telemetry = Telemetry(self)
        self.stored = StoredCalibrations(self.table, self.parameters.announce)
        if config.calibration is not Calibration.NONE:
            self.stored.mark_accels(config.imu_count)
        self.mag_calibration = MagCalibration(self, self.sensors, self.stored)
        compass = {
            dialect.MAVLINK_MSG_ID_MAG_CAL_PROGRESS: self.mag_calibration.progress_message,
            dialect.MAVLINK_MSG_ID_MAG_CAL_REPORT: self.mag_calibration.report_message,
        }
        self.messages = ArduPilotMessages(self, self.sensors, self.telemetry, compass)
        self.commands = ArduPilotCommands(self, self.sensors, self.stored, self.messages, self.mag_calibration)
        self.flush_saves, self.foreign_set = self.parameters.flush, self.parameters.set
        self.start_onboard_calibration = lambda: self.mag_calibration.start(0, autosave=False)
        self.stop_onboard_calibration = self.mag_calibration.cancel

    # --- Vehicle

    def make_table(self) -> ParameterTable:
        """See FlightController."""
        return ParameterTable(names.ardupilot_table(self.config), self._listed)

    def _listed(self, name: str) -> bool:
        return not names.hidden_by_group(name, self.table.mapping())

    def load_parameters(self, parameters: list[SimParameter]) -> None:
        """See FlightController. A table with our accelerometers' ids means that they are calibrated."""
        super().load_parameters(parameters)
        ids = names.ACCEL_IDS[: self.config.imu_count]
        self.stored.accels = {k for k, i in enumerate(ids) if self.table.get(names.id_name("ACC", k)) == i}

    def arming_faults(self) -> list[str]:
        """See FlightController."""
        return [f"PreArm: {reason}" for reason in self.commands.arming_faults()]

    def boot(self) -> None:
        """See FlightController: latch what needs a reboot, calibrate the gyros if required, start the streams."""
        self.sensors.detect()
        self.messages.tilt.boot()
        self.commands.boot()
        self.parameters.boot()
        if self.table.get("INS_GYR_CAL", 1.0) == 1:
            self.commands.store_gyro_offsets()
        self.every(1.0, lambda: self.broadcast(self.heartbeat()), first=1.0)
        self.every(10.0, lambda: self.broadcast(dialect.MAVLink_timesync_message(0, int(self.time * 1e9) + 1)))
        self.every(STATISTICS_PERIOD_S, self._statistics, first=STATISTICS_FIRST_S)
        self.at(0.5, lambda: self.say(self.banner()[0]))

    def handle(self, channel: MavlinkChannel, received: Received) -> None:
        """See FlightController."""
        if self.commands.deaf:
            return
        name, message = received.name, received.message
        if name.startswith("PARAM_"):
            self.parameters.handle(channel, received)
        elif name == "REQUEST_DATA_STREAM":
            self.messages.request_data_stream(channel, message)
        elif name in ("COMMAND_LONG", "COMMAND_INT"):
            self.commands.handle(channel, received)
        elif name == "SETUP_SIGNING" and not self.armed:  # nothing acknowledges it: from now on frames are signed
            key = bytes(message.secret_key)
            self.signer.key = key if any(key) else b""
        elif name == "TIMESYNC" and message.tc1 == 0:
            now = int(self.time * 1e9)
            self.send(channel, dialect.MAVLink_timesync_message(now, int(message.ts1)))

    def sense(self, until: float) -> None:
        """See FlightController."""
        self.sensors.reader.advance(until)
        self.messages.tilt.advance(until, flying=self.telemetry.flying)

    def emit(self, due: list[tuple[float, int, MavlinkChannel, int]], times: list[float]) -> None:
        """See FlightController."""
        if not self.commands.stalled:
            self.messages.emit(due, times)

    def heartbeat(self) -> Any:
        """See FlightController: a copter on the ground says STANDBY even when armed."""
        mode = BASE_MODE_DISARMED + (ARMED_BIT if self.armed else 0)
        status = dialect.MAV_STATE_ACTIVE if self.telemetry.flying else dialect.MAV_STATE_STANDBY
        return dialect.MAVLink_heartbeat_message(
            dialect.MAV_TYPE_QUADROTOR, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, 0, status, 3
        )

    def in_force(self) -> dict[str, Any]:
        """See FlightController."""
        return {p.name: self.table.get(p.name) for p in self.table}

    # --- what it says by itself

    def banner(self) -> list[str]:
        """The STATUSTEXTs that precede a parameter list."""
        serial = self.uid2().hex()[:32]
        return [f"ArduCopter V4.7.0-dev ({GIT_HASH.decode()})", serial, "Frame: QUAD/PLUS"]

    def _statistics(self) -> None:
        """Send the runtime statistics to every link each half minute."""
        if "STAT_RUNTIME" in self.table:
            total = int(self.table.saved["STAT_RUNTIME"]) + int(self.time)
            self.table.store("STAT_RUNTIME", total)
            self.parameters.announce(["STAT_RUNTIME"])
