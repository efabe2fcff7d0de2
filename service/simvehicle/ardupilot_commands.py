"""ArduPilot's commands: execution, refusals, and the delays of its answers."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle import ardupilot_calibration as calibration
from mavcal.service.simvehicle import ardupilot_parameters as names
from mavcal.service.simvehicle.ardupilot_calibration import AccelCalibration, MagCalibration, StoredCalibrations
from mavcal.service.simvehicle.ardupilot_messages import ArduPilotMessages
from mavcal.service.simvehicle.ardupilot_sensors import ArduPilotSensors
from mavcal.service.simvehicle.parameters import Value
from mavcal.service.simvehicle.vehicle import FlightController, MavlinkChannel
from mavcal.service.simvehicle.wire import FORCED, Received, command_parameters

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
ACCEPT_CODE = 76
ACCEL_AGAIN_S = 5.0  # a second accelerometer calibration sooner than this is refused
GYRO_OVERHEAD_S = 0.03
GYRO_SETTLE_S = 10.0  # the arming check wants gyroscopes that have agreed for so long
LEVEL_S = 0.55
REBOOT_DELAY_S = 0.02
INCONSISTENT_GYRO = math.radians(5.0)
INCONSISTENT_ACCEL_DEFAULT = 0.75
UNHEALTHY = {"gyro": "Gyros not healthy", "accel": "Accels not healthy", "mag": "Compass not healthy"}

Parameters = list[float]


class ArduPilotCommands:
    """Handles COMMAND_LONG and COMMAND_INT, with the state of the onboard routines."""

    def __init__(
        self,
        vehicle: FlightController,
        sensors: ArduPilotSensors,
        stored: StoredCalibrations,
        messages: ArduPilotMessages,
        mag_calibration: MagCalibration,
    ) -> None:
        self._vehicle, self._sensors, self._stored, self._messages = vehicle, sensors, stored, messages
        self._mag_calibration = mag_calibration
        self._accel_calibration = AccelCalibration(vehicle, sensors, stored)
        self.deaf = False  # compassmot runs: nothing is answered until a reboot
        self._stalled_until = self._last_accel = self._gyros_settled_at = self._agreed_at = -math.inf
        self._reply: Callable[[int], None] = lambda _result: None
        self._handlers: dict[int, Callable[[MavlinkChannel, Parameters], int | None]] = {
            dialect.MAV_CMD_PREFLIGHT_CALIBRATION: self._calibrate,
            dialect.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            dialect.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            dialect.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._capabilities,
            dialect.MAV_CMD_COMPONENT_ARM_DISARM: self._arm,
            dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: self._reboot,
            dialect.MAV_CMD_PREFLIGHT_STORAGE: self._storage,
            dialect.MAV_CMD_RUN_PREARM_CHECKS: self._prearm,
            dialect.MAV_CMD_DO_START_MAG_CAL: self._start_mag_calibration,
            dialect.MAV_CMD_DO_ACCEPT_MAG_CAL: lambda _c, _p: self._mag_calibration.accept(),
            dialect.MAV_CMD_DO_CANCEL_MAG_CAL: lambda _c, _p: self._mag_calibration.cancel(),
        }

    @property
    def stalled(self) -> bool:
        """Whether a blocking calibration holds up the streams."""
        return self._vehicle.time < self._stalled_until

    def boot(self) -> None:
        """End every routine that a reboot ends."""
        self.deaf = False
        self._stored.boot()
        self._stalled_until = self._last_accel = self._gyros_settled_at = -math.inf
        self._agreed_at = self._vehicle.time + self._vehicle.config.agreement_s
        self._mag_calibration.cancel()
        self._accel_calibration.cancel()

    def handle(self, channel: MavlinkChannel, received: Received) -> None:
        """Execute one command and acknowledge it, unless its handler does so later."""
        command = int(received.message.command)
        if command == dialect.MAV_CMD_ACCELCAL_VEHICLE_POS:
            self._accel_calibration.answer(command_parameters(received)[0])
            return

        def reply(result: int) -> None:
            ack = dialect.MAVLink_command_ack_message(command, result, 0, 0, received.system, received.component)
            self._vehicle.send(channel, ack)

        self._reply = reply
        handler = self._handlers.get(command)
        result = UNSUPPORTED if handler is None else handler(channel, command_parameters(received))
        if result is not None:
            reply(result)

    # --- messages

    def _set_interval(self, channel: MavlinkChannel, p: Parameters) -> int:
        if p[2] != 0:
            return DENIED
        if int(p[0]) not in self._messages.builders:
            self._vehicle.say(f"No ap_message for mavlink id ({int(p[0])})", channel=channel)
            return DENIED
        accepted, text = self._messages.set_interval(channel, int(p[0]), p[1])
        if text:
            self._vehicle.at(0.0, lambda: self._vehicle.say(text, channel=channel))
        return ACCEPTED if accepted else DENIED

    def _get_interval(self, channel: MavlinkChannel, p: Parameters) -> int:
        self._vehicle.send(channel, self._messages.interval(channel, int(p[0])))
        return ACCEPTED if int(p[0]) in self._messages.builders else FAILED

    def _request_message(self, channel: MavlinkChannel, p: Parameters) -> int | None:
        if int(p[0]) == dialect.MAVLINK_MSG_ID_MESSAGE_INTERVAL:
            return self._get_interval(channel, p[1:])
        message = self._messages.one(int(p[0]))
        if message is None:
            return FAILED
        self._reply(ACCEPTED)
        self._vehicle.send(channel, message)
        return None

    def _capabilities(self, channel: MavlinkChannel, p: Parameters) -> int:
        if p[0] != 1:
            return FAILED
        self._vehicle.send(channel, self._messages.version())
        return ACCEPTED

    # --- arming and restarting

    def _arm(self, _channel: MavlinkChannel, p: Parameters) -> int:
        vehicle = self._vehicle
        wanted = p[0] == 1
        if wanted and not vehicle.armed and p[1] != FORCED:
            reasons = self.arming_faults()
            if reasons:
                vehicle.at(0.0, lambda: self._complain("Arm", reasons))
                return FAILED
        vehicle.armed = wanted
        return ACCEPTED

    def arming_faults(self) -> list[str]:
        """Reasons to refuse arming; empty: none."""
        vehicle = self._vehicle
        if vehicle.table.get("ARMING_CHECK", 1.0) == 0:
            return []
        if self._stored.reboot_reason:
            return [self._stored.reboot_reason]
        if self._mag_calibration.running:
            return ["Compass calibration running"]
        if any(not self._accel_calibrated(k) for k in range(len(self._sensors.chips))):
            return ["3D Accel calibration needed"]
        unhealthy = [text for kind, text in UNHEALTHY.items() if self._sensors.unhealthy(kind)]
        return unhealthy or self._inconsistencies()

    def _accel_calibrated(self, instance: int) -> bool:
        table = self._vehicle.table
        if not table.get(names.use_name(instance), 1.0):
            return True
        return (
            instance in self._stored.accels
            and bool(np.any(table.vector(names.accel_offset_name(instance)) != 0))
            and bool(np.all(table.vector(names.accel_scale_name(instance), 1.0) != 0))
        )

    def _inconsistencies(self) -> list[str]:
        vehicle, sensors = self._vehicle, self._sensors
        state = sensors.world.state(np.array([vehicle.time]))
        readings = [sensors.imu(k, state, 0.1) for k in range(len(sensors.chips))]
        limit = vehicle.table.get("ARMING_ACCTHRESH", INCONSISTENT_ACCEL_DEFAULT)
        reasons: list[str] = []
        early = len(readings) > 1 and vehicle.time < self._agreed_at
        if early or any(np.linalg.norm(r.accel[0] - readings[0].accel[0]) > limit for r in readings[1:]):
            reasons.append("Accels inconsistent")
        unsettled = early or vehicle.time < self._gyros_settled_at
        if unsettled or any(np.linalg.norm(r.gyro[0] - readings[0].gyro[0]) > INCONSISTENT_GYRO for r in readings[1:]):
            reasons.append("Gyros inconsistent")
        return reasons

    def _prearm(self, _channel: MavlinkChannel, _p: Parameters) -> int:
        vehicle = self._vehicle
        if vehicle.armed:
            return REJECTED
        self._complain("PreArm", self.arming_faults())
        return ACCEPTED

    def _complain(self, prefix: str, reasons: list[str]) -> None:
        for reason in reasons:
            self._vehicle.say(f"{prefix}: {reason}", dialect.MAV_SEVERITY_CRITICAL)

    def _reboot(self, _channel: MavlinkChannel, p: Parameters) -> int:
        vehicle = self._vehicle
        if vehicle.armed and p[5] != 20190226:
            return FAILED
        if p[0] not in (1, 3):
            return UNSUPPORTED
        vehicle.at(REBOOT_DELAY_S, vehicle.reboot)
        return ACCEPTED

    def _storage(self, _channel: MavlinkChannel, p: Parameters) -> int:
        if p[0] != 2:
            return DENIED
        for parameter in self._vehicle.table:
            self._vehicle.table.store(parameter.name, parameter.default)
            self._vehicle.table.save(parameter.name)
        return ACCEPTED

    # --- calibration

    def _calibrate(self, channel: MavlinkChannel, p: Parameters) -> int | None:
        vehicle = self._vehicle
        if vehicle.armed:
            return FAILED
        if p[0] == 1:
            vehicle.broadcast(vehicle.heartbeat())
            vehicle.say("Initialising ArduPilot")
            self._calibrate_gyros(self._done)
            return None
        if p[2] == 1:
            return ACCEPTED
        if p[4] == ACCEPT_CODE:
            self._stored.mark_accels(len(self._sensors.chips))
            return ACCEPTED
        if p[1] == ACCEPT_CODE:
            return ACCEPTED
        if p[5] == 1:
            self.deaf, vehicle.armed = True, True
            return None
        if p[4] in (1, 2, 4):
            return self._calibrate_accel(int(p[4]))
        return UNSUPPORTED

    def _done(self, result: int, values: dict[str, Value]) -> None:
        self._reply(result)
        self._stored.write(values)

    def store_gyro_offsets(self) -> None:
        """Calibrate the gyros at this instant as at boot, without a PARAM_VALUE of the new offsets."""
        now = self._vehicle.time
        offsets, _ = calibration.gyro_offsets(self._sensors, now)
        self._stored.write(calibration.gyro_values(self._sensors, now, offsets), announce=False)

    def _calibrate_gyros(self, then: Callable[[int, dict[str, Value]], None]) -> None:
        vehicle, reply = self._vehicle, self._reply
        offsets, duration = calibration.gyro_offsets(self._sensors, vehicle.time)
        self._stall(duration + GYRO_OVERHEAD_S)

        def finish() -> None:
            self._reply = reply
            self._gyros_settled_at = vehicle.time + GYRO_SETTLE_S
            then(ACCEPTED, calibration.gyro_values(self._sensors, vehicle.time, offsets))

        vehicle.at(duration + GYRO_OVERHEAD_S, finish)

    def _calibrate_accel(self, kind: int) -> int | None:
        vehicle = self._vehicle
        if vehicle.time - self._last_accel < ACCEL_AGAIN_S:
            return REJECTED
        self._calibrate_gyros({1: self._six_positions, 2: self._level, 4: self._simple}[kind])
        return None

    def _six_positions(self, result: int, gyro: dict[str, Value]) -> None:
        self._last_accel = self._vehicle.time
        self._done(result, gyro)
        self._accel_calibration.start()

    def _level(self, _result: int, gyro: dict[str, Value]) -> None:
        vehicle, reply = self._vehicle, self._reply
        self._stored.write(gyro)
        trim = calibration.level_trim(self._sensors, vehicle.time)
        self._stall(LEVEL_S)

        def finish() -> None:
            reply(ACCEPTED if trim else FAILED)
            if trim is None:
                vehicle.say("Trim over maximum of 10 degrees", dialect.MAV_SEVERITY_INFO)
                return
            self._last_accel = vehicle.time
            self._stored.write({"AHRS_TRIM_X": trim[0], "AHRS_TRIM_Y": trim[1], "AHRS_TRIM_Z": 0.0})
            roll, pitch = (math.degrees(angle) for angle in trim)
            vehicle.say(f"Trim OK: roll={roll:.2f} pitch={pitch:.2f} yaw=0.00")

        vehicle.at(LEVEL_S, finish)

    def _simple(self, _result: int, gyro: dict[str, Value]) -> None:
        vehicle, reply = self._vehicle, self._reply
        self._stored.write(gyro)
        values = calibration.simple_accel_values(self._sensors, vehicle.time)
        self._stall(LEVEL_S)

        def finish() -> None:
            reply(ACCEPTED)
            self._last_accel = vehicle.time
            self._stored.write(values)
            self._stored.mark_accels(len(self._sensors.chips))

        vehicle.at(LEVEL_S, finish)

    def _stall(self, seconds: float) -> None:
        self._stalled_until = self._vehicle.time + seconds

    def _start_mag_calibration(self, _channel: MavlinkChannel, p: Parameters) -> int:
        if self._vehicle.armed:
            return FAILED
        return self._mag_calibration.start(int(p[0]), autosave=bool(p[2]))
