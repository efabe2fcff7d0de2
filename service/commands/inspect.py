"""``mavcal inspect``: is something wrong with the sensors, what is in a recording, and what it is worth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.output import json_option, write_json
from mavcal.service.commands.reading import readable_file, reading_options

if TYPE_CHECKING:
    from mavcal.calib.health.report import HealthReport
    from mavcal.calib.recording import Recording


@click.command()
@click.argument("files", metavar="FILE...", nargs=-1, required=True)
@reading_options
@click.option("--report", "page", type=click.Path(path_type=Path, dir_okay=False), help="Write the health as HTML.")
@click.option("--table", is_flag=True, help="One line a log: for a folder of them.")
@click.option("--all", "whole", is_flag=True, help="Everything, however long: else at most 40 lines.")
@json_option
def command(
    files: tuple[str, ...], page: Path | None, *, table: bool, whole: bool, as_json: bool, **reading: Any
) -> None:
    """Judge every sensor of a recording, and tell what is in it: channels, rates, gaps, ranges, damage.

    Reads telemetry logs (.tlog), DataFlash (.bin, text), ULog (.ulg) and tables (.csv, .npz, .mat ...).
    """
    if table:
        _show_table(files, reading, as_json=as_json)
        return
    if len(files) > 1:
        raise click.UsageError("one FILE at a time; with --table several")
    recording, found = _judged(files[0], reading)
    from mavcal.calib.methods.overview import overview

    document = overview(recording, found)
    if page is not None:
        from mavcal.calib.health.page import health_page

        if found is None:
            raise click.UsageError("--report is for flights: the spans of this recording are labelled by hand")
        page.write_text(
            health_page(found, recording, title=f"Sensor health of {Path(files[0]).name}"), encoding="utf-8"
        )
    if as_json:
        write_json(document)
        return
    from mavcal.service.commands.inspect_output import inspection_lines

    for line in inspection_lines(document, whole=whole):
        click.echo(line)


def _judged(file: str, reading: Mapping[str, Any]) -> tuple[Recording, HealthReport | None]:
    """A recording, and its health; None: its spans are labelled by hand."""
    from mavcal.calib import logs
    from mavcal.calib.health.report import health

    recording = logs.read(readable_file(file), **reading)
    return recording, None if recording.segments else health(recording)


def _show_table(files: Sequence[str], reading: Mapping[str, Any], *, as_json: bool) -> None:
    """The health of every log in one line; one that cannot be read is a line as well."""
    from mavcal.calib.errors import CalibError

    rows = []
    for file in files:
        name = Path(file).name
        try:
            _, found = _judged(file, reading)
        except (CalibError, click.ClickException) as error:
            reason = error.message if isinstance(error, click.ClickException) else str(error)
            rows.append({"file": name, "verdict": "unreadable", "summary": reason})
            continue
        verdict, summary = ("bench", "Labelled by hand.") if found is None else (found.verdict.value, found.summary)
        rows.append({"file": name, "verdict": verdict, "summary": summary})
    if as_json:
        write_json({"logs": rows})
        return
    wide = max(len(row["file"]) for row in rows)
    for row in rows:
        click.echo(f"{row['file']:{wide}}  {row['verdict'].replace('_', ' '):10}  {row['summary']}")
