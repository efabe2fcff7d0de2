"""``mavcal follow JOB``: what happens to a job of a running service, until it ends or waits to be accepted."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcal.service.commands.output import EXIT_NO, EXIT_PART, json_option, write_json
from mavcal.service.commands.place import CommandPlace
from mavcal.service.commands.remote import async_service_at, came_well, followed, remote, show_came_of

if TYPE_CHECKING:
    from mavcal.client.jobs import JobModel


@click.command()
@click.argument("job_id", metavar="JOB")
@remote
@json_option
def command(*, job_id: str, url: str, key_file: Path | None, as_json: bool) -> int:
    """Show a job's prompts and progress; a line that is typed answers the present prompt.

    Ctrl-C ends the showing and leaves the job alone. Exit code 0: it succeeded, or its plan waits in review. 1: it
    ended otherwise, or its plan cannot be written. 3: as 0, but a sensor is left out.
    """
    from mavcal.service.commands.screen import Screen

    screen = Screen(CommandPlace(url=url, key_file=key_file))

    async def until_it_rests() -> JobModel:
        async with async_service_at(url, key_file) as client:
            return await followed(client, job_id, screen)

    job = asyncio.run(until_it_rests())
    show_came_of(job, screen)
    if as_json:
        write_json(job.model_dump(mode="json"))
    if not came_well(job):
        return EXIT_NO
    return EXIT_PART if job.left_out else 0
