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
@json_option
def command(files: tuple[str, ...], page: Path | None, table: bool, as_json: bool, **reading: Any) -> None:
    """Judge every sensor of a recording, and tell what is in it: channels, rates, gaps, ranges, damage.

    Reads telemetry logs (.tlog), DataFlash (.bin, text), ULog (.ulg) and tables (.csv, .npz, .mat ...).
    """
    if table:
        _show_table(files, reading, as_json=as_json)
        return
    if len(files) > 1:
        raise click.UsageError("one FILE at a time; with --table several")
    recording, found = _judged(files[0], reading)
    from mavcal.calib.health.overview import overview

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
    else:
        _show(document)


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
            said = error.message if isinstance(error, click.ClickException) else str(error)
            rows.append({"file": name, "verdict": "unreadable", "summary": said})
            continue
        verdict, summary = ("bench", "Labelled by hand.") if found is None else (found.verdict.value, found.summary)
        rows.append({"file": name, "verdict": verdict, "summary": summary})
    if as_json:
        write_json({"logs": rows})
        return
    wide = max(len(row["file"]) for row in rows)
    for row in rows:
        click.echo(f"{row['file']:{wide}}  {row['verdict'].replace('_', ' '):10}  {row['summary']}")


def _show(document: Mapping[str, Any]) -> None:
    identity = document["identity"]
    who = " ".join(str(v) for v in (identity["autopilot"], identity["uid"]) if v)
    click.echo(f"{document['source']}  {document['duration']:.2f} s  {who}")
    if document["health"] is not None:
        _show_health(document["health"])
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


def _show_health(health: Mapping[str, Any]) -> None:
    """The whole log in one line, then every sensor with what speaks against it."""
    click.echo(health["summary"])
    if health["action"]:
        click.echo(f"Next: {health['action']}")
    for sensor in health["sensors"]:
        verdict = sensor["verdict"].replace("_", " ")
        bad = [f for f in sensor["findings"] if f["verdict"] in ("faulty", "suspicious")]
        shown = bad or sensor["findings"][:1]
        for number, finding in enumerate(shown):
            head = f"  {verdict:10}  {sensor['name']:16}" if number == 0 else " " * 30
            click.echo(f"{head}  {finding['text']}")
    for line in health["lacks"]:
        click.echo(f"  not logged: {line}")
    click.echo("")


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
