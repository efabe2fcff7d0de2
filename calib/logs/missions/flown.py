"""The mission in a log of PX4: the items that it flew, as its navigator named them.

``navigator_mission_item`` has each item with a place when it begins (``mission_base.cpp``). Its place is a float32, and
a double in ``position_setpoint_triplet``. An item without a place is a ``vehicle_command`` of the vehicle to itself
(``MissionBlock::issue_command``). The upload is not logged: what was not begun is unknown.

PX4 adds items of its own: a climb before the first place, a move above the place of a landing, and a wait or rest
behind the last one. The former were flown, and stay; the latter is none of the mission.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import UnreadableError
from mavcal.calib.logs.missions.items import (
    INSTEAD,
    REGARDED,
    Frame,
    LoggedMission,
    MissionItem,
    NavCommand,
    OtherCommand,
)
from mavcal.calib.logs.ulog import parse_ulog

ITEMS, COMMANDS, PLACES, HOME, STATUS = (
    "navigator_mission_item", "vehicle_command", "position_setpoint_triplet", "home_position", "vehicle_status",
)  # fmt: skip
_FIELDS: Final[Mapping[str, tuple[str, ...]]] = {
    ITEMS: (
        "sequence_current", "nav_cmd", "latitude", "longitude", "altitude", "altitude_is_relative", "time_inside",
        "acceptance_radius", "yaw",
    ),
    HOME: ("lat", "lon", "alt"),
    STATUS: ("nav_state",),
}  # fmt: skip
"""Required fields of each topic."""
_AUTO_MISSION: Final = 3
"""nav_state (VehicleStatus.msg)."""
_IDLE, _LOITER_UNLIMITED, _LOITER_TO_ALTITUDE = 0, 17, 31
"""Commands that PX4 adds: idle after landing, loiter after the last item, climb before the first (``mission.cpp``,
``mission_base.cpp``)."""
_WITHOUT_PLACE: Final = frozenset({*OtherCommand, NavCommand.RETURN_TO_LAUNCH, NavCommand.DELAY})
_SECOND: Final = 1_000_000
_WAITS: Final = (NavCommand.WAYPOINT, NavCommand.LOITER_TIME)
Topic = Mapping[str, NDArray[Any]]
_Timed = tuple[int, int, MissionItem]
"""Stamp, order at one stamp, item."""


def read_flown(file: Path) -> LoggedMission:
    """The mission that a log of PX4 holds.

    Raises
    ------
    UnreadableError
        If it cannot be read, or holds none.
    InvalidInputError
        If an item cannot be flown by a simulated multicopter.
    """
    topics = parse_ulog(file, (*_FIELDS, COMMANDS, PLACES))
    status = topics.get(STATUS, {})
    if "nav_state" in status and not (status["nav_state"] == _AUTO_MISSION).any():
        raise UnreadableError(f"{file.name} holds no mission: PX4 was never in AUTO.MISSION in it. {INSTEAD}")
    missing = [name for name in _FIELDS if name not in topics]
    missing += [f"{n}.{f}" for n, fields in _FIELDS.items() for f in fields if n in topics and f not in topics[n]]
    if missing:
        raise UnreadableError(
            f"{file.name} does not say which mission it flew (no {', '.join(missing)}). Log it with PX4 1.11 or later "
            f"and bit 0 of SDLOG_PROFILE. {INSTEAD}"
        )
    timed = _placed(topics[ITEMS], _rows_in_mission(topics[ITEMS], status), topics.get(PLACES, {}))
    if not timed:
        raise UnreadableError(f"{file.name} holds no mission: no item of a place was begun. {INSTEAD}")
    if COMMANDS in topics:
        timed += _commands(topics[COMMANDS], status, timed[0][0])
    timed.sort(key=lambda one: one[:2])
    items = tuple(dataclasses.replace(item, number=number) for number, (_, _, item) in enumerate(timed))
    return LoggedMission(_home(topics[HOME], timed[0][0], timed[-1][0]), items, "px4")


def _rows_in_mission(topic: Topic, status: Topic) -> list[int]:
    """Rows while it flew a mission."""
    at = np.searchsorted(status["timestamp"], topic["timestamp"], side="right") - 1
    flying = (at >= 0) & (status["nav_state"][np.maximum(at, 0)] == _AUTO_MISSION)
    return [int(row) for row in np.flatnonzero(flying)]


def _placed(topic: Topic, rows: list[int], places: Topic) -> list[_Timed]:
    """Items with a place, each once."""
    found: list[_Timed] = []
    for row, following in zip(rows, [*rows[1:], None], strict=True):
        if _added(topic, row, following, found):
            continue
        stamp = int(topic["timestamp"][row])
        until = stamp + _SECOND if following is None else int(topic["timestamp"][following])
        item = _item(topic, row, _exact(topic, row, places, stamp, until))
        if not found or not _repeats(found[-1][2], item):
            found.append((stamp, 1, item))
    return found


def _added(topic: Topic, row: int, following: int | None, found: list[_Timed]) -> bool:
    """Whether it has no place, or is PX4's own and leads nowhere else."""
    command, numbers = int(topic["nav_cmd"][row]), topic["sequence_current"]
    if command == _LOITER_TO_ALTITUDE:
        return following is not None and bool(numbers[following] == numbers[row])
    if command == _LOITER_UNLIMITED and found:
        at = found[-1][2]
        there = _rounds_to(at.latitude, topic["latitude"][row]) and _rounds_to(at.longitude, topic["longitude"][row])
        return bool(there)
    return command == _IDLE or command in _WITHOUT_PLACE


