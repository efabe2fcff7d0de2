"""Reads the mission that was flown from a log.

ArduPilot logs CMD messages at the start and after each upload. Old firmwares also log CMD at the start of each item;
such a single message is not an upload.

PX4 logs no upload, so items that were never begun are unknown. ``navigator_mission_item`` has each item with a place
when it begins (``mission_base.cpp``). Its coordinates are float32, those in ``position_setpoint_triplet`` are double.
An item without a place is a ``vehicle_command`` of the vehicle to itself (``MissionBlock::issue_command``).

PX4 adds items of its own. They are a climb before the first place, a move above the place of a landing, and a wait
after the last item. The climb and the move were flown, and stay; the wait is left out.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError, UnreadableError
from mavcal.calib.firmware.ardupilot.log_fields import ARMED_EVENT
from mavcal.calib.logs.dataflash import DataFlash, Log, Table, TextLog
from mavcal.calib.logs.missions.items import (
    INSTEAD,
    REGARDED,
    Frame,
    LoggedMission,
    MissionItem,
    NavCommand,
    OtherCommand,
)
from mavcal.calib.logs.ulog import MAGIC, parse_ulog

_NAMES: Final = ("CMD", "MODE", "EV", "ARM")
_NUMBERS: Final = ("CTot", "CNum", "CId")
_VALUES: Final = ("Prm1", "Prm2", "Prm3", "Prm4", "Lat", "Lng", "Alt")
_AUTO: Final = 3
"""ArduCopter's mode number of AUTO."""
_HEAD: Final = 1 << 14
_Upload = tuple[int, tuple[MissionItem, ...]]
"""An upload: where in the file it ends, and its items."""


def read_mission(path: Path | str) -> LoggedMission:
    """The mission that was flown: the last complete upload before the flight, else the first one of the log.

    The flight begins when the vehicle is first both armed and in AUTO, or, without AUTO, when it is armed. For PX4, the
    mission consists of the items that were begun.

    Parameters
    ----------
    path
        A DataFlash log, binary or text, or a ULog.

    Raises
    ------
    UnreadableError
        If it cannot be opened, or is a log that holds no mission.
    InvalidInputError
        If the mission is not complete, or has items that a simulated multicopter cannot fly.
    """
    file = Path(path)
    with _readable(file), file.open("rb") as opened:
        head = opened.read(_HEAD)
    if head.startswith(MAGIC[:4]):
        return _read_px4(file)
    with _readable(file):
        log = _opened(file, head)
    table = log.get("CMD")
    if table is None or not len(table):
        raise UnreadableError(f"{file.name} holds no mission (no CMD message). {INSTEAD}")
    missing = [name for name in (*_NUMBERS, *_VALUES) if name not in table]
    if missing:
        raise UnreadableError(f"the mission in {file.name} has no {', '.join(missing)}. {INSTEAD}")
    uploads = list(_uploads(table))
    if not uploads:
        total = int(np.max(table["CTot"]))
        raise InvalidInputError(
            f"{file.name} holds no complete mission with an item behind home (messages: {len(table)}, items: {total}). "
            f"{INSTEAD}"
        )
    start = _flight_start(log)
    before = [upload for upload in uploads if start is not None and upload[0] < start]
    home, *items = (before[-1] if before else uploads[0])[1]
    return LoggedMission(home, tuple(items))


