"""ArduPilot's commands: what it does, what it refuses, and how late it says so."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle import ardupilot_calibration as calibration
from mavcal.service.simvehicle import ardupilot_parameters as names
from mavcal.service.simvehicle.ardupilot_accelcal import AccelCalibration
from mavcal.service.simvehicle.ardupilot_magcal import MagCalibration
from mavcal.service.simvehicle.parameters import Value
from mavcal.service.simvehicle.vehicle import Channel
from mavcal.service.simvehicle.wire import Received, command_parameters

if TYPE_CHECKING:
    from mavcal.service.simvehicle.ardupilot import ArduPilotVehicle

CAPABILITIES = 64495
VERSION = 0x04070000
GIT_HASH = b"90700977"
ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
ACCEPT_CODE = 76
FORCE_ARM = 21196
ACCEL_AGAIN_S = 5.0  # a second accelerometer calibration sooner than this is refused
GYRO_OVERHEAD_S = 0.03
GYRO_SETTLE_S = 10.0  # the arming check wants gyroscopes that have agreed for so long
LEVEL_S = 0.55
REBOOT_DELAY_S = 0.02
INCONSISTENT_GYRO = math.radians(5.0)
INCONSISTENT_ACCEL_DEFAULT = 0.75

Parameters = list[float]


class ArduPilotCommands:
    """COMMAND_LONG and COMMAND_INT, and what the onboard routines keep between them."""

    def __init__(self, vehicle: ArduPilotVehicle) -> None:
        self._vehicle = vehicle
        self.mag_calibration = MagCalibration(vehicle)
        self.accel_calibration = AccelCalibration(vehicle)
        self.periodic: dict[int, Callable[[], Any]] = {
            dialect.MAVLINK_MSG_ID_MAG_CAL_PROGRESS: self.mag_calibration.progress_message,
            dialect.MAVLINK_MSG_ID_MAG_CAL_REPORT: self.mag_calibration.report_message,
            dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._version,
            dialect.MAVLINK_MSG_ID_HEARTBEAT: vehicle.heartbeat,
        }
        self.deaf = False  # compassmot runs: nothing is answered until a reboot
        self.accel_ids_stored: set[int] = set()
        self._stalled_until = self._last_accel = self._gyros_settled_at = -math.inf
        self._reboot_reason: str | None = None
        self._reply: Callable[[int], None] = lambda _result: None
        self._handlers: dict[int, Callable[[Channel, Parameters], int | None]] = {
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
            dialect.MAV_CMD_DO_ACCEPT_MAG_CAL: lambda _c, _p: self.mag_calibration.accept(),
            dialect.MAV_CMD_DO_CANCEL_MAG_CAL: lambda _c, _p: self.mag_calibration.cancel(),
        }

    @property
    def stalled(self) -> bool:
        """Whether a blocking calibration holds up the streams."""
        return self._vehicle.time < self._stalled_until

    def boot(self) -> None:
        """Forget what a reboot ends."""
        self.deaf, self._reboot_reason = False, None
        self._stalled_until = self._last_accel = self._gyros_settled_at = -math.inf
        self.mag_calibration.cancel()
        self.accel_calibration.cancel()

    def handle(self, channel: Channel, received: Received) -> None:
        """Execute one command and acknowledge it, unless its handler does so later."""
        command = int(received.message.command)
        if command == dialect.MAV_CMD_ACCELCAL_VEHICLE_POS:
            self.accel_calibration.answer(command_parameters(received)[0])
            return
        handler = self._handlers.get(command)
        reply_to = (received.system, received.component)
        self._reply = partial(self._acknowledge, channel, command, reply_to)
        result = UNSUPPORTED if handler is None else handler(channel, command_parameters(received))
        if result is not None:
            self._reply(result)

    def _acknowledge(self, channel: Channel, command: int, to: tuple[int, int], result: int) -> None:
        self._vehicle.send(channel, dialect.MAVLink_command_ack_message(command, result, 0, 0, *to))

    # --- messages

    def _set_interval(self, channel: Channel, p: Parameters) -> int:
        if p[2] != 0:
            return DENIED
        if not self._vehicle.knows_message(int(p[0])):
            self._vehicle.say(f"No ap_message for mavlink id ({int(p[0])})", channel=channel)
            return DENIED
        accepted, text = self._vehicle.set_interval(channel, int(p[0]), p[1])
        if text:
            self._vehicle.at(0.0, lambda: self._vehicle.say(text, channel=channel))
        return ACCEPTED if accepted else DENIED

    def _get_interval(self, channel: Channel, p: Parameters) -> int:
        interval = self._vehicle.interval_us(channel, int(p[0]))
        self._vehicle.send(channel, dialect.MAVLink_message_interval_message(int(p[0]) & 0xFFFF, interval))
        return ACCEPTED

    def _request_message(self, channel: Channel, p: Parameters) -> int | None:
        if int(p[0]) == dialect.MAVLINK_MSG_ID_MESSAGE_INTERVAL:
            return self._get_interval(channel, p[1:])
        message = self._vehicle.one(int(p[0]))
        if message is None:
            return FAILED
        self._reply(ACCEPTED)
        self._vehicle.send(channel, message)
        return None

    def _capabilities(self, channel: Channel, p: Parameters) -> int:
        if p[0] != 1:
            return FAILED
        self._vehicle.send(channel, self._version())
        return ACCEPTED

    def _version(self) -> Any:
        return self._vehicle.telemetry.autopilot_version(CAPABILITIES, VERSION, GIT_HASH)

    # --- arming and restarting

    def _arm(self, _channel: Channel, p: Parameters) -> int:
        vehicle = self._vehicle
        wanted = p[0] == 1
        if wanted and not vehicle.armed and p[1] != FORCE_ARM:
            reasons = self.arming_faults()
            if reasons:
                vehicle.at(0.0, lambda: self._complain("Arm", reasons))
                return FAILED
        vehicle.armed = wanted
        return ACCEPTED

    def arming_faults(self) -> list[str]:
        """Why arming is refused; empty where it is not."""
        vehicle = self._vehicle
        if vehicle.table.get("ARMING_CHECK", 1.0) == 0:
            return []
        if self._reboot_reason:
            return [self._reboot_reason]
        if self.mag_calibration.running:
            return ["Compass calibration running"]
        if any(not self._accel_calibrated(k) for k in range(len(vehicle.sensors.chips))):
            return ["3D Accel calibration needed"]
        return self._inconsistencies()

    def _accel_calibrated(self, instance: int) -> bool:
        table = self._vehicle.table
        if not table.get(names.use_name(instance), 1.0):
            return True
        stored = instance in self.accel_ids_stored
        return (
            stored
            and bool(np.any(table.vector(names.accel_offset_name(instance)) != 0))
            and bool(np.all(table.vector(names.accel_scale_name(instance), 1.0) != 0))
        )

    def _inconsistencies(self) -> list[str]:
        vehicle = self._vehicle
        state = vehicle.world.state(np.array([vehicle.time]))
        readings = [vehicle.sensors.imu(k, state, 0.1) for k in range(len(vehicle.sensors.chips))]
        limit = vehicle.table.get("ARMING_ACCTHRESH", INCONSISTENT_ACCEL_DEFAULT)
        reasons: list[str] = []
        if any(np.linalg.norm(r.accel[0] - readings[0].accel[0]) > limit for r in readings[1:]):
            reasons.append("Accels inconsistent")
        unsettled = vehicle.time < self._gyros_settled_at
        if unsettled or any(np.linalg.norm(r.gyro[0] - readings[0].gyro[0]) > INCONSISTENT_GYRO for r in readings[1:]):
            reasons.append("Gyros inconsistent")
        return reasons

    def _prearm(self, _channel: Channel, _p: Parameters) -> int:
        vehicle = self._vehicle
        if vehicle.armed:
            return REJECTED
        self._complain("PreArm", self.arming_faults())
        return ACCEPTED

    def _complain(self, prefix: str, reasons: list[str]) -> None:
        for reason in reasons:
            self._vehicle.say(f"{prefix}: {reason}", dialect.MAV_SEVERITY_CRITICAL)

    def _reboot(self, _channel: Channel, p: Parameters) -> int:
        vehicle = self._vehicle
        if vehicle.armed and p[5] != 20190226:
            return FAILED
        if p[0] not in (1, 3):
            return UNSUPPORTED
        vehicle.at(REBOOT_DELAY_S, vehicle.reboot)
        return ACCEPTED

    def _storage(self, _channel: Channel, p: Parameters) -> int:
        if p[0] != 2:
            return DENIED
        for parameter in self._vehicle.table:
            self._vehicle.table.store(parameter.name, parameter.default)
            self._vehicle.table.save(parameter.name)
        return ACCEPTED

    # --- calibration

    def _calibrate(self, channel: Channel, p: Parameters) -> int | None:
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
            self.accel_stored()
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
        self.write(values)

    def store_gyro_offsets(self, *, announce: bool) -> float:
        """Run the gyro calibration of this instant; returns how long the firmware would take."""
        offsets, duration = calibration.gyro_offsets(self._vehicle)
        self.write(calibration.gyro_values(self._vehicle, offsets), announce=announce)
        return duration

    def _calibrate_gyros(self, then: Callable[[int, dict[str, Value]], None]) -> None:
        vehicle, reply = self._vehicle, self._reply
        offsets, duration = calibration.gyro_offsets(vehicle)
        self._stall(duration + GYRO_OVERHEAD_S)

        def finish() -> None:
            self._reply = reply
            self._gyros_settled_at = vehicle.time + GYRO_SETTLE_S
            then(ACCEPTED, calibration.gyro_values(vehicle, offsets))

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
        self.accel_calibration.start()

    def _level(self, _result: int, gyro: dict[str, Value]) -> None:
        vehicle, reply = self._vehicle, self._reply
        self.write(gyro)
        trim = calibration.level_trim(vehicle)
        self._stall(LEVEL_S)

        def finish() -> None:
            reply(ACCEPTED if trim else FAILED)
            if trim is None:
                vehicle.say("Trim over maximum of 10 degrees", dialect.MAV_SEVERITY_INFO)
                return
            self._last_accel = vehicle.time
            self.write({"AHRS_TRIM_X": trim[0], "AHRS_TRIM_Y": trim[1], "AHRS_TRIM_Z": 0.0})
            roll, pitch = (math.degrees(angle) for angle in trim)
            vehicle.say(f"Trim OK: roll={roll:.2f} pitch={pitch:.2f} yaw=0.00")

        vehicle.at(LEVEL_S, finish)

    def _simple(self, _result: int, gyro: dict[str, Value]) -> None:
        vehicle, reply = self._vehicle, self._reply
        self.write(gyro)
        values = calibration.simple_accel_values(vehicle)
        self._stall(LEVEL_S)

        def finish() -> None:
            reply(ACCEPTED)
            self._last_accel = vehicle.time
            self.write(values)
            self.accel_stored()

        vehicle.at(LEVEL_S, finish)

    def accel_stored(self) -> None:
        """The ids of all accelerometers are stored: they count as calibrated."""
        self.accel_ids_stored = set(range(len(self._vehicle.sensors.chips)))

    def _stall(self, seconds: float) -> None:
        self._stalled_until = self._vehicle.time + seconds

    def _start_mag_calibration(self, _channel: Channel, p: Parameters) -> int:
        if self._vehicle.armed:
            return FAILED
        return self.mag_calibration.start(int(p[0]), autosave=bool(p[2]))

    def require_reboot(self, reason: str) -> None:
        """Arming is refused with this reason until the next boot."""
        self._reboot_reason = reason

    def write(self, values: dict[str, Value], *, announce: bool = True) -> None:
        """Store what the firmware itself has found, save it, and tell every link."""
        vehicle = self._vehicle
        for name, value in values.items():
            vehicle.table.store(name, value)
            vehicle.table.save(name)
        if announce:
            vehicle.parameters.announce(list(values))
