"""The log that a simulator left in the folder of its round."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mavcal.calib import logs
from mavcal.calib.errors import CalibError
from mavcal.calib.recording import Recording
from mavcal.service.closing.errors import LogUnusable
from mavcal.service.closing.simulator import LOG

_BEGINNINGS = (b"\xa3\x95", b"ULog")
"""First bytes of a DataFlash log and of a ULog; ArduPilot's `eeprom.bin` begins with neither."""
_ENDINGS = (".bin", ".ulg")


@dataclass(frozen=True)
class Flown:
    """The log of a complete flight, with notes on it."""

    log: Path
    notes: tuple[str, ...] = ()


def find_log(folder: Path) -> Path:
    """The log of the fixed name, or the newest valid .bin or .ulg below `folder`.

    Raises
    ------
    LogUnusable
        If there is none.
    """
    below = [file for file in folder.rglob("*") if file.suffix.lower() in _ENDINGS]
    found = _logs(folder, below)
    if not found:
        seen = ", ".join(file.name for file in below) or "no .bin or .ulg file"
        raise LogUnusable(
            f"the simulator left no flight log in {folder} (there is {seen}). Give it {{log}}, or have it log below "
            "its working folder; ArduPilot's logs lie in logs/, PX4's in log/"
        )
    return max(found, key=lambda file: file.stat().st_mtime)


def _logs(folder: Path, below: list[Path]) -> list[Path]:
    named = folder / LOG
    return [file for file in ([named] if named.is_file() else below) if _is_log(file)]


def logged_bytes(folder: Path) -> int:
    """Bytes that the simulator has logged so far; 0 where there is no log yet."""
    found = _logs(folder, [file for file in folder.rglob("*") if file.suffix.lower() in _ENDINGS])
    return max((file.stat().st_size for file in found), default=0)


def _is_log(file: Path) -> bool:
    if not file.is_file():
        return False
    with file.open("rb") as opened:
        return opened.read(4).startswith(_BEGINNINGS)


def read_log(file: Path) -> Recording:
    """The log as a recording.

    Raises
    ------
    LogUnusable
        If it cannot be read.
    """
    try:
        return logs.read(file)
    except CalibError as error:
        raise LogUnusable(f"the simulator's log cannot be read: {error}") from error
