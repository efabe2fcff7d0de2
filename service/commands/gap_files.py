"""The files of a gap diagnosis: input, read with the options that apply to each, and exports."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.output import write_file
from mavcal.service.commands.reading import readable_file

if TYPE_CHECKING:
    from mavcal.calib.gap.schema import GapReport
    from mavcal.calib.recording import Recording


@dataclass(frozen=True)
class Files:
    """The recordings by role, and the digests of the first two."""

    real: Recording
    sim: Recording | None
    nominal: tuple[Recording, ...]
    again: Recording | None
    hashes: Mapping[str, str]


@dataclass(frozen=True)
class Remedy:
    """Target of every export (None: by its suffix), its instance, and facts besides the recordings.

    `mass` is the real vehicle's, kg; `frame` holds the keys that ArduPilot's simulator flew with.
    """

    target: str | None = None
    instance: int = 1
    mass: float | None = None
    frame: Mapping[str, Any] | None = None


def read_files(
    real: str, sim: str | None, nominal: Sequence[str], again: str | None, reading: Mapping[str, Any]
) -> Files:
    """Every file; the reading options apply to `real`, and to the others if they are tables."""
    from mavcal.calib import logs

    mapping = reading["sim_mapping"]
    own = {k: v for k, v in reading.items() if k != "sim_mapping"}

    def other(name: str, mapped: Mapping[str, str]) -> Recording:
        file = readable_file(name)
        if not logs.is_table(file):  # a log states its own columns, rates and units
            return logs.read(file)
        return logs.read(file, **{**own, "mapping": dict(mapped or own["mapping"])})

    first = readable_file(real)
    hashes = {"real": _sha256(first)} | ({} if sim is None else {"sim": _sha256(readable_file(sim))})
    return Files(
        logs.read(first, **own),
        None if sim is None else other(sim, mapping),
        tuple(other(name, {}) for name in nominal),
        None if again is None else other(again, mapping),
        hashes,
    )


def read_frame(name: str) -> Mapping[str, Any]:
    """The keys of a frame file of ArduPilot's simulator.

    Raises
    ------
    click.BadParameter
        If there is no such file, or it is no frame.
    """
    from mavcal.calib.errors import InvalidInputError
    from mavcal.calib.gap.export import frame_from_text

    try:
        return frame_from_text(readable_file(name).read_text(encoding="utf-8"))
    except (InvalidInputError, UnicodeDecodeError) as error:
        raise click.BadParameter(f"{name}: {error}") from error


def _sha256(file: Path) -> str:
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def write_page(report: GapReport, title: str, out: Path) -> None:
    """The report as a page."""
    from mavcal.calib.gap_report import gap_to_html

    write_file(out, gap_to_html(report, title=title))


def check_exports(outs: Sequence[Path], target: str | None) -> None:
    """Refuse invalid names of exports, before anything is computed.

    Raises
    ------
    click.BadParameter
        If an ending does not say whom the file is for, or does not fit whom it is for.
    """
    from mavcal.calib.errors import InvalidInputError
    from mavcal.calib.firmware.export import ParameterFormat
    from mavcal.calib.gap.export import Target, target_of

    for out in outs:
        try:
            wanted = target_of(out.name, target)
        except InvalidInputError as error:
            raise click.BadParameter(str(error)) from error
        forms = [f".{form}" for form in ParameterFormat]
        if wanted is Target.VEHICLE and out.suffix not in forms:
            raise click.BadParameter(f"{out.name}: a vehicle's file ends in {', '.join(forms)}")


def check_folders(outs: Sequence[Path]) -> None:
    """Refuse files in missing folders, before minutes are spent on computing.

    Raises
    ------
    click.BadParameter
        If there is no such folder.
    """
    for out in outs:
        if not out.parent.is_dir():
            raise click.BadParameter(f"{out} cannot be written: there is no folder {out.parent}")


def write_exports(report: GapReport, files: Files, outs: Sequence[Path], remedy: Remedy) -> list[dict[str, Any]]:
    """Write the remedy; for each file its name, whom it is for, and what it cannot hold."""
    from mavcal.calib.errors import CalibError
    from mavcal.calib.firmware.export import ParameterFormat
    from mavcal.calib.gap import simulator_of
    from mavcal.calib.gap.export import exported, target_of

    written: list[dict[str, Any]] = []
    for out in outs:
        wanted = target_of(out.name, remedy.target)
        forms = {f".{form}": form for form in ParameterFormat}
        try:
            made = exported(
                report,
                files.real,
                wanted,
                base=simulator_of(files.real, files.sim),
                instance=remedy.instance,
                form=forms.get(out.suffix, ParameterFormat.PARM),
                frame=remedy.frame,
                mass=remedy.mass,
            )
        except CalibError as error:
            click.echo(f"{out} is not written: {error}", err=True)
            written.append({"file": out.name, "for": wanted.value, "written": False, "reason": str(error)})
            continue
        write_file(out, made.text)
        for text in made.not_held:
            click.echo(f"{out} cannot hold {text}", err=True)
        for text in made.doubtful:
            click.echo(f"{out} holds what is doubtful: {text}", err=True)
        limits = {"not_held": list(made.not_held), "doubtful": list(made.doubtful)}
        written.append({"file": out.name, "for": wanted.value, "written": True, **limits})
    return written
