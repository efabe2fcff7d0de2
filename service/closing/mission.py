"""What the simulator flies: the standard mission, or that of the real flight's log.

The standard mission has legs of velocity or attitude, in seconds of the vehicle's clock. Velocities are along the
heading at take-off (ahead, right, down), so that out and back lie along the body's axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from mavcal.calib.errors import CalibError
from mavcal.calib.logs.missions.course import durations, with_take_off
from mavcal.calib.logs.missions.items import LoggedMission
from mavcal.calib.logs.missions.reading import read_mission
from mavcal.service.closing.errors import NoMission

_UP = 1.5
"""Mean climb of a take-off, m/s. Source: ArduPilot's simulator."""
_LANDING_S = 10.0
LOW = 2.0
"""Height at which the landing begins, m. From here at 0.45 m/s the last seconds are within a rotor's radius of the
ground."""
SPEED = 5.0
"""Speed assumed for the duration of a log's mission, m/s; ArduPilot's WPNAV_SPEED is 5 to 10."""


class MissionKind(StrEnum):
    """Which mission the simulator flies."""

    STANDARD = "standard"  # the manoeuvres that show every effect
    LOG = "log"  # that of the real flight's log


@dataclass(frozen=True)
class Leg:
    """One target for `seconds`: a velocity in m/s, or a lean away from the trim in deg.

    `turn` is the heading from that at take-off, deg. A leg with `until_height` ends there, m, or after `seconds`.
    """

    name: str
    seconds: float
    ahead: float = 0.0
    right: float = 0.0
    down: float = 0.0
    turn: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    leans: bool = False
    until_height: float | None = None


@dataclass(frozen=True)
class Mission:
    """Rest, take-off, legs, landing, rest. Times in s, heights in m."""

    legs: tuple[Leg, ...]
    rest_s: float = 10.0
    height: float = 8.0
    rest_after_s: float = 7.0
    kind: MissionKind = MissionKind.STANDARD

    @property
    def seconds(self) -> float:
        """About how long it takes, take-off and landing included."""
        up_and_down = self.height / _UP + _LANDING_S
        return self.rest_s + up_and_down + sum(leg.seconds for leg in self.legs) + self.rest_after_s


def standard_mission() -> Mission:
    """The manoeuvres of AIRFRAME 5.10: every effect of the airframe shows in one of them."""
    climbs = [leg for speed in (2.0, 3.0, 4.0) for leg in _out_and_back("climb", down=-speed, seconds=3.0)]
    ahead = [leg for speed in (8.0, 4.0) for leg in _out_and_back("ahead", ahead=speed, seconds=4.0)]
    aside = [leg for speed in (8.0, 4.0) for leg in _out_and_back("aside", right=speed, seconds=4.0)]
    turns = [Leg("turn", 2.5, turn=90.0 * k) for k in (1, 2, 3, 4)]
    doublets = [leg for axis in ("roll", "pitch") for _ in range(3) for leg in _doublet(axis)]
    legs = (
        Leg("hover", 10.0),
        *climbs,
        Leg("hover", 1.5),
        *ahead,
        Leg("hover", 1.5),
        *aside,
        Leg("hover", 2.0),
        *turns,
        Leg("hover", 1.5),
        *doublets,
        Leg("hover", 6.0),
        Leg("descent", 10.0, down=2.0, until_height=LOW),
        Leg("hover", 1.5),
    )
    return Mission(legs)


def _out_and_back(name: str, *, seconds: float, ahead: float = 0.0, right: float = 0.0, down: float = 0.0) -> list[Leg]:
    out = Leg(f"{name} out", seconds, ahead, right, down)
    return [out, Leg(f"{name} back", seconds + 0.5 * (down == 0.0), -ahead, -right, -down)]


def _doublet(axis: str) -> list[Leg]:
    """A doublet: 20 degrees one way, 20 the other, level."""
    leans = [(20.0, 0.35), (-20.0, 0.35), (0.0, 0.4)]
    return [
        Leg(f"{axis} doublet", s, roll=angle * (axis == "roll"), pitch=angle * (axis == "pitch"), leans=True)
        for angle, s in leans
    ]


@dataclass(frozen=True)
class LogMission:
    """Rest, the items of `flown` from take-off to landing, rest. Times in s."""

    flown: LoggedMission
    rest_s: float = 10.0
    rest_after_s: float = 7.0
    kind: MissionKind = MissionKind.LOG

    @property
    def seconds(self) -> float:
        """About how long it takes."""
        return self.rest_s + sum(durations(self.flown, SPEED)) + self.rest_after_s


def log_mission(file: Path) -> LogMission:
    """The mission that `file` holds.

    Raises
    ------
    NoMission
        If it holds none, or none that a simulated multicopter can fly.
    """
    try:
        return LogMission(with_take_off(read_mission(file)))
    except CalibError as error:
        raise NoMission(f"--mission log: {error}") from error
