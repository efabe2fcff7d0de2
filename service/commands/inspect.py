"""``mavcal inspect``: what is in a recording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from service.commands.output import json_option, write_json
from service.commands.reading import readable_file, reading_options


@click.command()
@click.argument("file")
@reading_options
@json_option
def command(file: str, as_json: bool, **reading: Any) -> None:
    """Tell what is in a recording: channels, rates, gaps, ranges, damage.

    Reads tables (.csv, .npz, .mat ...) and telemetry logs (.tlog); DataFlash and ULog come later.
    """
    from calib import logs
    from calib.inspection import inspect

    document = inspect(logs.read(readable_file(file), **reading))
    if as_json:
        write_json(document)
    else:
        _show(document)


def _show(document: Mapping[str, Any]) -> None:
    identity = document["identity"]
    who = " ".join(str(v) for v in (identity["autopilot"], identity["uid"]) if v)
    click.echo(f"{document['source']}  {document['duration']:.2f} s  {who}")
    for c in document["channels"]:
        rate = "" if c["rate"] is None else f"{c['rate']:8.2f} Hz"
        mean = " ".join("-" if m is None else f"{m:.5g}" for m in c["mean"])
        name = f"{c['sensor']}[{c['instance']}]"
        click.echo(f"  {name:14} {c['source']:16} {c['stage']:10} {c['samples']:8} {rate:>12}  mean {mean} {c['unit']}")
    parameters = document["parameters"]
    click.echo(
        f"  {parameters['count']} parameters, {len(parameters['changes'])} changes, {len(document['events'])} events"
    )
    for warning in document["warnings"]:
        click.echo(f"  ! {warning}")
