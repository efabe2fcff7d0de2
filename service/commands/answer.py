"""``mavcal answer JOB VALUE``: answer the prompt of a job of a running service."""

from __future__ import annotations

from pathlib import Path

import click

from mavcal.service.commands.output import json_option, write_json
from mavcal.service.commands.remote import remote, service_at


@click.command()
@click.argument("job_id", metavar="JOB")
@click.argument("value")
@remote
@json_option
def command(*, job_id: str, value: str, url: str, key_file: Path | None, as_json: bool) -> int:
    """Answer with `finish`, or with the number that is asked for. Exit code 1 if the prompt does not take it."""
    with service_at(url, key_file) as client:
        job = client.answer_job(job_id, value=value)
    if as_json:
        write_json(job.model_dump(mode="json"))
    return 0
