"""``mavcal follow JOB``: what happens to a job of a running service, until it ends or waits to be accepted."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcal.service.commands.output import EXIT_NO, EXIT_PART, json_option, write_json
from mavcal.service.commands.place import CommandPlace
from mavcal.service.commands.remote import remote
from mavcal.service.commands.whom import Whom

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.client.jobs import JobModel
    from mavcal.service.commands.screen import Screen


@click.command()
@click.argument("job_id", metavar="JOB")
@remote
@json_option
def command(*, job_id: str, url: str, key_file: Path | None, as_json: bool) -> int:
    """Show a job's prompts and progress; a line that is typed answers the present prompt.

    Ctrl-C ends the showing and leaves the job alone. Exit code 0: it succeeded, or its plan waits in review. 1: it
    ended otherwise, or its plan cannot be written. 3: as 0, but a sensor is left out.
    """
    from mavcal.service.commands.door import door
    from mavcal.service.commands.screen import Screen

    screen = Screen(CommandPlace(url=url, key_file=key_file))

    async def until_it_rests() -> JobModel:
        async with door(Whom(url=url, key_file=key_file)) as at:
            return await followed(at.client, job_id, screen)

    job = asyncio.run(until_it_rests())
    show_came_of(job, screen)
    if as_json:
        write_json(job.model_dump(mode="json"))
    if not came_well(job):
        return EXIT_NO
    return EXIT_PART if job.left_out else 0


async def followed(client: AsyncClient, job_id: str, screen: Screen) -> JobModel:
    """Show what happens to a job until it ends or waits for a person; typed lines answer its prompts."""
    from mavcal.client.events import StateEvent
    from mavcal.service.commands.headless import answering, rests, show_event
    from mavcal.service.commands.keyboard import keyboard

    job = await client.get_job(job_id)
    if rests(job):
        return job
    shown = None
    async with keyboard(answering(client, job_id, screen)):
        async for message in client.follow_job(job_id):
            event = message.data
            show_event(event.kind, event.data.model_dump(mode="json"), screen)
            if isinstance(event, StateEvent):
                if event.data.state != shown:  # a state is said once
                    shown = event.data.state
                    screen.line(f"    {shown.value}")
                job = await client.get_job(job_id)  # the event may be an old one
                if rests(job):
                    break
    return job


def came_well(job: JobModel) -> bool:
    """Whether the job has succeeded, or has a plan that waits and may be written."""
    from mavcal.client.enums import JobState as State

    waits = job.state == State.REVIEW and job.outcome is None and job.plan is not None and not job.plan.blockers
    return waits or job.state == State.SUCCEEDED


def show_came_of(job: JobModel, screen: Screen) -> None:
    """Print the state of the job and its reason."""
    outcome = job.outcome
    if outcome is None:
        text = f"its plan waits: `mavcal accept {job.id}` writes it" if job.plan is not None else ""
    elif outcome.kind == "result":
        text = outcome.text
    else:
        text = f"{outcome.cause} {outcome.remedy}"
    screen.line(f"{job.state.value}: {text}" if text else job.state.value, bold=True)
    for out in job.left_out:
        screen.line(f"left out: {out.sensor.value} {out.instance + 1}: {out.reason}")
