"""The mission that a log holds: `items` -> `course` (where it flies, how long) -> `flown` (of PX4) -> `reading`."""

from __future__ import annotations

from mavcal.calib.logs.missions.course import Place, durations, moved, with_take_off
from mavcal.calib.logs.missions.items import LANDINGS, Frame, LoggedMission, MissionItem, NavCommand
from mavcal.calib.logs.missions.reading import read_mission

__all__ = [
    "LANDINGS",
    "Frame",
    "LoggedMission",
    "MissionItem",
    "NavCommand",
    "Place",
    "durations",
    "moved",
    "read_mission",
    "with_take_off",
]
