"""Messages common to both personalities: position, attitude, battery, pressure, time."""

from __future__ import annotations

import abc
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle.corrections import as_float32
from mavcal.service.simvehicle.rotation import (
    Array,
    conjugate,
    euler_from_quaternions,
    multiply,
    quaternion_from_euler,
    shortest_rotation,
)
from mavcal.service.simvehicle.vehicle import FlightController, MavlinkChannel
from mavcal.service.simvehicle.world import ImuReading, MotionState, SimWorld

Builder = Callable[["Block", int], Any]
Rows = list[list[int]]
ImuIntegers = tuple[Rows, Rows, Rows, list[int]]
Floats = list[list[float]]

BATTERY_VOLTS = 12.6
BATTERY_OHMS = 0.01
PWM_IDLE, PWM_SPAN = 1000, 1000
UNUSED_CELL = 65535
SEA_LEVEL_HPA = 1013.25
SCALE_HEIGHT_M = 8434.5
BARO_WARMER_THAN_IMU = 1.0  # °C: HIGHRES_IMU carries this temperature on ArduPilot


@dataclass
class Block:
    """State at the instants of one tick: the true one, the estimated attitude, and the motors."""

    t: list[float]
    state: MotionState
    q_estimated: Array
    euler: list[list[float]]
    rate: list[list[float]]
    throttle: list[float]
    current: list[float]


def make_block(
    world: SimWorld, state: MotionState, corrected_force: Array, corrected_rate: Array, trim: Array
) -> Block:
    """State as estimated from corrected readings: the true heading, and the tilt of the accelerometer."""
    q = estimated_attitude(state, corrected_force, trim)
    return Block(
        state.t.tolist(),
        state,
        q,
        euler_from_quaternions(q).tolist(),
        as_float32(corrected_rate).tolist(),
        world.throttle.at(state.t).tolist(),
        world.current.at(state.t).tolist(),
    )


def estimated_attitude(state: MotionState, corrected_force: Array, trim: Array) -> Array:
    """Attitude (N, 4) with the down direction of the corrected accelerometer, minus the level trim."""
    usable = np.isfinite(corrected_force).all(axis=1) & (np.linalg.norm(corrected_force, axis=1) > 1.0)
    seen = np.where(usable[:, None], corrected_force, state.force)
    tilt = shortest_rotation(seen, state.force)
    untrim = conjugate(quaternion_from_euler(float(trim[0]), float(trim[1]), 0.0))
    return multiply(multiply(state.q, tilt), untrim)


def pressure_hpa(altitude_m: float) -> float:
    """Static pressure at an altitude."""
    return SEA_LEVEL_HPA * math.exp(-altitude_m / SCALE_HEIGHT_M)


def milliseconds(seconds: float) -> int:
    """time_boot_ms of a vehicle time."""
    return int(seconds * 1000 + 1e-6) & 0xFFFFFFFF


def microseconds(seconds: float) -> int:
    """time_usec of a vehicle time."""
    return int(seconds * 1e6 + 0.5)


