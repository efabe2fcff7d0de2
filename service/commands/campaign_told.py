"""Follows a campaign on the command line and prints what became of its items."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.output import EXIT_NO, EXIT_PART, write_json

if TYPE_CHECKING:
    from mavcal.service.campaigns.items import Item
    from mavcal.service.commands.screen import Screen
    from mavcal.service.jobs.core.model import Job
    from mavcal.service.store.rows import ItemRow

_LOOK_S = 0.1
_MOST_SHOWN = 20


@dataclass(frozen=True)
class Telling:
    """How the outcome is wanted."""

    table: Path | None = None
    """File of the CSV; None: none."""
    as_json: bool = False


async def followed(job_of: Callable[[], Job], screen: Screen) -> Job:
    """The campaign once it goes on no more; meanwhile `screen` shows how far it is."""
    from mavcal.service.jobs.core.codec import to_json
    from mavcal.service.jobs.core.states import ENDED

    while (job := job_of()).state not in ENDED:
        if job.progress is not None:
            screen.progress(to_json(job.progress))
        await asyncio.sleep(_LOOK_S)
    return job


def tell(job: Job, rows: Sequence[ItemRow], telling: Telling, screen: Screen) -> int:
    """Show a campaign that has ended, and its exit code."""
    from mavcal.service.campaigns.items import ItemOutcome, item_from_row
    from mavcal.service.jobs.core.codec import to_json
    from mavcal.service.jobs.core.model import Failure

    found = [item_from_row(row) for row in rows]
    if telling.table is not None:
        _write_table(telling.table, found)
    if telling.as_json:
        about = {"id": job.id, "state": job.state.value, "options": dict(job.options), "outcome": to_json(job.outcome)}
        write_json(
            {**about, "counts": Counter(item.outcome.value for item in found), "items": list(map(_short, found))}
        )
    else:
        open_still = [item for item in found if item.outcome is not ItemOutcome.DONE]
        for item in open_still[:_MOST_SHOWN]:
            screen.line(f"    {item.outcome.value:10}{item.name or item.subject}: {item.text}")
        if len(open_still) > _MOST_SHOWN:
            more = len(open_still) - _MOST_SHOWN
            screen.line(f"    {more} more are not done: `mavcal campaign items {job.id}` lists them")
    failed = isinstance(job.outcome, Failure)
    said = f"{job.outcome.cause} {job.outcome.remedy}" if isinstance(job.outcome, Failure) else ""
    said = said or (job.outcome.text if job.outcome is not None and not isinstance(job.outcome, Failure) else "")
    screen.line(f"{job.state.value}: {said}", bold=True)
    return EXIT_NO if failed else exit_code(job.options, [item.outcome for item in found])


def exit_code(options: Mapping[str, Any], outcomes: Iterable[str]) -> int:
    """0: every item is done, or waits in review as asked. 3: some preflights warn. 1: something else is not done."""
    good = {"done"} if options.get("apply") else {"done", "review"}
    left = set(outcomes) - good
    return 0 if not left else EXIT_PART if left == {"warned"} else EXIT_NO


def show_items(data_dir: Path, job_id: str, outcomes: Sequence[str], table: Path | None, *, as_json: bool) -> int:
    """The items of a campaign of a data directory, whoever runs it; results are in the JSON."""
    from mavcal.service.campaigns.campaigns import CAMPAIGN
    from mavcal.service.campaigns.items import item_from_row
    from mavcal.service.commands.jobs import table as aligned
    from mavcal.service.errors import JobUnknown
    from mavcal.service.jobs.core.codec import to_json
    from mavcal.service.store.sqlite import items_of, jobs_of

    if not any(row.id == job_id and row.kind == CAMPAIGN for row in jobs_of(data_dir)):
        raise JobUnknown(f"there is no campaign {job_id} in this data directory")
    found = [item_from_row(row) for row in items_of(data_dir, job_id, outcomes or None)]
    if table is not None:
        _write_table(table, found)
    if as_json:
        write_json({"id": job_id, "items": [to_json(item) for item in found]})
        return 0
    head = ("item", "outcome", "job", "of", "text")
    cells = [(str(i.number), i.outcome.value, i.job_id or "", i.name or i.subject, i.text) for i in found]
    for line in aligned([head, *cells]):
        click.echo(line)
    return 0


def _short(item: Item) -> dict[str, Any]:
    """An item without what was found: `mavcal campaign items --json` has that too."""
    from mavcal.service.jobs.core.codec import to_json

    told: dict[str, Any] = to_json(item)
    return {name: value for name, value in told.items() if name not in {"result", "starts"}}


def _write_table(path: Path, items: Sequence[Item]) -> None:
    from mavcal.service.campaigns.outcome import head, lines

    try:
        path.write_text(head() + lines(items), encoding="utf-8", newline="")
    except OSError as error:
        raise click.ClickException(f"{path} cannot be written: {error.strerror}") from error
    click.echo(f"{path}: {len(items)} items", err=True)
