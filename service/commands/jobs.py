"""``mavcal jobs``: the jobs of a data directory, whoever runs it."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.output import json_option, write_json

if TYPE_CHECKING:
    from mavcal.service.store.rows import JobRow

HEAD = ("job", "kind", "state", "of", "begun (UTC)", "outcome")
_SHOWN_RECORDING = 8
"""Digits of a recording's id that tell it from others in a list."""


@click.command()
@click.option("--data-dir", type=click.Path(path_type=Path), default=None, help="Where the service keeps everything.")
@click.option("--kind", default=None, help="Only jobs of this kind: gyro, accel, fit, gap ...")
@click.option("--state", default=None, help="Only jobs in this state: review, failed, in_doubt ...")
@click.option("--limit", type=click.IntRange(1), default=20, show_default=True, help="At most so many, newest first.")
@json_option
def command(data_dir: Path | None, kind: str | None, state: str | None, limit: int, as_json: bool) -> int:
    """List calibrations, fits and diagnoses, newest first. The service may go on meanwhile."""
    from mavcal.service.store.sqlite import jobs_of

    rows = jobs_of(load_settings(data_dir=data_dir).data_dir)[::-1]
    found = [row for row in rows if kind in {None, row.kind} and state in {None, row.state}]
    shown = found[:limit]
    if as_json:
        write_json({"jobs": [_document(row) for row in shown], "older": len(found) - len(shown)})
        return 0
    for line in table([HEAD, *map(_cells, shown)]):
        click.echo(line)
    if len(found) > len(shown):
        click.echo(f"{len(found) - len(shown)} older jobs are not shown: give a larger --limit")
    return 0


def table(rows: list[tuple[str, ...]]) -> list[str]:
    """Lines with aligned columns; the last column is as long as it is."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]) - 1)]
    return ["  ".join((*map(str.ljust, row[:-1], widths), row[-1])).rstrip() for row in rows]


def _document(row: JobRow) -> dict[str, Any]:
    told = {name: row.body.get(name) for name in ("options", "outcome")}
    times = {"created_at": row.created_at, "updated_at": row.updated_at}
    return {"id": row.id, "vehicle_id": row.vehicle_id, "kind": row.kind, "state": row.state, **times, **told}


def _cells(row: JobRow) -> tuple[str, ...]:
    outcome = row.body.get("outcome") or {}
    begun = datetime.fromtimestamp(row.created_at, UTC).strftime("%Y-%m-%d %H:%M")
    return row.id, row.kind, row.state, _about(row), begun, outcome.get("text") or outcome.get("cause") or ""


def _about(row: JobRow) -> str:
    """The vehicle, or what the job is about instead of one."""
    options: Mapping[str, Any] = row.body.get("options") or {}
    if "task" in options:
        return str(options["task"])
    upload = options.get("recording") or options.get("real") or ""
    return row.vehicle_id or f"recording {str(upload)[:_SHOWN_RECORDING]}"
