"""Recordings from files; the content decides which reader is used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mavcal.calib.errors import InvalidInputError, UnreadableError
from mavcal.calib.logs.dataflash import DataFlash, read_dataflash, read_dataflash_text
from mavcal.calib.logs.tables import read_table
from mavcal.calib.logs.tlog import read_tlog
from mavcal.calib.logs.ulog import read_ulog
from mavcal.calib.recording import Recording

_HEAD = 1 << 14
"""Bytes that tell what a file is; a text log may begin with a greeting."""
_DATAFLASH_START = b"\xa3\x95"
_ULOG_START = b"ULog"
_TABLE_STARTS = (b"PK\x03\x04", b"MATLAB", b"\x89HDF")
_MAVLINK_STARTS = (0xFD, 0xFE)
_TLOG_OPTIONS = ("start", "end", "system")
_LOGS = {".ulg": read_ulog, ".bin": read_dataflash, ".log": read_dataflash_text}
"""Readers of logs that need no options."""


def read(path: Path | str, **options: Any) -> Recording:
    """Read a log (.tlog, DataFlash .bin and text, ULog) or a table (.csv and the like, .npz, .mat).

    Parameters
    ----------
    path
        The file.
    **options
        Those of :func:`calib.logs.tables.read_table`, and for a .tlog those of
        :func:`calib.logs.tlog.read_tlog`; a .tlog states its own frames and units.

    Raises
    ------
    UnreadableError
        If the file cannot be opened, is neither a log nor a table, is damaged, or is not a regular file.
    InvalidInputError
        If an option does not apply.
    """
    file = Path(path)
    try:
        if file.exists() and not file.is_file():
            raise UnreadableError(f"{file.name or file} is a folder, a pipe or a device: give a file")
        with file.open("rb") as opened:
            head = opened.read(_HEAD)
    except OSError as error:
        raise UnreadableError(f"{file.name} cannot be opened: {error.strerror or error}") from error
    kind = _kind(head, file.suffix.lower())
    if kind in _LOGS:
        return _LOGS[kind](_plain(file, options))
    if kind == ".tlog":
        if options.get("mapping"):
            raise InvalidInputError(f"{file.name} is a telemetry log, its fields are known: leave the mapping out")
        return read_tlog(file, **{key: options[key] for key in _TLOG_OPTIONS if key in options})
    unknown = [key for key in _TLOG_OPTIONS if options.get(key)]
    if unknown:
        raise InvalidInputError(f"{', '.join(unknown)} belongs to telemetry logs; {file.name} is a table")
    return read_table(file, **{key: value for key, value in options.items() if key not in _TLOG_OPTIONS})


def is_table(path: str | Path) -> bool:
    """Whether the file at `path` is read as a table, to which mappings and units apply; False if it does not exist."""
    file = Path(path)
    try:
        if not file.is_file():
            return False
        with file.open("rb") as opened:
            return not _kind(opened.read(_HEAD), file.suffix.lower())
    except OSError:
        return False


def _kind(head: bytes, suffix: str) -> str:
    """Kind of the file by its content; by its ending where the content does not show it."""
    if head.startswith(_ULOG_START):
        return ".ulg"
    if head.startswith(_DATAFLASH_START):
        return ".bin"
    if head.startswith(_TABLE_STARTS):
        return ""
    if len(head) > 8 and head[8] in _MAVLINK_STARTS and head[0] == 0:
        return ".tlog"
    if b"FMT," in head:
        return ".log"
    return suffix if suffix in {".ulg", ".bin", ".tlog"} else ""


def _plain(file: Path, options: dict[str, Any]) -> Path:
    """`file`, provided that no option is given that its format states itself."""
    given = [key for key in ("mapping", "rate", *_TLOG_OPTIONS) if options.get(key)]
    if given:
        raise InvalidInputError(f"{file.name} is a log, its fields are known: leave {', '.join(given)} out")
    return file


__all__ = [
    "DataFlash",
    "is_table",
    "read",
    "read_dataflash",
    "read_dataflash_text",
    "read_table",
    "read_tlog",
    "read_ulog",
]
