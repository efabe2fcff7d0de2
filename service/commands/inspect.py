"""``mavcal inspect``: what is in a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import click

from mavcal.service.commands.output import json_option, write_json
from mavcal.service.commands.reading import readable_file, reading_options


@click.command()
@click.argument("file")
@reading_options
@json_option
def command(file: str, as_json: bool, **reading: Any) -> None:
    """Tell what is in a recording: channels, rates, gaps, ranges, damage.

    Reads telemetry logs (.tlog), DataFlash (.bin, text), ULog (.ulg) and tables (.csv, .npz, .mat ...).
    """
    from mavcal.calib import logs
    from mavcal.calib.flight.report import overview

    document = overview(logs.read(readable_file(file), **reading))
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
        size = "" if c["norm"] is None else f", length {c['norm'][0]:.5g} +- {c['norm'][1]:.2g}"
        name = f"{c['sensor']}[{c['instance']}]"
        click.echo(
            f"  {name:14} {c['source']:16} {c['stage']:10} {c['samples']:8} {rate:>12}  mean {mean}{size} {c['unit']}"
        )
    parameters = document["parameters"]
    for span in document["armed"]:
        click.echo(f"  armed from {span['start']:.1f} to {span['end']:.1f} s")
    click.echo(
        f"  {parameters['count']} parameters, {len(parameters['changes'])} changes, {len(document['events'])} events"
    )
    for warning in document["warnings"]:
        click.echo(f"  ! {warning}")
    if document["flight"] is not None:
        _show_flight(document["flight"], document["next"])


def _show_flight(flight: Mapping[str, Any], steps: Sequence[Mapping[str, Any]]) -> None:
    rests = sum(r["end"] - r["start"] for r in flight["rests"])
    flown = sum(s["end"] - s["start"] for s in flight["flown"])
    click.echo(
        f"  inertial sensors: {flight['verdict']}; {len(flight['rests'])} rests of {rests:.0f} s, motors on for "
        f"{flown:.0f} s (known by {flight['motors_known_by']})"
    )
    for item in flight["items"]:
        limit = item["limit"]
        bounds = "" if limit is None else f"  [warn {limit['warn']:.3g}, fail {limit['fail']:.3g} {limit['unit']}]"
        click.echo(f"    {item['verdict']:12} {item['name']:18} {item['subject']:10} {item['text']}{bounds}")
    for step in steps:
        click.echo(
            f"  {'next: ' + step['command'] if step['worthwhile'] else 'not:  ' + step['method']}: {step['reason']}"
        )
