"""``mavcal convert``: a recording as a table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from mavcal.service.commands.output import json_option, write_json, writing
from mavcal.service.commands.reading import readable_file, reading_options


@click.command()
@click.argument("file")
@click.argument("out", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--raw", is_flag=True, help="Undo the calibration in force first.")
@reading_options
@json_option
def command(file: str, out: Path, raw: bool, as_json: bool, **reading: Any) -> None:
    """Turn a recording into a table: OUT ends in .csv or .npz."""
    from mavcal.calib import logs
    from mavcal.calib.firmware.in_force.undo import undo
    from mavcal.calib.logs.tables import write_table

    recording = logs.read(readable_file(file), **reading)
    if raw:
        recording = undo(recording)
    with writing(out):
        write_table(recording, out)
    if as_json:
        write_json({"out": str(out), "channels": len(recording.channels), "raw": raw})
    else:
        click.echo(f"{out}: {len(recording.channels)} channels", err=True)
