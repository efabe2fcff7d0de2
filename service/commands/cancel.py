"""``mavcal cancel JOB``: end a job of a running service that has not written anything."""

from __future__ import annotations

from pathlib import Path

import click

from mavcal.service.commands.follow import show_came_of
from mavcal.service.commands.output import json_option, write_json
from mavcal.service.commands.place import CommandPlace
from mavcal.service.commands.remote import remote, service_at


@click.command()
@click.argument("job_id", metavar="JOB")
@remote
@json_option
def command(*, job_id: str, url: str, key_file: Path | None, as_json: bool) -> int:
    """Cancel a calibration, a fit or a diagnosis. Exit code 1 if it has ended, or has begun to write."""
    from mavcal.service.commands.screen import Screen

    with service_at(url, key_file) as client:
        job = client.cancel_job(job_id)
    show_came_of(job, Screen(CommandPlace(url=url, key_file=key_file)))
    if as_json:
        write_json(job.model_dump(mode="json"))
    return 0
