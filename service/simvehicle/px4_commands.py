"""PX4's commands: execution, refusals, and the texts meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle.px4_calibration import Px4OnboardCalibration
from mavcal.service.simvehicle.px4_messages import Px4Messages
from mavcal.service.simvehicle.px4_protocol import Px4Parameters
from mavcal.service.simvehicle.px4_sensors import Px4Sensors
from mavcal.service.simvehicle.vehicle import FlightController, MavlinkChannel
from mavcal.service.simvehicle.wire import Received, command_parameters

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
ACCEPT_CODE = 76
REBOOT_DELAY_S = 0.45
READY_AFTER_S = 3.9  # after boot HEARTBEAT says UNINIT for so long
SHUTDOWN_AWAY_S = 1.2  # the simulator build is started again by its script
NO_ANSWER = (dialect.MAV_CMD_PREFLIGHT_SET_SENSOR_OFFSETS,)

Parameters = list[float]


class Px4Commands:
    """Handles COMMAND_LONG and COMMAND_INT."""

    def __init__(
        self, vehicle: FlightController, sensors: Px4Sensors, parameters: Px4Parameters, messages: Px4Messages
    ) -> None:
        self._vehicle, self._sensors, self._parameters, self._messages = vehicle, sensors, parameters, messages
        self.calibration = Px4OnboardCalibration(vehicle, sensors, parameters)
        self._handlers: dict[int, Callable[[MavlinkChannel, Parameters], int | list[int]]] = {
            dialect.MAV_CMD_PREFLIGHT_CALIBRATION: self._calibrate,
            dialect.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            dialect.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            dialect.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._capabilities,
            dialect.MAV_CMD_COMPONENT_ARM_DISARM: self._arm,
            dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: self._reboot,
            dialect.MAV_CMD_PREFLIGHT_STORAGE: self._storage,
            dialect.MAV_CMD_RUN_PREARM_CHECKS: self._run_checks,
        }

    @property
    def calibrating(self) -> bool:
        """Whether an onboard calibration runs."""
        return self.calibration.running is not None

    @property
    def ready(self) -> bool:
        """Whether preflight checks pass: booted, and every sensor has a slot."""
        return self._vehicle.time > READY_AFTER_S and self._sensors.calibrated

    def handle(self, channel: MavlinkChannel, received: Received) -> None:
        """Execute one command; the answer comes at once, before whatever was started has ended."""
        command = int(received.message.command)
        if command in NO_ANSWER:
            return
        handler = self._handlers.get(command)
        results = UNSUPPORTED if handler is None else handler(channel, command_parameters(received))
        for result in results if isinstance(results, list) else [results]:
            ack = dialect.MAVLink_command_ack_message(command, result, 0, 0, received.system, received.component)
            self._vehicle.send(channel, ack)

    # --- messages

    def _set_interval(self, channel: MavlinkChannel, p: Parameters) -> int:
        if p[2] != 0 or p[3] != 0 or p[6] != 0:
            return FAILED
        return ACCEPTED if self._messages.set_interval(channel, round(p[0]), p[1]) else FAILED

    def _get_interval(self, channel: MavlinkChannel, p: Parameters) -> int:
        self._vehicle.send(channel, self._messages.interval(channel, round(p[0])))
        return ACCEPTED

    def _request_message(self, channel: MavlinkChannel, p: Parameters) -> int:
        if round(p[0]) == dialect.MAVLINK_MSG_ID_MESSAGE_INTERVAL:
            return self._get_interval(channel, p[1:])
        message = self._messages.one(round(p[0]))
        if message is None:
            return DENIED
        self._vehicle.send(channel, message)
        return ACCEPTED

    def _capabilities(self, channel: MavlinkChannel, _p: Parameters) -> int:
        self._vehicle.send(channel, self._messages.version())
        return ACCEPTED

    # --- arming and restarting

    def _arm(self, _channel: MavlinkChannel, p: Parameters) -> int:
        vehicle = self._vehicle
        wanted = p[0] == 1
        if wanted and (not self.ready or self.calibrating):
            vehicle.say("Arming denied: Resolve system health failures first\t", dialect.MAV_SEVERITY_CRITICAL)
            return REJECTED
        if wanted != vehicle.armed:
            vehicle.armed = wanted
            vehicle.say(f"{'Armed' if wanted else 'Disarmed'} by external command\t")
        return ACCEPTED

    def arming_faults(self) -> list[str]:
        """Reasons of HealthAndArmingChecks against arming; empty where it is allowed."""
        faults = [f"Preflight Fail: {what} uncalibrated" for what in self._sensors.uncalibrated()]
        if self.calibrating:
            faults.append("Preflight Fail: Calibration in progress")
        return faults or ([] if self.ready else ["Preflight Fail: system is not ready yet"])

    def _run_checks(self, _channel: MavlinkChannel, _p: Parameters) -> int:
        if self._vehicle.armed:
            return REJECTED
        for text in self.arming_faults():
            self._vehicle.say(f"{text}\t", dialect.MAV_SEVERITY_CRITICAL)
        return ACCEPTED

    def _reboot(self, _channel: MavlinkChannel, p: Parameters) -> int:
        vehicle = self._vehicle
        if vehicle.armed or p[0] not in (1, 2):
            return DENIED
        if vehicle.config.sitl:
            if p[0] == 1:
                return DENIED
            vehicle.at(REBOOT_DELAY_S, lambda: vehicle.reboot(flush=False, away_s=SHUTDOWN_AWAY_S))
            return ACCEPTED
        vehicle.at(REBOOT_DELAY_S, lambda: vehicle.reboot(flush=False))
        return ACCEPTED

    def _storage(self, _channel: MavlinkChannel, p: Parameters) -> int:
        vehicle = self._vehicle
        if vehicle.armed or self.calibrating:
            return REJECTED
        if p[0] == 0:
            self._parameters.load()
        elif p[0] == 1:
            self._parameters.save()
        elif p[0] in (2, 4):
            self._parameters.write({parameter.name: parameter.default for parameter in vehicle.table})
        else:
            return DENIED
        return ACCEPTED

    # --- calibration

    def _calibrate(self, _channel: MavlinkChannel, p: Parameters) -> int | list[int]:
        vehicle = self._vehicle
        if vehicle.armed:
            return REJECTED
        if not any(p):
            self.calibration.cancel()
            return ACCEPTED
        if self.calibrating:
            vehicle.say("command denied during calibration: 241\t", dialect.MAV_SEVERITY_CRITICAL)
            # Three modules answer: two refuse, one is busy.
            return [DENIED, DENIED, REJECTED]
        if ACCEPT_CODE in (p[1], p[4]):
            return ACCEPTED
        start = self._calibration_of(p)
        if start is None:
            return DENIED
        start()
        return ACCEPTED

    def _calibration_of(self, p: Parameters) -> Callable[[], Any] | None:
        calibration = self.calibration
        if p[0] == 1:
            return calibration.gyro
        if p[2] == 1:
            return lambda: calibration.block("baro")
        if p[1] == 1:
            return lambda: calibration.wait_for_sides("mag")
        return {
            1: lambda: calibration.wait_for_sides("accel"),
            2: calibration.level,
            4: calibration.quick_accel,
        }.get(int(p[4]))