@contextmanager
def _readable(file: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UnreadableError(f"{file.name} cannot be opened: {error.strerror or error}") from error


def _opened(file: Path, head: bytes) -> Log:
    """The log as tables, if it is from ArduPilot."""
    if head.startswith(b"\xa3\x95"):
        return DataFlash(file, _NAMES)
    if b"FMT," in head:
        return TextLog(file.read_bytes(), file.name, _NAMES)
    raise UnreadableError(f"{file.name} is no log of ArduPilot or PX4, and holds no mission. {INSTEAD}")


def _uploads(table: Table) -> Iterator[_Upload]:
    """Runs of item numbers 0, 1, ... that make up a whole mission, with at least one item after home."""
    run: list[MissionItem] = []
    of = 0
    for total, item, place in _rows(table):
        if item.number == 0:
            run, of = [], total
        if item.number != len(run) or total != of:
            run, of = [], 0
            continue
        run.append(item)
        if len(run) == of > 1:
            yield place, tuple(run)
            run, of = [], 0


def _rows(table: Table) -> Iterator[tuple[int, MissionItem, int]]:
    """Total, item and file offset of each row; logs without a frame give heights above home."""
    numbers = zip(*(column.tolist() for column in table.columns(*_NUMBERS)), strict=True)
    values = table.arrays(_VALUES)[0].tolist()
    frames = table["Frame"].tolist() if "Frame" in table else [None] * len(values)
    for (total, number, command), row, frame, place in zip(
        numbers, values, frames, table.offsets.tolist(), strict=True
    ):
        stated = (Frame.RELATIVE if number else Frame.GLOBAL) if frame is None else int(frame)
        *given, latitude, longitude, altitude = row
        first, second, third, fourth = given
        item = MissionItem(
            int(number), int(command), stated, (first, second, third, fourth), latitude, longitude, altitude
        )
        yield int(total), item, place


def _flight_start(log: Log) -> int | None:
    """Byte offset in the file where the mission's flight begins; None: the log does not say."""
    armed = _first(log, "ARM", "ArmState", 1)
    if armed is None:
        armed = _first(log, "EV", "Id", ARMED_EVENT)
    number = "ModeNum" if "ModeNum" in log.get("MODE", ()) else "Mode"
    auto = _first(log, "MODE", number, _AUTO)
    known = [place for place in (armed, auto) if place is not None]
    return max(known) if known else None


def _first(log: Log, name: str, column: str, value: int) -> int | None:
    table = log.get(name)
    if table is None or column not in table:
        return None
    rows = np.flatnonzero(table[column] == value)
    return int(table.offsets[rows[0]]) if len(rows) else None


# --- PX4

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
"""Time stamp, order within one stamp, item."""


def _read_px4(file: Path) -> LoggedMission:
    """The mission that a log of PX4 holds."""
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
    """Rows during a mission."""
    at = np.searchsorted(status["timestamp"], topic["timestamp"], side="right") - 1
    flying = (at >= 0) & (status["nav_state"][np.maximum(at, 0)] == _AUTO_MISSION)
    return [int(row) for row in np.flatnonzero(flying)]


def _placed(topic: Topic, rows: list[int], places: Topic) -> list[_Timed]:
    """Items with a place, without repetitions."""
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
    """Whether a row has no place, or is PX4's own item at a place already reached."""
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
    """Latitude and longitude of an item: the doubles if logged while it was active, else its own float32 values."""
    latitude, longitude = topic["latitude"][row], topic["longitude"][row]
    if "current.lat" in places and "current.lon" in places:
        when = (places["timestamp"] >= stamp) & (places["timestamp"] < until)
        same = _rounds_to(places["current.lat"], latitude) & _rounds_to(places["current.lon"], longitude)
        rows = np.flatnonzero(when & same)
        if len(rows):
            return float(places["current.lat"][rows[0]]), float(places["current.lon"][rows[0]])
    return float(latitude), float(longitude)


def _rounds_to(exact: Any, rounded: Any) -> Any:
    """Whether `exact` rounds to `rounded`, a float32."""
    return np.abs(exact - float(rounded)) <= np.spacing(np.abs(np.float32(rounded)))


def _repeats(before: MissionItem, item: MissionItem) -> bool:
    """Whether PX4 logged the same item twice: for a new heading, or when a pause ended."""
    same = dataclasses.replace(item, parameters=(*item.parameters[:3], before.parameters[3]))
    return repr(same) == repr(before)  # NaN is like itself


def _commands(topic: Topic, status: Topic, begun: int) -> list[_Timed]:
    """Items without a place; they precede an item of the same time stamp."""
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
    """Home during the flight: the median, since its altitude follows the receiver within a metre."""
    when = (topic["timestamp"] >= begin) & (topic["timestamp"] <= end)
    rows = np.flatnonzero(when)
    if not len(rows):
        rows = np.array([max(int(np.searchsorted(topic["timestamp"], begin)) - 1, 0)])
    latitude, longitude, altitude = (float(np.median(topic[name][rows])) for name in ("lat", "lon", "alt"))
    return MissionItem(-1, NavCommand.WAYPOINT, Frame.GLOBAL, (0.0,) * 4, latitude, longitude, altitude)
