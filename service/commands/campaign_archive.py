"""A campaign through a folder of logs on the command line."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

from mavcal.service.campaigns.archive import FOLDER, Archive, archive
from mavcal.service.campaigns.executors import Workers, abandon, workers
from mavcal.service.campaigns.items import item_from_row
from mavcal.service.campaigns.outcome import head, lines
from mavcal.service.children import Limits
from mavcal.service.commands.campaign_items import campaign_among
from mavcal.service.commands.campaign_output import (
    CampaignSnapshot,
    OutputOptions,
    followed,
    print_campaign,
    write_table,
)
from mavcal.service.commands.door import stoppable
from mavcal.service.commands.place import place_of
from mavcal.service.commands.screen import Screen
from mavcal.service.jobs.core.codec import to_json
from mavcal.service.jobs.core.model import Job
from mavcal.service.logs import configure_logging
from mavcal.service.settings import Settings
from mavcal.service.store.sqlite import jobs_of

Begin = Callable[[Archive], Awaitable[Job]]
"""Makes the campaign, or goes on with one. Raises ServiceError, CalibError."""
_ALL = 1_000_000


def run_archive(settings: Settings, executor: str, begin: Begin, output: OutputOptions) -> int:
    """One campaign from `begin` to its end; the exit code."""
    configure_logging(as_json=settings.log_json)
    with workers(executor) as given:
        return asyncio.run(_run(settings, given, begin, output, Screen(place_of(settings))))


def is_of_folder(data_dir: Path, job_id: str) -> bool:
    """Whether a job is a campaign through files. Raises JobUnknown, StoreError."""
    return FOLDER in (campaign_among(jobs_of(data_dir), job_id).body.get("options") or {})


async def _run(settings: Settings, given: Workers, begin: Begin, output: OutputOptions, screen: Screen) -> int:

    limits = settings.limits
    of_fits = Limits(limits.file_memory_bytes, limits.file_cpu_s, limits.file_wall_s)
    of_gaps = Limits(limits.file_memory_bytes, limits.gap_s, limits.gap_s)
    with stoppable() as caught:
        try:
            async with archive(settings.data_dir, given, of_fits, of_gaps) as found:
                job = await begin(found)
                screen.line(f"campaign {job.id}")
                try:
                    snapshot = await followed(lambda: _snapshot(found, job.id), screen)
                except asyncio.CancelledError:
                    screen.line(f"stopped: `mavcal campaign resume {job.id}` goes on with it", bold=True)
                    raise
                return await _print_outcome(found, snapshot, output, screen)
        except asyncio.CancelledError:
            if not caught:
                raise
            abandon()
            return 128 + caught[0]


async def _snapshot(found: Archive, job_id: str) -> CampaignSnapshot:

    job = found.book.handle(job_id).job
    return CampaignSnapshot(job.id, job.state.value, dict(job.options), to_json(job.outcome), to_json(job.progress))


async def _print_outcome(found: Archive, snapshot: CampaignSnapshot, output: OutputOptions, screen: Screen) -> int:

    rows = await found.store.do(lambda: found.store.items(snapshot.id, limit=_ALL))
    items = [item_from_row(row) for row in rows]
    if output.table is not None:
        write_table(output.table, head() + lines(items), len(items))
    documents = [{n: value for n, value in to_json(item).items() if n not in {"result", "starts"}} for item in items]
    return print_campaign(snapshot, documents, output, screen)
