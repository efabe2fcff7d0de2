"""``mavcal jobs``: lists the jobs of a data directory or of a running service."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.output import json_option, write_json
from mavcal.service.commands.remote import may_be_remote, service_at

if TYPE_CHECKING:
    from mavcal.service.settings import Settings
    from mavcal.service.store.rows import JobRow

HEAD = ("job", "kind", "state", "of", "begun (UTC)", "outcome")
MOST = 1000
"""Jobs of a page, as over HTTP."""
_SHOWN_RECORDING = 8
"""Digits of a recording's id that tell it from others in a list."""


@dataclass(frozen=True)
class _Wish:
    """Which jobs are asked for."""

    kind: str | None
    state: str | None
    limit: int
    after: str | None


@click.command()
@click.option("--data-dir", type=click.Path(path_type=Path), default=None, help="Where the service keeps everything.")
@may_be_remote
@click.option("--kind", default=None, help="Only jobs of this kind: gyro, accel, fit, gap ...")
@click.option("--state", default=None, help="Only jobs in this state: review, failed, in_doubt ...")
@click.option("--limit", type=click.IntRange(1, MOST), default=20, show_default=True, help="At most so many.")
@click.option("--after", default=None, metavar="JOB", help="List the jobs after this one, the last of the page before.")
@json_option
def command(
    *,
    data_dir: Path | None,
    url: str | None,
    key_file: Path | None,
    kind: str | None,
    state: str | None,
    limit: int,
    after: str | None,
    as_json: bool,
) -> int:
    """List calibrations, fits and diagnoses, newest first, a page at a time.

    Without --url the data directory is read; a service may go on with it meanwhile.
    """
    wish = _Wish(kind, _state(state), limit, after)
    if url is None:
        shown, more = _of_store(load_settings(data_dir=data_dir), wish)
    else:
        shown, more = _of_service(url, key_file, wish)
    following = shown[-1]["id"] if more else None
    if as_json:
        write_json({"jobs": shown, "next": following})
        return 0
    for line in table([HEAD, *map(_cells, shown)]):
        click.echo(line)
    if following is not None:
        click.echo(f"there are older jobs: --after {following} lists them")
    return 0


def table(rows: list[tuple[str, ...]]) -> list[str]:
    """Lines with aligned columns; the last column is as long as it is."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]) - 1)]
    return ["  ".join((*map(str.ljust, row[:-1], widths), row[-1])).rstrip() for row in rows]


def _state(name: str | None) -> str | None:
    from mavcal.service.jobs.core.states import JobState

    if name is not None and name not in list(JobState):
        raise click.UsageError(f"--state {name!r} is none of {', '.join(JobState)}")
    return name


def _of_service(url: str, key_file: Path | None, wish: _Wish) -> tuple[list[dict[str, Any]], bool]:
    """A page of jobs in the form of the API, and whether there are more."""
    from mavcal.client.enums import JobState

    state = None if wish.state is None else JobState(wish.state)
    with service_at(url, key_file) as client:
        found = client.list_jobs(kind=wish.kind, state=state, order="newest", limit=wish.limit, after=wish.after)
        more = len(found) == wish.limit and bool(
            client.list_jobs(kind=wish.kind, state=state, order="newest", limit=1, after=found[-1].id)
        )
    return [job.model_dump(mode="json") for job in found], more


def _of_store(settings: Settings, wish: _Wish) -> tuple[list[dict[str, Any]], bool]:
    """The same of what the settings name: a data directory, or a shared database."""
    from mavcal.service.api.paging import page_of
    from mavcal.service.storing import jobs_of

    rows = [r for r in jobs_of(settings)[::-1] if wish.kind in {None, r.kind} and wish.state in {None, r.state}]
    page, more = page_of(rows, wish.after, wish.limit)
    return [_document(row) for row in page], more


def _document(row: JobRow) -> dict[str, Any]:
    """As over HTTP. A row whose body is damaged says what its columns say."""
    from mavcal.calib.errors import CalibError
    from mavcal.service.api.views import job_summary
    from mavcal.service.jobs.core.codec import job_from_row
    from mavcal.service.jobs.core.model import Job
    from mavcal.service.jobs.core.states import JobState

    try:
        job = job_from_row(row)
    except CalibError:
        job = Job(row.id, row.vehicle_id, row.kind, {}, JobState(row.state), row.created_at, row.updated_at)
    return job_summary(job).model_dump(mode="json")


def _cells(job: Mapping[str, Any]) -> tuple[str, ...]:
    outcome = job["outcome"] or {}
    begun = datetime.fromtimestamp(job["created_at"], UTC).strftime("%Y-%m-%d %H:%M")
    text = outcome.get("text") or outcome.get("cause") or ""
    return job["id"], job["kind"], job["state"], _about(job), begun, text


def _about(job: Mapping[str, Any]) -> str:
    """The vehicle, or what the job is about instead of one."""
    if "task" in job["options"]:
        return str(job["options"]["task"])
    upload = job["options"].get("recording") or job["options"].get("real") or ""
    return job["vehicle_id"] or f"recording {str(upload)[:_SHOWN_RECORDING]}"
