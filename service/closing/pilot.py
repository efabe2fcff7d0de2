"""Flies a mission over MAVLink by the vehicle's own clock: a simulator may run faster than real time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from mavcal.calib.wire.codec import Message
from mavcal.service.closing import autopilot as ways
from mavcal.service.closing.conversation import HINT, TRY_S, Conversation
from mavcal.service.closing.errors import MissionLeft, SimulatorUnarmed
from mavcal.service.closing.mission import Leg, Mission

VELOCITY_EVERY_S, LEAN_EVERY_S = 0.1, 0.02
"""Period of a repeated target, s of the vehicle's clock: no timeouts, and sharp edges of a doublet."""
ARM_S = 150.0
"""Vehicle seconds for arming: estimators of simulators need some 40."""
_OBEY_S = 0.4
_TAKEOFF_S, _LAND_S = 30.0, 60.0
_NEARLY = 0.5
_STANDS_S = 6.0
"""Vehicle seconds below `_NEARLY` that count as landed. Chosen, not measured: ArduCopter descends at 0.5 m/s."""
_TAKE_OFFS = 3


class Pilot:
    """Flies `mission` with the vehicle of a conversation."""

    def __init__(self, vehicle: Conversation, mission: Mission) -> None:
        self._vehicle, self._mission = vehicle, mission
        self._heading = 0.0
        self._trim = (0.0, 0.0)

    def fly(self, settings: Mapping[str, float] | None = None) -> None:
        """The whole mission; `settings` are parameters that are set first, over MAVLink.

        Raises
        ------
        SimulatorSilent
            If the vehicle falls silent.
        SimulatorUnarmed
            If it refuses to arm, or a parameter.
        MissionLeft
            If it does something else, or takes too long.
        """
        vehicle = self._vehicle
        begin(vehicle, settings)
        way = vehicle.way
        if way.thrust_parameter:
            way.hover_thrust = vehicle.parameter(way.thrust_parameter, way.hover_thrust)
        vehicle.doing = "resting"
        vehicle.run(self._mission.rest_s)
        self._arm()
        self._take_off()
        for leg in self._mission.legs:
            self._fly_leg(leg)
        land(vehicle)
        vehicle.doing = "resting"
        vehicle.run(self._mission.rest_after_s)

    def _arm(self) -> None:
        """Change to the mode that obeys, then arm, repeatedly."""
        vehicle, way = self._vehicle, self._vehicle.way
        still = None if way.climbs_by_itself else lambda: self._velocity(0.0, 0.0, 0.0)  # else it obeys nobody
        arm(vehicle, way.guide(vehicle.to), still)
        self._heading = vehicle.state.euler[2]

    def _take_off(self) -> None:
        vehicle, way, height = self._vehicle, self._vehicle.way, self._mission.height
        vehicle.doing = "taking off"

        def high() -> bool:
            return vehicle.state.height > height - _NEARLY

        if way.climbs_by_itself:
            there = self._climbs(high)
        else:
            there = vehicle.run(_TAKEOFF_S, lambda: self._velocity(0.0, 0.0, -ways.CLIMB), VELOCITY_EVERY_S, high)
        if not there:
            raise MissionLeft(
                f"the vehicle is at {vehicle.state.height:.1f} m after {_TAKEOFF_S:g} s of take-off to {height:g} m."
                f"{vehicle.said()} Can it carry its weight with these settings?"
            )
        vehicle.flying = True

    def _climbs(self, high: Callable[[], bool]) -> bool:
        """Command a climb; arm again if it disarmed itself before (DISARM_DELAY)."""
        vehicle, way = self._vehicle, self._vehicle.way
        for _ in range(_TAKE_OFFS):
            vehicle.run(TRY_S)
            vehicle.send(way.take_off(vehicle.to, self._mission.height))
            vehicle.run(_TAKEOFF_S, until=lambda: high() or not vehicle.state.armed)
            if high() or vehicle.state.armed:
                return high()
            self._arm()
            vehicle.doing = "taking off"
        return False

    def _fly_leg(self, leg: Leg) -> None:
        vehicle, low = self._vehicle, leg.until_height
        vehicle.doing = leg.name
        yaw = self._heading + math.radians(leg.turn)
        if leg.leans:
            euler = (self._trim[0] + math.radians(leg.roll), self._trim[1] + math.radians(leg.pitch), yaw)
            vehicle.run(leg.seconds, lambda: self._attitude(euler), LEAN_EVERY_S)
            return
        c, s = math.cos(self._heading), math.sin(self._heading)
        north, east = c * leg.ahead - s * leg.right, s * leg.ahead + c * leg.right

        def reached() -> bool:
            return low is not None and vehicle.state.height < low

        vehicle.run(leg.seconds, lambda: self._velocity(north, east, leg.down, yaw), VELOCITY_EVERY_S, reached)
        self._trim = vehicle.state.trim  # of a hover before doublets: wind leans it

    def _velocity(self, north: float, east: float, down: float, yaw: float | None = None) -> Message:
        heading = self._heading if yaw is None else yaw
        return ways.velocity_target(self._ms, self._vehicle.to, north, east, down, yaw=heading)

    def _attitude(self, euler: tuple[float, float, float]) -> Message:
        return ways.attitude_target(self._ms, self._vehicle.to, euler, self._vehicle.way.hover_thrust)

    @property
    def _ms(self) -> int:
        return round(1e3 * self._vehicle.state.t)


