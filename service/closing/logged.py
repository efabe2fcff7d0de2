"""The mission of the real flight's log, as a simulator is to fly it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mavcal.calib.errors import CalibError
from mavcal.calib.logs.missions.course import durations, with_take_off
from mavcal.calib.logs.missions.items import LoggedMission
from mavcal.calib.logs.missions.reading import read_mission
from mavcal.service.closing.errors import NoMission
from mavcal.service.closing.mission import MissionKind

SPEED = 5.0
"""m/s for which the length of a mission is told; ArduPilot's own WPNAV_SPEED is 5 to 10."""


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
