"""The mission in a log: CMD messages in ArduPilot's, written at the start and after each upload; PX4's are `flown`.

Old firmwares also wrote CMD for each item that they began; such a message alone is no upload.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np

from mavcal.calib.errors import InvalidInputError, UnreadableError
from mavcal.calib.firmware.ardupilot.log_fields import ARMED_EVENT
from mavcal.calib.logs.dataflash import DataFlash, Log, Table, TextLog
from mavcal.calib.logs.missions.flown import read_flown
from mavcal.calib.logs.missions.items import INSTEAD, Frame, LoggedMission, MissionItem
from mavcal.calib.logs.ulog import MAGIC

_NAMES: Final = ("CMD", "MODE", "EV", "ARM")
_NUMBERS: Final = ("CTot", "CNum", "CId")
_VALUES: Final = ("Prm1", "Prm2", "Prm3", "Prm4", "Lat", "Lng", "Alt")
_AUTO: Final = 3
"""ArduCopter's number of the mode that flies a mission."""
_HEAD: Final = 1 << 14
_Upload = tuple[int, tuple[MissionItem, ...]]
"""Where in the file it ends, and its items."""


def read_mission(path: Path | str) -> LoggedMission:
    """The mission that was flown: the last complete upload before the flight, else the first one of the log.

    The flight begins where the motors were armed and the vehicle was in AUTO for the first time; without AUTO where
    they were armed. PX4 logs no upload: there it is what was begun (`flown`).

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
        return read_flown(file)
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
    """The log as tables, if it is one of ArduPilot's."""
    if head.startswith(b"\xa3\x95"):
        return DataFlash(file, _NAMES)
    if b"FMT," in head:
        return TextLog(file.read_bytes(), file.name, _NAMES)
    raise UnreadableError(f"{file.name} is no log of ArduPilot or PX4, and holds no mission. {INSTEAD}")


def _uploads(table: Table) -> Iterator[_Upload]:
    """Runs of the numbers 0, 1, ... up to the whole mission of at least one item behind home."""
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
    """Total, item, and where in the file it stands; logs without a frame count heights from home."""
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
    """Where in the file the mission's flight begins; None: not said."""
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