def begin(vehicle: Conversation, settings: Mapping[str, float] | None) -> None:
    """Hear the vehicle, then set parameters over MAVLink. Raises SimulatorSilent, SimulatorUnarmed."""
    vehicle.begin()
    for name, value in (settings or {}).items():
        vehicle.set_parameter(name, value)


def arm(vehicle: Conversation, ready: Message, still: Callable[[], Message] | None = None) -> None:
    """Change its mode by `ready`, then arm, again and again; `still` is a target that it needs before it obeys.

    Raises
    ------
    SimulatorUnarmed
        If it does not arm within `ARM_S` of its clock.
    """
    way, began = vehicle.way, vehicle.state.t
    vehicle.doing = "arming"
    while not vehicle.state.armed:
        if vehicle.state.t - began > ARM_S:
            raise SimulatorUnarmed(
                f"the vehicle did not arm within {ARM_S:g} s of its clock.{vehicle.said()} Set what it misses by "
                "--params, or in the simulator's own defaults"
            )
        vehicle.run(0.0 if still is None else TRY_S, still, VELOCITY_EVERY_S)
        vehicle.send(ready)
        vehicle.run(_OBEY_S, still, VELOCITY_EVERY_S)
        vehicle.send(way.arm(vehicle.to))
        vehicle.run(TRY_S, still, VELOCITY_EVERY_S, lambda: vehicle.state.armed)


def land(vehicle: Conversation) -> None:
    """Land where it is, and disarm what stands on the ground without noticing it, as ArduCopter does in a gale.

    Raises
    ------
    MissionLeft
        If it is still armed after `_LAND_S`.
    """
    vehicle.doing, vehicle.flying = "landing", False
    state, landing, disarm = vehicle.state, vehicle.way.land(vehicle.to), vehicle.way.disarm(vehicle.to)
    ended, standing_since = state.t + _LAND_S, math.inf
    while state.armed and state.t < ended:
        standing_since = min(standing_since, state.t) if state.height < _NEARLY else math.inf
        vehicle.send(disarm if state.t - standing_since > _STANDS_S else landing)
        vehicle.run(TRY_S, until=lambda: not state.armed)
    if state.armed:
        raise MissionLeft(
            f"the vehicle is still armed {_LAND_S:g} s after the landing began, at {vehicle.state.height:.1f} m."
            f"{vehicle.said()} {HINT}"
        )