def _item(topic: Topic, row: int, place: tuple[float, float]) -> MissionItem:
    command = int(topic["nav_cmd"][row])
    relative = bool(topic["altitude_is_relative"][row])
    waits = float(topic["time_inside"][row]) if command in _WAITS else 0.0
    radius = float(topic["acceptance_radius"][row]) if command == NavCommand.WAYPOINT else 0.0
    heading = math.degrees(float(topic["yaw"][row]))
    return MissionItem(
        0,
        command,
        Frame.RELATIVE if relative else Frame.GLOBAL,
        (waits, radius, 0.0, heading),
        *place,
        float(topic["altitude"][row]),
    )


def _exact(topic: Topic, row: int, places: Topic, stamp: int, until: int) -> tuple[float, float]:
    """Its place as a double, if that was logged while it was flown."""
    latitude, longitude = topic["latitude"][row], topic["longitude"][row]
    if "current.lat" in places and "current.lon" in places:
        when = (places["timestamp"] >= stamp) & (places["timestamp"] < until)
        same = _rounds_to(places["current.lat"], latitude) & _rounds_to(places["current.lon"], longitude)
        rows = np.flatnonzero(when & same)
        if len(rows):
            return float(places["current.lat"][rows[0]]), float(places["current.lon"][rows[0]])
    return float(latitude), float(longitude)


def _rounds_to(exact: Any, rounded: Any) -> Any:
    """Whether `rounded`, a float32, may be what is left of `exact`."""
    return np.abs(exact - float(rounded)) <= np.spacing(np.abs(np.float32(rounded)))


def _repeats(before: MissionItem, item: MissionItem) -> bool:
    """Whether PX4 logged the same item twice: for a new heading, or when a pause ended."""
    same = dataclasses.replace(item, parameters=(*item.parameters[:3], before.parameters[3]))
    return repr(same) == repr(before)  # NaN is like itself


def _commands(topic: Topic, status: Topic, begun: int) -> list[_Timed]:
    """Items without a place, which come before one of the same instant."""
    own = ("from_external", "command", *(f"param{k}" for k in range(1, 8)))
    if any(name not in topic for name in own):
        return []
    found: list[_Timed] = []
    for row in _rows_in_mission(topic, status):
        command, stamp = int(topic["command"][row]), int(topic["timestamp"][row])
        if command in _WITHOUT_PLACE and not topic["from_external"][row] and stamp >= begun:
            first, second, third, fourth, latitude, longitude, altitude = (
                float(topic[f"param{k}"][row]) for k in range(1, 8)
            )
            given = (first, second, third, fourth)
            where = (latitude, longitude, altitude) if command in REGARDED else (0.0, 0.0, 0.0)
            frame = Frame.GLOBAL if command in REGARDED else Frame.MISSION
            found.append((stamp, 0, MissionItem(0, command, frame, given, *where)))
    return found


def _home(topic: Topic, begin: int, end: int) -> MissionItem:
    """Home while it flew: its altitude follows the receiver by a metre."""
    when = (topic["timestamp"] >= begin) & (topic["timestamp"] <= end)
    rows = np.flatnonzero(when)
    if not len(rows):
        rows = np.array([max(int(np.searchsorted(topic["timestamp"], begin)) - 1, 0)])
    latitude, longitude, altitude = (float(np.median(topic[name][rows])) for name in ("lat", "lon", "alt"))
    return MissionItem(-1, NavCommand.WAYPOINT, Frame.GLOBAL, (0.0,) * 4, latitude, longitude, altitude)
