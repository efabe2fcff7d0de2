"""The flying vehicle: a loop of 2.5 ms that reads the sensors, controls, logs and advances the physics."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from mavcal.service.simvehicle.flight import air
from mavcal.service.simvehicle.flight.airframe import Airframe
from mavcal.service.simvehicle.flight.auto import AutoFlight
from mavcal.service.simvehicle.flight.control import Controller, Mixer
from mavcal.service.simvehicle.flight.estimator import Estimate, InertialUnit, degrees_from_metres
from mavcal.service.simvehicle.flight.frame import Frame, Vector, rotors_of
from mavcal.service.simvehicle.flight.items import AT_ONCE, Command, Item
from mavcal.service.simvehicle.flight.modes import (
    CLOSE_ENOUGH,
    LOOP_HZ,
    Guidance,
    Log,
    Mode,
    landing_climb,
    takeoff_climb,
)
from mavcal.service.simvehicle.flight.parameters import FlightParameters

SUBSTEPS = 2
"""Physics and sensors at 800 Hz: the fastest thing that is simulated, a filter of 20 Hz, is 40 times slower."""
DT = 1.0 / LOOP_HZ
NAVIGATION = 4
"""Number of loops between two steps of velocity and climb control."""
_WANDER_EVERY = 4
_SPOOL_S = 0.5
"""MOT_SPOOL_TIME."""
_LIFT_PER_S = 0.5
"""Rise of the throttle before lift-off, 1/s."""
_LANDED_S = 1.0
_SHAKEN = 1.0
"""SIM_WIND_TURB from which shaking on the ground passes for flight. Measured: ArduCopter's SITL stayed armed for a
minute after it had landed at 8 m/s with SIM_WIND_TURB 1."""
ATTITUDE_CLIMB_MIDDLE = 0.5
"""Thrust of SET_ATTITUDE_TARGET that holds the height: ArduCopter takes it as a climb rate."""
READY_S = 5.0
"""Time from which the position estimate is good enough for arming, s. Chosen: SITL takes some seconds more."""


class FlyingVehicle:
    """One vehicle in vehicle time; :meth:`loop` is its main loop.

    `frame` and `parameters` determine how it flies; `log` takes its log messages, `say` its texts (severity, text).
    """

    def __init__(self, frame: Frame, parameters: FlightParameters, log: Log, *, seed: int = 1) -> None:
        self.frame, self.parameters, self._log = frame, parameters, log
        rotors = rotors_of(frame, int(parameters["FRAME_TYPE"]))
        heading = math.radians(parameters["SIM_OPOS_HDG"])
        self.altitude_home = parameters["SIM_OPOS_ALT"]
        self.airframe = Airframe(frame, rotors, self.altitude_home, heading)
        self.battery = air.Battery(frame, parameters)
        self.wind = air.Wind(parameters, air.Noise(seed))
        noise = air.Noise(seed + 1)
        self.units = tuple(InertialUnit(n, parameters, LOOP_HZ * SUBSTEPS, noise) for n in (1, 2))
        self.mixer, self.control = Mixer(rotors, parameters), Controller(parameters)
        self.estimate = Estimate(self.airframe, air.Noise(seed + 2))
        self.say: Callable[[int, str], None] = lambda _severity, _text: None
        self.loops = 0
        self.mode = Mode.STABILIZE
        self.armed = self.flying = False
        self.guidance = Guidance.HOLD
        self.pulses = self.mixer.idle(0.0)
        self.ground_temperature = air.temperature(self.altitude_home) - 273.15
        self._spool = 0.0
        self._since = 0.0  # seconds since the last target, or since something stands still
        self._target_height = 0.0
        self._velocity_target = (0.0, 0.0, 0.0)
        self._attitude_target = (0.0, 0.0, 0.0)
        self._yaw_rate = 0.0
        self._climb_target = 0.0
        self._version = parameters.version
        self.mixer.settle(self.battery.voltage)
        for unit in self.units:
            unit.settle(self.airframe.force)
        self.airframe.read(parameters)
        self._density_ratio = air.density(self.altitude_home) / air.SEA_LEVEL_DENSITY
        self.auto = AutoFlight(parameters)
        self.control.reset(self.estimate.euler[2])
        log.begin(self)

    @property
    def _shaken(self) -> bool:
        return self.parameters["SIM_WIND_TURB"] >= _SHAKEN

    @property
    def time_us(self) -> int:
        """Time since boot, us."""
        return self.loops * 1_000_000 // LOOP_HZ

    @property
    def time(self) -> float:
        """Time since boot, s."""
        return self.loops * DT

    def position(self) -> tuple[float, float]:
        """Latitude and longitude, deg."""
        home = self.parameters["SIM_OPOS_LAT"], self.parameters["SIM_OPOS_LNG"]
        return degrees_from_metres(*home, self.airframe.place[0], self.airframe.place[1])

    def pressure(self) -> float:
        """Static pressure of the air around, Pa."""
        return air.pressure(self.altitude_home - self.airframe.place[2])

    # --- what it is told

    def arm(self) -> bool:
        """Arm; False and a text where it is refused."""
        if self.armed:
            return True
        fault = arming_fault(self.parameters, self.time)
        if fault:
            self._send_text(2, f"Arm: {fault}")
            return False
        self.armed, self._spool, self._since = True, 0.0, 0.0
        self.control.reset(self.estimate.euler[2])
        self._log.armed(self.time_us, armed=True)
        self._send_text(6, "Arming motors")
        return True

    def disarm(self, *, forced: bool = False) -> bool:
        """Disarm; False while it flies, or does not know that it stands."""
        if self.flying or (self._shaken and not forced):
            return False
        if self.armed:
            self.armed, self.guidance = False, Guidance.HOLD
            self.control.reset(self.estimate.euler[2])
            self._log.armed(self.time_us, armed=False)
            self._send_text(6, "Disarming motors")
        return True

    def set_mode(self, number: int) -> bool:
        """Change the mode; False: it is not one of ours."""
        if number not in set(Mode):
            return False
        fault = mission_fault(self.auto.items, flying=self.flying) if number == Mode.AUTO else ""
        if fault:
            self._send_text(2, f"Auto: {fault}")
            return False
        self.mode = Mode(number)
        self.guidance, self._since = Guidance.HOLD, 0.0
        self.control.level_off()
        self._log.mode(self.time_us, number, 2)
        return True

    def takeoff(self, height: float) -> bool:
        """Climb to `height` m above the ground; False where it cannot."""
        if not self.armed or self.mode is not Mode.GUIDED or self.flying or not height > 0.0:
            return False
        self.guidance, self._target_height = Guidance.TAKEOFF, height
        return True

    def load_mission(self, items: Sequence[Item]) -> None:
        """Take a mission for AUTO; its first item is home."""
        self.auto.load(items)
        self._log.mission(self.time_us, items)

    def start_mission(self) -> bool:
        """Fly the mission; False where it cannot."""
        if not self.armed or not self.set_mode(Mode.AUTO):
            return False
        self.auto.start()
        return True

    def follow_velocity(self, target: Vector, yaw: float | None, yaw_rate: float) -> None:
        """Follow a velocity north east down, m/s, and a heading or a yaw rate, rad and rad/s."""
        if self._follows(Guidance.VELOCITY):
            self._velocity_target = target
            self._yaw_rate = yaw_rate
            if yaw is not None:
                self.control.attitude[2] = yaw

    def follow_attitude(self, target: Vector, thrust: float) -> None:
        """Follow roll, pitch, yaw, rad, and a thrust of 0 to 1 that means a climb rate."""
        if self._follows(Guidance.ATTITUDE):
            most = 0.01 * self.parameters["WPNAV_SPEED_UP"]
            self._attitude_target = target
            self._climb_target = 2.0 * (thrust - ATTITUDE_CLIMB_MIDDLE) * most

    def _follows(self, guidance: Guidance) -> bool:
        if self.mode is not Mode.GUIDED or not self.flying:
            return False
        if self.guidance is not guidance:
            self.control.level_off()
        self.guidance, self._since = guidance, 0.0
        return True

    def store(self, name: str, value: float) -> bool:
        """Set a parameter; False: there is none of that name."""
        if not self.parameters.store(name, value):
            return False
        self._log.parameter(self.time_us, name, self.parameters[name])
        return True

    def _send_text(self, severity: int, text: str) -> None:
        self._log.text(self.time_us, text)
        self.say(severity, text)

    def close(self) -> None:
        """Close the log."""
        self._log.close()

    # --- the loop

    def loop(self) -> None:
        """One main loop, 2.5 ms."""
        if self.parameters.version != self._version:
            self._read_parameters()
        if self.loops % _WANDER_EVERY == 0:
            self.estimate.wander(DT * _WANDER_EVERY)
        self.estimate.follow(resting=not self.flying)
        self.mixer.follow(self.battery.voltage, DT)
        self._fly()
        if self.armed or self.parameters["LOG_DISARMED"]:
            self._log.loop(self)
        wind = self.wind.advance(DT)
        dt = DT / SUBSTEPS
        for _ in range(SUBSTEPS):
            self.airframe.advance(self.pulses, self.battery.voltage, wind, dt)
            for unit in self.units:
                unit.sample(self.airframe.force, self.airframe.rate)
        self.battery.draw(self.airframe.current, DT)
        self.loops += 1

    def _read_parameters(self) -> None:
        self._version = self.parameters.version
        readers = [part.read for part in (self.wind, self.mixer, self.control, self.airframe)]
        for read in (*readers, *(unit.read for unit in self.units)):
            read(self.parameters)

    def _fly(self) -> None:
        if not self.armed:
            self.pulses = self.mixer.idle(0.0)
            return
        self._since += DT
        self._spool = min(self._spool + DT / _SPOOL_S, 1.0)
        if not self.flying:
            self._on_ground()
            return
        if self.loops % NAVIGATION == 0:
            self._navigate(DT * NAVIGATION)
        self._stabilize()
        if self.airframe.on_ground:
            self.flying, self._since = False, 0.0
            self.auto.landed()

    def _on_ground(self) -> None:
        """Spin up and lift off, or idle and disarm."""
        control = self.control
        auto = self.mode is Mode.AUTO
        if (self.auto.lifting if auto else self.guidance is Guidance.TAKEOFF) and self._spool >= 1.0:
            control.throttle = min(control.throttle + _LIFT_PER_S * DT, 1.0)
            if not self.airframe.on_ground:
                self.flying = True
                control.lifted_off()
            self._stabilize()
            return
        control.throttle = 0.0
        self.pulses = self.mixer.idle(self._spool)
        self.control.outputs = (0.0, 0.0, 0.0)
        down = self.mode is Mode.LAND or (auto and self.auto.down)
        limit = _LANDED_S if down else self.parameters["DISARM_DELAY"]
        if self._since > limit:
            self.disarm()

    def _stabilize(self) -> None:
        control = self.control
        control.hold_attitude(self.estimate.euler, self.units[0].gyro, limited=self.mixer.limited, dt=DT)
        self.pulses = self.mixer.pulses(
            *control.outputs, throttle=control.throttle, density_ratio=self._density_ratio
        )  # fmt: skip

    def _navigate(self, dt: float) -> None:
        control, height = self.control, -self.estimate.place[2]
        self._density_ratio = air.density(self.altitude_home + height) / air.SEA_LEVEL_DENSITY
        north, east, climb = self._wanted(height, dt)
        if self.guidance is Guidance.ATTITUDE and self._since <= self.parameters["GUID_TIMEOUT"]:
            control.attitude[:] = self._attitude_target
        else:
            control.attitude[2] = control.attitude[2] + self._yaw_rate * dt
            control.follow_velocity(north, east, self.estimate.velocity, self.estimate.euler[2], dt)
        control.climb(climb, self.estimate.velocity[2], self.estimate.euler, dt)

    def _auto_wanted(self, dt: float) -> Vector:
        wanted = self.auto.steer(self.estimate.place, self.estimate.euler[2], dt)
        if self.auto.yaw is not None:
            self.control.attitude[2] = self.auto.yaw
        return wanted

    def _wanted(self, height: float, dt: float) -> Vector:
        """The velocity to follow: north, east and climb, m/s."""
        if self.mode is Mode.LAND:
            return 0.0, 0.0, landing_climb(height, self.parameters)
        if self.mode is Mode.AUTO:
            return self._auto_wanted(dt)
        if self.guidance is Guidance.TAKEOFF:
            if height > self._target_height - CLOSE_ENOUGH:
                self.guidance = Guidance.HOLD
            return 0.0, 0.0, takeoff_climb(height, self._target_height)
        if self._since > self.parameters["GUID_TIMEOUT"]:
            self._yaw_rate = 0.0
            return 0.0, 0.0, 0.0
        if self.guidance is Guidance.VELOCITY:
            north, east, down = self._velocity_target
            up, least = 0.01 * self.parameters["WPNAV_SPEED_UP"], -0.01 * self.parameters["WPNAV_SPEED_DN"]
            return north, east, min(max(-down, least), up)
        return 0.0, 0.0, self._climb_target if self.guidance is Guidance.ATTITUDE else 0.0


def arming_fault(parameters: FlightParameters, time: float) -> str:
    """Reason not to arm `time` seconds after boot, in the firmware's words; empty: it arms."""
    if parameters["ARMING_CHECK"] == 0:
        return ""
    if not parameters["SIM_GPS1_ENABLE"]:
        return "GPS 1: Bad fix"
    return "Need Position Estimate" if time < READY_S else ""


def mission_fault(items: Sequence[Item], *, flying: bool) -> str:
    """Reason for which AUTO does not fly these items, the first of which is home; empty: it does."""
    if len(items) < 2:
        return "No mission"
    moving = [item.command for item in items[1:] if item.command not in AT_ONCE]
    return "" if flying or moving[:1] == [Command.TAKEOFF] else "Missing Takeoff Cmd"
