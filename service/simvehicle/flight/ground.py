"""The flying vehicle's side of MAVLink: what ArduCopter in GUIDED and AUTO answers, and streams once it is asked.

It covers streams, arming, modes, targets and missions. Anything else is UNSUPPORTED or silently ignored.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle.flight.airframe import euler_of
from mavcal.service.simvehicle.flight.items import FRAMES, WHOLE_DEGREE, Command, Item
from mavcal.service.simvehicle.flight.modes import LOOP_HZ, Guidance, Mode
from mavcal.service.simvehicle.flight.vehicle import FlyingVehicle
from mavcal.service.simvehicle.links import SimEndpoint
from mavcal.service.simvehicle.wire import FORCED, Packer, Received, command_parameters

ASK_AGAIN_S, GIVE_UP_S = 1.0, 8.0
MOST_ITEMS = 700
Address = tuple[int, int]
SYSTEM = 1
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
LIST_PER_LOOP = 4
"""Parameters of a list that are sent after each loop: 1600 a second of vehicle time."""
_TEXT_BYTES = 50
_IGNORE_VELOCITY = 0b000111 << 3
_IGNORE_YAW, _IGNORE_YAW_RATE = 1 << 10, 1 << 11
_BODY_FRAMES = (dialect.MAV_FRAME_BODY_NED, dialect.MAV_FRAME_BODY_OFFSET_NED)
_VTOL_NONE = 0
_CAPABILITIES = (
    dialect.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | dialect.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_VERSION = 4 << 24 | 7 << 16
"""The simulated version: 4.7.0-dev."""


class MissionLink:
    """The mission protocol: an upload that asks for one item after the other, and a download.

    As ArduPilot's (``MissionItemProtocol.cpp``): an item that does not come is asked for again, and an upload that
    stands still is given up. Only missions; fences and rally points are not known. `send` sends one message.
    """

    def __init__(self, vehicle: FlyingVehicle, send: Callable[[Any], None]) -> None:
        self._vehicle, self._send = vehicle, send
        self._coming: list[Item] = []
        self._expected = 0
        self._from: Address | None = None
        self._asked = self._heard = 0.0
        self._handlers: Mapping[str, Callable[[Any, Address], None]] = {
            "MISSION_COUNT": self._begin,
            "MISSION_ITEM_INT": self._take,
            "MISSION_REQUEST_LIST": self._list,
            "MISSION_REQUEST_INT": self._give,
            "MISSION_REQUEST": self._give,
            "MISSION_CLEAR_ALL": self._clear,
        }
        vehicle.auto.reached = lambda number: send(dialect.MAVLink_mission_item_reached_message(number))

    def handle(self, received: Received) -> bool:
        """Take in one message; False: it is not one of this protocol."""
        handler = self._handlers.get(received.name)
        if handler is None:
            return False
        if received.message.mission_type != dialect.MAV_MISSION_TYPE_MISSION:
            self._answer((received.system, received.component), dialect.MAV_MISSION_UNSUPPORTED)
        else:
            handler(received.message, (received.system, received.component))
        return True

    def send_due(self) -> None:
        """Request an item again that did not arrive in time."""
        now = self._vehicle.time
        if self._from is None:
            return
        if now - self._heard > GIVE_UP_S:
            self._end(dialect.MAV_MISSION_OPERATION_CANCELLED)
        elif now - self._asked > ASK_AGAIN_S:
            self._ask()

    def current(self) -> Any:
        """MISSION_CURRENT: the item that is flown."""
        auto = self._vehicle.auto
        return dialect.MAVLink_mission_current_message(auto.current, len(auto.items), int(auto.state))

    def _begin(self, m: Any, sender: Address) -> None:
        if m.count > MOST_ITEMS:
            self._answer(sender, dialect.MAV_MISSION_NO_SPACE)
            return
        self._coming, self._expected, self._from = [], int(m.count), sender
        self._heard = self._vehicle.time
        self._next()

    def _take(self, m: Any, sender: Address) -> None:
        if self._from is None or sender != self._from or m.seq != len(self._coming):
            self._answer(sender, dialect.MAV_MISSION_INVALID_SEQUENCE)
            return
        fault = dialect.MAV_MISSION_ACCEPTED if m.seq == 0 else _result_of(m)
        if fault != dialect.MAV_MISSION_ACCEPTED:
            self._end(fault)
            return
        self._coming.append(_item(m))
        self._heard = self._vehicle.time
        self._next()

    def _next(self) -> None:
        if len(self._coming) < self._expected:
            self._ask()
            return
        self._vehicle.load_mission(self._coming)
        self._end(dialect.MAV_MISSION_ACCEPTED)

    def _ask(self) -> None:
        assert self._from is not None
        self._asked = self._vehicle.time
        self._send(dialect.MAVLink_mission_request_message(*self._from, len(self._coming)))

    def _end(self, result: int) -> None:
        if self._from is not None:
            self._answer(self._from, result)
        self._from = None

    def _answer(self, to: Address, result: int) -> None:
        self._send(dialect.MAVLink_mission_ack_message(*to, result))

    def _list(self, _m: Any, sender: Address) -> None:
        self._send(dialect.MAVLink_mission_count_message(*sender, len(self._vehicle.auto.items)))

    def _give(self, m: Any, sender: Address) -> None:
        items = self._vehicle.auto.items
        if m.seq >= len(items):
            self._answer(sender, dialect.MAV_MISSION_INVALID_SEQUENCE)
            return
        item = items[m.seq]
        place = round(WHOLE_DEGREE * item.latitude), round(WHOLE_DEGREE * item.longitude), item.altitude
        head = (m.seq, item.frame, item.command, int(m.seq == self._vehicle.auto.current), 1)
        self._send(dialect.MAVLink_mission_item_int_message(*sender, *head, *item.parameters, *place))

    def _clear(self, _m: Any, sender: Address) -> None:
        self._vehicle.load_mission([])
        self._answer(sender, dialect.MAV_MISSION_ACCEPTED)


def _result_of(m: Any) -> int:
    """MAV_MISSION_RESULT of an item: accepted, or why it cannot be flown."""
    if m.command not in set(Command):
        return int(dialect.MAV_MISSION_UNSUPPORTED)
    if m.frame not in FRAMES:
        return int(dialect.MAV_MISSION_UNSUPPORTED_FRAME)
    whole = all(math.isfinite(value) for value in (m.param1, m.param2, m.param3, m.param4, m.z))
    return int(dialect.MAV_MISSION_ACCEPTED if whole else dialect.MAV_MISSION_INVALID)


def _item(m: Any) -> Item:
    given = (float(m.param1), float(m.param2), float(m.param3), float(m.param4))
    return Item(int(m.command), int(m.frame), given, m.x / WHOLE_DEGREE, m.y / WHOLE_DEGREE, float(m.z))


class GroundLink:
    """One link of the vehicle: takes in what a ground station sends, and sends what is due."""

    def __init__(self, vehicle: FlyingVehicle, endpoint: SimEndpoint) -> None:
        self._vehicle, self._endpoint = vehicle, endpoint
        self._packer = Packer(SYSTEM)
        self._listing: list[str] = []
        self._asked: list[int] = []
        self._names = list(vehicle.parameters)
        self._due: dict[int, tuple[int, int]] = {dialect.MAVLINK_MSG_ID_HEARTBEAT: (LOOP_HZ, 0)}
        self._mission = MissionLink(vehicle, self._send)
        self.heard = False
        vehicle.say = self._say
        self._builders: dict[int, Callable[[], Any]] = {
            dialect.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            dialect.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position,
            dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position,
            dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._extended_state,
            dialect.MAVLINK_MSG_ID_SYS_STATUS: self._status,
            dialect.MAVLINK_MSG_ID_MISSION_CURRENT: self._mission.current,
            dialect.MAVLINK_MSG_ID_HOME_POSITION: self._home,
            dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._version,
        }
        self._commands: dict[int, Callable[[list[float]], int]] = {
            dialect.MAV_CMD_COMPONENT_ARM_DISARM: self._arm,
            dialect.MAV_CMD_NAV_TAKEOFF: lambda p: self._answer(vehicle.takeoff(p[6])),
            dialect.MAV_CMD_NAV_LAND: lambda _p: self._answer(vehicle.set_mode(Mode.LAND)),
            dialect.MAV_CMD_DO_SET_MODE: lambda p: self._answer(vehicle.set_mode(int(p[1]))),
            dialect.MAV_CMD_MISSION_START: lambda _p: self._answer(vehicle.start_mission()),
            dialect.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            dialect.MAV_CMD_REQUEST_MESSAGE: self._request,
        }
        self._handlers: dict[str, Callable[[Any], None]] = {
            "SET_MODE": lambda m: self._set_mode(int(m.custom_mode)),
            "SET_POSITION_TARGET_LOCAL_NED": self._position_target,
            "SET_ATTITUDE_TARGET": self._attitude_target,
            "PARAM_REQUEST_LIST": lambda _m: self._listing.extend(self._names),
            "PARAM_REQUEST_READ": self._read_parameter,
            "PARAM_SET": self._set_parameter,
        }

    # --- in and out

    def poll(self) -> None:
        """Take in what has arrived."""
        for data in self._endpoint.poll():
            for received in self._endpoint.messages(data):
                self.heard = True
                if getattr(received.message, "target_system", 0) in (0, SYSTEM):
                    self._handle(received)

    def _handle(self, received: Received) -> None:
        if received.name in ("COMMAND_LONG", "COMMAND_INT"):
            number = int(received.message.command)
            command = self._commands.get(number)
            result = UNSUPPORTED if command is None else command(command_parameters(received))
            to = (received.system, received.component)
            self._send(dialect.MAVLink_command_ack_message(number, result, 0, 0, *to))
        elif received.name in self._handlers:
            self._handlers[received.name](received.message)
        else:
            self._mission.handle(received)

    def send_due(self) -> None:
        """Send what falls due in this loop."""
        loops = self._vehicle.loops
        for number, (every, at) in self._due.items():
            if loops >= at:
                self._due[number] = (every, loops + every)
                self._send(self._builders[number]())
        for number in self._asked:  # after the acknowledgement, as the firmware does
            self._send(self._builders[number]())
        self._asked.clear()
        for name in self._listing[:LIST_PER_LOOP]:
            self._send_parameter(name)
        del self._listing[:LIST_PER_LOOP]
        self._mission.send_due()

    def _send(self, message: Any) -> None:
        self._endpoint.send(self._packer.pack(message))

    def _say(self, severity: int, text: str) -> None:
        self._send(dialect.MAVLink_statustext_message(severity, text.encode()[:_TEXT_BYTES]))

    # --- commands

    @staticmethod
    def _answer(done: bool) -> int:
        return ACCEPTED if done else FAILED

    def _arm(self, p: list[float]) -> int:
        return self._answer(self._vehicle.arm() if p[0] == 1 else self._vehicle.disarm(forced=p[1] == FORCED))

    def _set_interval(self, p: list[float]) -> int:
        number = int(p[0])
        if number not in self._builders:
            return DENIED
        every = max(round(p[1] * 1e-6 * LOOP_HZ), 1) if p[1] > 0 else LOOP_HZ
        self._due[number] = (every, self._vehicle.loops)
        if p[1] < 0:
            del self._due[number]
        return ACCEPTED

    def _request(self, p: list[float]) -> int:
        if int(p[0]) not in self._builders:
            return FAILED
        self._asked.append(int(p[0]))
        return ACCEPTED

    def _set_mode(self, number: int) -> None:
        self._vehicle.set_mode(number)

    # --- targets

    def _position_target(self, m: Any) -> None:
        if m.type_mask & _IGNORE_VELOCITY:
            return
        north, east = float(m.vx), float(m.vy)
        heading = self._vehicle.estimate.euler[2]
        yaw = float(m.yaw)
        if m.coordinate_frame in _BODY_FRAMES:
            c, s = math.cos(heading), math.sin(heading)
            north, east, yaw = c * north - s * east, s * north + c * east, yaw + heading
        values = (north, east, float(m.vz), yaw, float(m.yaw_rate))
        if all(math.isfinite(value) for value in values):
            wanted = None if m.type_mask & _IGNORE_YAW else yaw
            rate = 0.0 if m.type_mask & _IGNORE_YAW_RATE else values[4]
            self._vehicle.follow_velocity(values[:3], wanted, rate)

    def _attitude_target(self, m: Any) -> None:
        w, x, y, z = (float(one) for one in m.q)
        length = math.sqrt(w * w + x * x + y * y + z * z)
        if 0.9 < length < 1.1 and math.isfinite(m.thrust):
            self._vehicle.follow_attitude(euler_of((w / length, x / length, y / length, z / length)), float(m.thrust))

    # --- parameters

    def _read_parameter(self, m: Any) -> None:
        name = m.param_id if m.param_index < 0 else (self._names[m.param_index : m.param_index + 1] or [""])[0]
        if name in self._vehicle.parameters:
            self._send_parameter(name)

    def _set_parameter(self, m: Any) -> None:
        if math.isfinite(m.param_value) and self._vehicle.store(m.param_id, m.param_value):
            self._send_parameter(m.param_id)

    def _send_parameter(self, name: str) -> None:
        value, count = self._vehicle.parameters[name], len(self._names)
        real = dialect.MAV_PARAM_TYPE_REAL32
        index = self._names.index(name)
        self._send(dialect.MAVLink_param_value_message(name.encode(), value, real, count, index))

    # --- messages

    @property
    def _ms(self) -> int:
        return self._vehicle.time_us // 1000

    def _heartbeat(self) -> Any:
        vehicle = self._vehicle
        mode = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        mode |= dialect.MAV_MODE_FLAG_SAFETY_ARMED if vehicle.armed else 0
        status = dialect.MAV_STATE_ACTIVE if vehicle.armed else dialect.MAV_STATE_STANDBY
        quad, ardupilot = dialect.MAV_TYPE_QUADROTOR, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA
        return dialect.MAVLink_heartbeat_message(quad, ardupilot, mode, int(vehicle.mode), status, 3)

    def _version(self) -> Any:
        """AUTOPILOT_VERSION without a board, as from SITL."""
        zero = [0] * 8
        return dialect.MAVLink_autopilot_version_message(_CAPABILITIES, _VERSION, 0, 0, 0, zero, zero, zero, 0, 0, 0)

    def _attitude(self) -> Any:
        return dialect.MAVLink_attitude_message(self._ms, *self._vehicle.estimate.euler, *self._vehicle.units[0].gyro)

    def _local_position(self) -> Any:
        vehicle = self._vehicle
        return dialect.MAVLink_local_position_ned_message(self._ms, *vehicle.estimate.place, *vehicle.estimate.velocity)

    def _global_position(self) -> Any:
        vehicle = self._vehicle
        latitude, longitude = vehicle.position()
        height = -vehicle.estimate.place[2]
        heading = round(math.degrees(vehicle.estimate.euler[2]) % 360.0 * 100.0) % 36000
        above = round(1000.0 * (vehicle.altitude_home + height))
        speeds = (round(100.0 * one) for one in vehicle.estimate.velocity)
        where = (round(1e7 * latitude), round(1e7 * longitude), above, round(1000.0 * height))
        return dialect.MAVLink_global_position_int_message(self._ms, *where, *speeds, heading)

    def _home(self) -> Any:
        p = self._vehicle.parameters
        where = (round(1e7 * p["SIM_OPOS_LAT"]), round(1e7 * p["SIM_OPOS_LNG"]), round(1000.0 * p["SIM_OPOS_ALT"]))
        zeros = (0.0, 0.0, 0.0)
        return dialect.MAVLink_home_position_message(*where, *zeros, [1.0, 0.0, 0.0, 0.0], *zeros)

    def _extended_state(self) -> Any:
        vehicle = self._vehicle
        state = dialect.MAV_LANDED_STATE_ON_GROUND
        if vehicle.flying:
            state = dialect.MAV_LANDED_STATE_IN_AIR
            if vehicle.guidance is Guidance.TAKEOFF:
                state = dialect.MAV_LANDED_STATE_TAKEOFF
            elif vehicle.mode is Mode.LAND or (vehicle.mode is Mode.AUTO and vehicle.auto.landing):
                state = dialect.MAV_LANDED_STATE_LANDING
        return dialect.MAVLink_extended_sys_state_message(_VTOL_NONE, state)

    def _status(self) -> Any:
        battery = self._vehicle.battery
        volts, amps = round(1000.0 * battery.voltage), round(100.0 * battery.current)
        return dialect.MAVLink_sys_status_message(0, 0, 0, 500, volts, amps, -1, 0, 0, 0, 0, 0, 0)