class Telemetry:
    """Builders of the common messages, by message id."""

    def __init__(self, vehicle: FlightController) -> None:
        self._vehicle = vehicle
        self.builders: dict[int, Builder] = {
            dialect.MAVLINK_MSG_ID_SYSTEM_TIME: self._system_time,
            dialect.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw,
            dialect.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: self._attitude_quaternion,
            dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position,
            dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position,
            dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: self._servo_output,
            dialect.MAVLINK_MSG_ID_VFR_HUD: self._vfr_hud,
            dialect.MAVLINK_MSG_ID_BATTERY_STATUS: self._battery,
            dialect.MAVLINK_MSG_ID_SCALED_PRESSURE: self._pressure,
            dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._extended_sys_state,
            dialect.MAVLINK_MSG_ID_VIBRATION: self._vibration,
        }

    @property
    def landed_state(self) -> int:
        """ON_GROUND unless the motors lift."""
        return int(dialect.MAV_LANDED_STATE_IN_AIR if self.flying else dialect.MAV_LANDED_STATE_ON_GROUND)

    @property
    def flying(self) -> bool:
        """Armed with more than a quarter of throttle: the simulated vehicle counts as in the air."""
        throttle = self._vehicle.world.throttle.at(np.array([self._vehicle.time]))[0]
        return self._vehicle.armed and bool(throttle > 0.25)

    def autopilot_version(self, capabilities: int, version: int, custom: bytes) -> Any:
        """AUTOPILOT_VERSION of this vehicle."""
        zero = [0] * 8
        uid2 = list(self._vehicle.uid2())
        return dialect.MAVLink_autopilot_version_message(
            capabilities, version, 0, 0, 0, list(custom.ljust(8, b"\0")[:8]), zero, zero, 0, 0, 0, uid2
        )

    def battery_volts(self, amps: float) -> float:
        """Terminal voltage under load."""
        return BATTERY_VOLTS - BATTERY_OHMS * amps

    def _system_time(self, block: Block, i: int) -> Any:
        offset = block.t[i] - self._vehicle.time
        unix_us = microseconds(self._vehicle.unix_time_s() + offset) if self._vehicle.config.gps else 0
        return dialect.MAVLink_system_time_message(unix_us, milliseconds(block.t[i]))

    def _gps_raw(self, block: Block, i: int) -> Any:
        c = self._vehicle.config
        fix, satellites = (3, 10) if c.gps else (1, 0)
        lat, lon, alt = (_e7(c.latitude_deg), _e7(c.longitude_deg), int(c.altitude_m * 1000)) if c.gps else (0, 0, 0)
        return dialect.MAVLink_gps_raw_int_message(
            microseconds(block.t[i]), fix, lat, lon, alt, 121, 200, 0, 0, satellites
        )

    def _attitude(self, block: Block, i: int) -> Any:
        return dialect.MAVLink_attitude_message(milliseconds(block.t[i]), *block.euler[i], *block.rate[i])

    def _attitude_quaternion(self, block: Block, i: int) -> Any:
        q = block.q_estimated[i].tolist()
        return dialect.MAVLink_attitude_quaternion_message(milliseconds(block.t[i]), *q, *block.rate[i])

    def _global_position(self, block: Block, i: int) -> Any:
        c = self._vehicle.config
        heading = int(math.degrees(block.euler[i][2]) % 360 * 100)
        lat, lon = (_e7(c.latitude_deg), _e7(c.longitude_deg)) if c.gps else (0, 0)
        return dialect.MAVLink_global_position_int_message(
            milliseconds(block.t[i]), lat, lon, int(c.altitude_m * 1000), 0, 0, 0, 0, heading
        )

    def _local_position(self, block: Block, i: int) -> Any:
        return dialect.MAVLink_local_position_ned_message(milliseconds(block.t[i]), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def _servo_output(self, block: Block, i: int) -> Any:
        pwm = PWM_IDLE + int(PWM_SPAN * block.throttle[i])
        motors = [pwm] * 4 + [0] * 4
        return dialect.MAVLink_servo_output_raw_message(microseconds(block.t[i]) & 0xFFFFFFFF, 0, *motors)

    def _vfr_hud(self, block: Block, i: int) -> Any:
        heading = int(math.degrees(block.euler[i][2]) % 360)
        throttle = round(100 * block.throttle[i])
        return dialect.MAVLink_vfr_hud_message(0.0, 0.0, heading, throttle, self._vehicle.config.altitude_m, 0.0)

    def _battery(self, block: Block, i: int) -> Any:
        amps = block.current[i]
        cells = [int(self.battery_volts(amps) * 1000)] + [UNUSED_CELL] * 9
        return dialect.MAVLink_battery_status_message(0, 0, 1, 32767, cells, int(amps * 100), 0, -1, 95)

    def _pressure(self, block: Block, i: int) -> Any:
        temperature = int(self.baro_temperature(block.t[i]) * 100)
        pressure = pressure_hpa(self._vehicle.config.altitude_m)
        return dialect.MAVLink_scaled_pressure_message(milliseconds(block.t[i]), pressure, 0.0, temperature)

    def baro_temperature(self, t: float) -> float:
        """Temperature of the barometer, °C."""
        return float(self._vehicle.world.thermal.board(np.array([t]))[0]) + BARO_WARMER_THAN_IMU

    def _extended_sys_state(self, _block: Block, _i: int) -> Any:
        vtol = dialect.MAV_VTOL_STATE_MC if self._vehicle.config.autopilot == "ardupilot" else 0
        return dialect.MAVLink_extended_sys_state_message(vtol, self.landed_state)

    def _vibration(self, block: Block, i: int) -> Any:
        shaking = self._vehicle.world.shaking
        levels = (0.0, 0.0, shaking.level) if self._vehicle.config.autopilot == "px4" else (shaking.level,) * 3
        return dialect.MAVLink_vibration_message(microseconds(block.t[i]), *levels, shaking.clips, 0, 0)


def _e7(degrees: float) -> int:
    return round(degrees * 1e7)


class InertialSensors(Protocol):
    """Corrections of the readings of inertial units."""

    world: SimWorld

    def imu(self, instance: int, state: MotionState) -> ImuReading:
        """Corrected readings of one instance at the times of a state."""


class Readings(abc.ABC):
    """The sensors at the instants of one tick, converted once: every message of an instant carries the same sample."""

    def __init__(self, sensors: InertialSensors, times: list[float]) -> None:
        self._inertial = sensors
        self.state = sensors.world.state(np.asarray(times))
        self._imus: dict[int, ImuReading] = {}
        self._integers: dict[int, ImuIntegers] = {}

    def imu(self, instance: int) -> ImuReading:
        """One IMU's corrected readings."""
        if instance not in self._imus:
            self._imus[instance] = self._inertial.imu(instance, self.state)
        return self._imus[instance]

    def integers(self, instance: int) -> ImuIntegers:
        """mG, mrad/s, mGauss and centidegrees of an instance, as the C++ casts make them."""
        if instance not in self._integers:
            self._integers[instance] = self._as_integers(instance)
        return self._integers[instance]

    @abc.abstractmethod
    def _as_integers(self, instance: int) -> ImuIntegers:
        """See `integers`, made anew."""

    @property
    @abc.abstractmethod
    def block(self) -> Block:
        """Attitude and the like."""


R = TypeVar("R", bound=Readings)


def _of_block(builder: Builder) -> Callable[[Readings, int], Any]:
    return lambda readings, i: builder(readings.block, i)


class AutopilotMessages(abc.ABC, Generic[R]):
    """Every message of an autopilot, on its stream or one at a time.

    `builders` make a message of the readings of a tick and the number of an instant, by message id.
    """

    def __init__(self, vehicle: FlightController, telemetry: Telemetry) -> None:
        self._vehicle, self._telemetry = vehicle, telemetry
        self.builders: dict[int, Callable[[R, int], Any]] = {
            message_id: _of_block(builder) for message_id, builder in telemetry.builders.items()
        }

    @abc.abstractmethod
    def readings(self, times: list[float]) -> R:
        """The sensors at these instants."""

    def emit(self, due: list[tuple[float, int, MavlinkChannel, int]], times: list[float]) -> None:
        """Send the messages (time, order, channel, message id) that fall due; `times` are their instants."""
        readings = self.readings(times)
        position = {moment: i for i, moment in enumerate(times)}
        for moment, _, channel, message_id in due:
            message = self.builders[message_id](readings, position[moment])
            if message is not None:
                channel.send(message)

    def interval(self, channel: MavlinkChannel, message_id: int) -> Any:
        """MESSAGE_INTERVAL: 0 for a message that is unknown, −1 for one that is off."""
        stream = channel.streams.get(message_id)
        known_us = -1 if stream is None else stream.interval_us
        interval_us = known_us if message_id in self.builders else 0
        return dialect.MAVLink_message_interval_message(message_id & 0xFFFF, interval_us)

    def one(self, message_id: int) -> Any:
        """One message of this instant, for REQUEST_MESSAGE; None if it cannot be sent."""
        builder = self.builders.get(message_id)
        return None if builder is None else builder(self.readings([self._vehicle.time]), 0)
