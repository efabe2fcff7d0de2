"""``mavcal campaign items``: lists the items of a campaign in a data directory or a running service."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.campaign_output import OutputOptions, write_table
from mavcal.service.commands.door import Door, through_door
from mavcal.service.commands.output import write_json
from mavcal.service.commands.whom import Whom
from mavcal.service.errors import JobUnknown

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.client.models import ItemModel
    from mavcal.service.store.rows import JobRow

PAGE = 1000
"""Items of a page, at most."""
_HEAD = ("item", "outcome", "job", "of", "text")
OF_HTTP = {"job_state", "preflight", "fits", "documents"}
"""Fields of an item that only the API has; a data directory keeps what was found as its `result`."""


@dataclass(frozen=True)
class Listing:
    """Items of a campaign as JSON, and as a table."""

    items: Sequence[Mapping[str, Any]]
    csv: str = ""


def show_items(whom: Whom, job_id: str, outcomes: Sequence[str], output: OutputOptions) -> int:
    """List the items of a campaign with all that they hold; the exit code.

    Raises
    ------
    JobUnknown
        If there is no such campaign.
    StoreError
        If the data directory cannot be read.
    AnsweredNo
        If the service does not answer.
    """
    if whom.url is None:
        return _show(job_id, _of_directory(whom.settings.data_dir, job_id, outcomes), output)

    async def ask(at: Door) -> Listing:
        return await _of_service(at.client, job_id, outcomes, table=output.table is not None)

    found = through_door(whom, ask)
    return found if isinstance(found, int) else _show(job_id, found, output)


async def items_of(client: AsyncClient, job_id: str, outcomes: Sequence[str] = ()) -> list[ItemModel]:
    """Every item of a campaign, or those with one of these outcomes."""
    from mavcal.client.enums import ItemOutcome

    wanted = [ItemOutcome(outcome) for outcome in outcomes] or None
    found: list[ItemModel] = []
    while page := await client.list_items(
        job_id, outcome=wanted, after=found[-1].number if found else None, limit=PAGE
    ):
        found += page
    return found


def campaign_among(rows: Sequence[JobRow], job_id: str) -> JobRow:
    """The campaign of that id among the jobs of a data directory. Raises JobUnknown."""
    from mavcal.service.campaigns.campaigns import CAMPAIGN

    found = next((row for row in rows if row.id == job_id and row.kind == CAMPAIGN), None)
    if found is None:
        raise JobUnknown(f"there is no campaign {job_id} in this data directory")
    return found


def _of_directory(data_dir: Path, job_id: str, outcomes: Sequence[str]) -> Listing:
    from mavcal.service.campaigns.items import BEGUN_BY, Item, ItemOutcome, begun_by, item_from_row
    from mavcal.service.campaigns.outcome import head, lines
    from mavcal.service.jobs.core.codec import to_json
    from mavcal.service.store.sqlite import items_of as rows_of
    from mavcal.service.store.sqlite import jobs_of

    jobs = jobs_of(data_dir)
    campaign_among(jobs, job_id)
    found = [item_from_row(row) for row in rows_of(data_dir, job_id, outcomes or None)]

    def present_job(item: Item) -> str | None:
        """The item itself names its job only once that has ended."""
        if item.outcome is not ItemOutcome.RUNNING:
            return item.job_id
        ours = begun_by(job_id, item)
        begun = (row.id for row in reversed(jobs) if (row.body.get("context") or {}).get(BEGUN_BY) == ours)
        return next(begun, item.job_id)

    return Listing([{**to_json(item), "job_id": present_job(item)} for item in found], head() + lines(found))


async def _of_service(client: AsyncClient, job_id: str, outcomes: Sequence[str], *, table: bool) -> Listing:
    from mavcal.client.enums import ItemOutcome
    from mavcal.service.campaigns.campaigns import CAMPAIGN

    if (await client.get_job(job_id)).kind != CAMPAIGN:
        raise JobUnknown(f"there is no campaign {job_id} in this service")
    items = [_document(item) for item in await items_of(client, job_id, outcomes)]
    wanted = [ItemOutcome(outcome) for outcome in outcomes] or None
    return Listing(items, await client.export_items(job_id, "csv", outcome=wanted) if table else "")


def _document(item: ItemModel) -> dict[str, Any]:
    """The item as a data directory has it, without the fields that HTTP leaves out."""
    result: dict[str, Any] = {}
    if item.preflight is not None:
        found = item.preflight.model_dump(mode="json")
        same = {name: found[name] for name in ("vehicle_id", "at", "seconds", "notes")}
        result["preflight"] = {**same, "report": {"checks": found["checks"]}}
    if item.fits:
        result["fits"] = [fit.model_dump(mode="json", exclude={"parameters"}) for fit in item.fits]
    if item.documents:
        result["documents"] = [document.name for document in item.documents]
    return {**item.model_dump(mode="json", exclude=OF_HTTP), "result": result or None}


def _show(job_id: str, found: Listing, output: OutputOptions) -> int:
    from mavcal.service.commands.jobs import table

    if output.table is not None:
        write_table(output.table, found.csv, len(found.items))
    if output.as_json:
        write_json({"id": job_id, "items": found.items})
        return 0
    cells = [
        (str(i["number"]), i["outcome"], i["job_id"] or "", i["name"] or i["subject"], i["text"]) for i in found.items
    ]
    for line in table([_HEAD, *cells]):
        click.echo(line)
    return 0
