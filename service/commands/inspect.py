"""``mavcal inspect``: is something wrong with the sensors, what is in a recording, and what it is worth.

It prints lines of 80 columns, at most 40 of them unless all are asked for.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.output import json_option, write_json
from mavcal.service.commands.reading import readable_file, reading_options

if TYPE_CHECKING:
    from mavcal.calib.health.report import HealthReport
    from mavcal.calib.recording import Recording


WIDTH = 80
HEAD, HEALTH, CHANNELS, REST, FLIGHT, NEXT = 6, 13, 6, 4, 6, 4
"""Most lines of each part in the short form; their sum leaves one line for what is left out."""
_BAD = frozenset({"faulty", "suspicious"})
_GOOD = frozenset({"ok", "pass"})


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


def inspection_lines(document: Mapping[str, Any], *, whole: bool = False) -> list[str]:
    """The lines of an inspection; the short form names sound parts in one line, and ends with a count of the rest."""
    parts = (
        (HEAD, _head(document)),
        (HEALTH, _health(document["health"], whole=whole)),
        (CHANNELS, _channels(document["channels"], whole=whole)),
        (REST, _rest(document)),
        (FLIGHT, _flight(document["flight"], whole=whole)),
        (NEXT, _steps(document["next"] if document["flight"] is not None else (), whole=whole)),
    )
    if whole:
        return [line for _, entries in parts for entry in entries for line in entry]
    lines, left = [], 0
    for most, entries in parts:
        shown = 0
        for number, entry in enumerate(entries):
            if shown + len(entry) > most and number:
                left += sum(map(len, entries[number:]))
                break
            part = entry[:most]
            lines += part
            shown += len(part)
            left += len(entry) - len(part)
    cut = f"{left} more lines, and the sound parts in full" if left > 1 else "the sound parts in full"
    return [*lines, f"({cut}: --all)"]


def _wrapped(text: str, indent: str = "  ", hang: int = 2) -> list[str]:
    """One entry, wrapped at words; its further lines are indented by `hang` more."""
    return textwrap.wrap(
        text, WIDTH, initial_indent=indent, subsequent_indent=indent + " " * hang, break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip


def _head(document: Mapping[str, Any]) -> list[list[str]]:
    identity = document["identity"]
    who = " ".join(str(v) for v in (identity["autopilot"], identity["uid"]) if v)
    entries = [_wrapped(f"{document['source']}  {document['duration']:.2f} s  {who}", "")]
    health = document["health"]
    if health is not None:
        entries.append(_wrapped(health["summary"], ""))
        if health["action"]:
            entries.append(_wrapped(f"Next: {health['action']}", ""))
    return entries


def _health(health: Mapping[str, Any] | None, *, whole: bool) -> list[list[str]]:
    """Every sensor with its faults; in the short form the sound ones share a line."""
    if health is None:
        return []
    entries: list[list[str]] = []
    for sensor in health["sensors"]:
        verdict = sensor["verdict"].replace("_", " ")
        if verdict == "ok" and not whole:
            continue
        bad = [finding for finding in sensor["findings"] if finding["verdict"] in _BAD]
        for number, finding in enumerate(bad or sensor["findings"][:1]):
            head = f"{verdict:10}  {sensor['name']}: " if number == 0 else f"{'':10}  "
            entries.append(_wrapped(f"  {head}{finding['text']}", "", 14))
    sound = [sensor["name"] for sensor in health["sensors"] if sensor["verdict"] == "ok"]
    if sound and not whole:
        entries.append(_wrapped(f"  {'ok':10}  {', '.join(sound)}", "", 14))
    lacks = [_wrapped(f"not logged: {line}") for line in health["lacks"]]
    return entries + (lacks if whole else lacks[:1]) + ([[""]] if whole else [])


def _channels(channels: Sequence[Mapping[str, Any]], *, whole: bool) -> list[list[str]]:
    if not whole:
        names = [f"{c['sensor']}[{c['instance']}]{_rate(c['rate'])}" for c in channels]
        return [_wrapped(f"{len(channels)} channels: {', '.join(names)}")] if channels else []
    entries = []
    for c in channels:
        mean = " ".join("-" if m is None else f"{m:.5g}" for m in c["mean"])
        size = "" if c["norm"] is None else f", length {c['norm'][0]:.5g}{_spread(c['norm'][1])}"
        rate = "" if c["rate"] is None else f"{c['rate']:.2f} Hz "
        name = f"{c['sensor']}[{c['instance']}]"
        text = f"{name} {c['source']} {c['stage']} {c['samples']} {rate}mean {mean}{size} {c['unit']}"
        entries.append(_wrapped(text))
    return entries


def _spread(sd: float) -> str:
    return f" ± {sd:.2g}" if sd > 0 else ""


def _rate(rate: float | None) -> str:
    return "" if rate is None else f" {rate:.4g} Hz"


def _rest(document: Mapping[str, Any]) -> list[list[str]]:
    parameters = document["parameters"]
    changes, events = len(parameters["changes"]), len(document["events"])
    entries = [_wrapped(f"{parameters['count']} parameters, {changes} changes, {events} events")]
    entries += [_wrapped(f"armed from {span['start']:.1f} to {span['end']:.1f} s") for span in document["armed"]]
    return entries + [_wrapped(f"! {warning}") for warning in document["warnings"]]


def _flight(flight: Mapping[str, Any] | None, *, whole: bool) -> list[list[str]]:
    from mavcal.calib.flight.item import worded_bounds

    if flight is None:
        return []
    rests = sum(r["end"] - r["start"] for r in flight["rests"])
    flown = sum(s["end"] - s["start"] for s in flight["flown"])
    entries = [
        _wrapped(
            f"inertial sensors: {flight['verdict']}; {len(flight['rests'])} rests of {rests:.0f} s, motors on for "
            f"{flown:.0f} s (known by {flight['motors_known_by']})"
        )
    ]
    for item in flight["items"]:
        if not whole and item["verdict"] in _GOOD:
            continue
        limit = item["limit"]
        bounds = "" if limit is None else f" [warn, fail: {worded_bounds(limit['warn'], limit['fail'], limit['unit'])}]"
        text = f"{item['verdict']} {item['name'].replace('_', ' ')}, {item['subject']}: {item['text']}{bounds}"
        entries.append(_wrapped(text, "    "))
    return entries


def _steps(steps: Sequence[Mapping[str, Any]], *, whole: bool) -> list[list[str]]:
    """Lines on the fits; the short form has only the worthwhile ones."""
    entries = []
    for step in steps:
        if step["worthwhile"] or whole:
            what = f"next: {step['command']}" if step["worthwhile"] else f"not: {step['method']}"
            entries.append(_wrapped(f"{what}: {step['reason']}"))
    return entries
