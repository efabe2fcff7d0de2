"""The options with which every command reads a recording, foreign tables included."""

from __future__ import annotations

import stat
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from mavcal.calib.recording import Recording

ACCEL_UNITS = ("si", "g", "mg", "counts")
GYRO_UNITS = ("si", "deg/s", "mrad/s", "counts")
MAG_UNITS = ("uT", "mgauss", "gauss", "counts")
_NO_FILES = (
    (stat.S_ISDIR, "a folder: give one of the files in it"),
    (stat.S_ISFIFO, "a pipe (FIFO): save what comes out of it to a file, and give that"),
    (stat.S_ISSOCK, "a socket: connect to it with --connect, or give a file"),
    (stat.S_ISCHR, "a device: connect to a serial port with --connect, or give a file"),
    (stat.S_ISBLK, "a disk: give a file on it"),
)
"""Kinds of paths without a known end: a pipe may block for ever, a device may never stop."""


def parse_mapping(_ctx: click.Context, _param: click.Parameter, value: str | None) -> dict[str, str]:
    """``a=1,b=col*2`` as a mapping."""
    pairs: dict[str, str] = {}
    for item in (value or "").split(","):
        if not item.strip():
            continue
        name, equals, column = item.partition("=")
        if not equals or not name.strip() or not column.strip():
            raise click.BadParameter(f"{item!r} is not NAME=COLUMN; example: mag_x=3,mag_y=4,accel_x=ax*9.80665")
        pairs[name.strip()] = column.strip()
    return pairs


OPTIONS: tuple[Callable[[Callable[..., Any]], Callable[..., Any]], ...] = (
    click.option(
        "--map",
        "mapping",
        callback=parse_mapping,
        metavar="NAME=COLUMN[*FACTOR],...",
        help="Columns by header name or 0-based number.",
    ),
    click.option("--world", type=click.Choice(["ned", "enu"]), default="ned", show_default=True, help="World frame."),
    click.option("--body", type=click.Choice(["frd", "flu"]), default="frd", show_default=True, help="Body frame."),
    click.option("--rate", type=float, default=None, metavar="HZ", help="Makes `t` where the table has none."),
    click.option("--unit-accel", type=click.Choice(ACCEL_UNITS), default="si", show_default=True, help="Accel unit."),
    click.option("--unit-gyro", type=click.Choice(GYRO_UNITS), default="si", show_default=True, help="Gyro unit."),
    click.option("--unit-mag", type=click.Choice(MAG_UNITS), default="uT", show_default=True, help="Mag unit."),
)


def labelled_file(_ctx: click.Context, _param: click.Parameter, values: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """``x-up=FILE`` as label and path, for an option that may be repeated."""
    pairs = []
    for value in values:
        label, equals, path = value.partition("=")
        if not equals or not label.strip() or not path.strip():
            raise click.BadParameter(f"{value!r} is not LABEL=FILE; example: x-up=first.csv")
        pairs.append((label.strip(), path.strip()))
    return tuple(pairs)


face_option = click.option(
    "--face",
    "faces",
    multiple=True,
    callback=labelled_file,
    metavar="LABEL=FILE",
    help="One recording a face, ring or turn instead of FILE; repeated: x-up= y-up= z-up= x-down= y-down= z-down=",
)


def read_recording(file: str | None, faces: Sequence[tuple[str, str]], reading: Mapping[str, Any]) -> Recording:
    """The recording in `file`, or the labelled ones of `faces` as one.

    Raises
    ------
    click.UsageError
        If there is neither, or both.
    """
    from mavcal.calib import logs
    from mavcal.calib.logs.parts import of_parts

    if bool(faces) == (file is not None):
        raise click.UsageError("give either one FILE, or --face LABEL=FILE for every face")
    if file is not None:
        return logs.read(readable_file(file), **reading)
    return of_parts([(label, logs.read(readable_file(path), **reading)) for label, path in faces])


def reading_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the reading options to a command function."""
    for option in reversed(OPTIONS):
        command = option(command)
    return command


def split_reading(options: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The reading options, as ``calib.logs.read`` takes them, and the rest."""
    names = {"mapping", "world", "body", "rate", "unit_accel", "unit_gyro", "unit_mag"}
    reading = {k: v for k, v in options.items() if k in names}
    return reading, {k: v for k, v in options.items() if k not in names}


def readable_file(path: str) -> Path:
    """The path of a file that exists.

    Raises
    ------
    click.BadParameter
        If there is none, or it is a folder, a pipe or a device.
    """
    file = Path(path)
    if not file.exists():
        raise click.BadParameter(f"there is no file {path}")
    mode = file.stat().st_mode
    what = next((name for is_one, name in _NO_FILES if is_one(mode)), None)
    if what is not None:
        raise click.BadParameter(f"{file.name or file} is {what}")
    return file
