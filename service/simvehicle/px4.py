"""The PX4 personality: main of October 2025, on hardware, or the simulator build where configured."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle import px4_parameters as names
from mavcal.service.simvehicle.config import VehicleConfig
from mavcal.service.simvehicle.parameters import ParameterTable, SimParameter
from mavcal.service.simvehicle.px4_calibration import GyroWriter
from mavcal.service.simvehicle.px4_commands import Px4Commands
from mavcal.service.simvehicle.px4_messages import Px4Messages
from mavcal.service.simvehicle.px4_protocol import Px4Parameters
from mavcal.service.simvehicle.px4_sensors import Px4Sensors
from mavcal.service.simvehicle.telemetry import Telemetry
from mavcal.service.simvehicle.vehicle import FlightController, MavlinkChannel
from mavcal.service.simvehicle.wire import Received

BASE_MODE_DISARMED, ARMED_BIT = 29, 128
CUSTOM_MODE = 0x03040000
FIRST_HEARTBEAT_S = 0.96


class Px4Vehicle(FlightController):
    """PX4: bit-copied integers, thresholds in memory, streams minus biases, a background writer."""

    device_ids = MappingProxyType({"accel": names.ACCEL_IDS, "gyro": names.GYRO_IDS, "mag": names.MAG_IDS})

    def __init__(self, config: VehicleConfig) -> None:
        super().__init__(config)
        self.sensors = Px4Sensors(self.world, self.table, self.faults)
        self.parameters = Px4Parameters(self, self.reload_calibration)
        self.telemetry = Telemetry(self)
        self.messages = Px4Messages(self, self.sensors, self.telemetry)
        self.commands = Px4Commands(self, self.sensors, self.parameters, self.messages)
        self.flush_saves = self.parameters.save
        self.foreign_set = lambda name, value: self.parameters.write(
            {name: value if self.table[name].is_float else int(value)}
        )
        self.start_onboard_calibration = lambda: self.commands.calibration.wait_for_sides("mag")
        self.stop_onboard_calibration = self.commands.calibration.cancel
        self.writer = GyroWriter(self, self.sensors, self.parameters, lambda: self.commands.calibrating)

    def make_table(self) -> ParameterTable:
        """See FlightController."""
        return ParameterTable(names.px4_table(self.config))

    def load_parameters(self, parameters: list[SimParameter]) -> None:
        """See FlightController: PX4 lists by name, whatever the order of the file."""
        self.table.replace_all(parameters, by_name=True)

    def boot(self) -> None:
        """See FlightController."""
        self.sensors.boot()
        self.parameters.boot()
        names.mark_used(self.table, thermal_runs=not self.config.sitl)
        self.commands.calibration.boot()
        self.writer.boot()
        self.messages.boot()
        self.every(1.0, self._beat, first=FIRST_HEARTBEAT_S)

    def _beat(self) -> None:
        if not self.parameters.frozen:
            self.broadcast(self.heartbeat())

    def handle(self, channel: MavlinkChannel, received: Received) -> None:
        """See FlightController. REQUEST_DATA_STREAM is not handled at all; a frozen vehicle knows only parameters."""
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

    def sense(self, until: float) -> None:
        """See FlightController."""
        self.sensors.reader.advance(until)
        if not self.parameters.frozen:
            self.writer.advance(until)

    def emit(self, due: list[tuple[float, int, MavlinkChannel, int]], times: list[float]) -> None:
        """See FlightController."""
        if not self.parameters.frozen:
            self.messages.emit(due, times)

    def heartbeat(self) -> Any:
        """See FlightController."""
        mode = BASE_MODE_DISARMED + (ARMED_BIT if self.armed else 0)
        return dialect.MAVLink_heartbeat_message(
            dialect.MAV_TYPE_QUADROTOR, dialect.MAV_AUTOPILOT_PX4, mode, CUSTOM_MODE, self._status(), 3
        )

    def _status(self) -> int:
        if self.armed:
            return int(dialect.MAV_STATE_ACTIVE)
        if self.commands.calibration.shown:
            return int(dialect.MAV_STATE_CALIBRATING)
        return int(dialect.MAV_STATE_STANDBY if self.commands.ready else dialect.MAV_STATE_UNINIT)

    def in_force(self) -> dict[str, Any]:
        """See FlightController: memory where it differs from what is stored."""
        values: dict[str, Any] = {p.name: self.table.get(p.name) for p in self.table}
        for memory in (*self.sensors.accels, *self.sensors.gyros, *self.sensors.mags):
            values |= memory.as_parameters()
        # The switches of temperature compensation act at a restart only.
        for sensor in ("A", "G"):
            values[f"TC_{sensor}_ENABLE"] = float(self.sensors.thermal_on[sensor])
        return values

    def arming_faults(self) -> list[str]:
        """See FlightController."""
        return self.commands.arming_faults()

    def reload_calibration(self) -> None:
        """See FlightController."""
        self.sensors.update(armed=self.armed)
        names.mark_used(self.table, thermal_runs=not self.config.sitl)
