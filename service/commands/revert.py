"""``mavcal revert JOB``: take back what a job has written, where it still stands."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import click

from mavcal.service.commands.every import Acted, run_every
from mavcal.service.commands.headless import Begun
from mavcal.service.commands.output import json_option
from mavcal.service.commands.review import JobWish, job_of, run_job, taken_back, writable
from mavcal.service.commands.whom import Whom, whom_options

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.client.jobs import JobModel
    from mavcal.client.models import VehicleModel
    from mavcal.service.commands.door import Door
    from mavcal.service.commands.screen import Screen


@click.command()
@click.argument("job_id", metavar="[JOB]", required=False)
@whom_options(every=True, chosen=False)
@json_option
def command(
    *,
    whom: Whom,
    job_id: str | None,
    as_json: bool,
) -> int:
    """Put back the values that job JOB of this data directory, or of a running service, has replaced.

    With --all it takes back every write of each vehicle, the last one first.

    A parameter that somebody else has set since is left alone and named. Exit code 1 if a job was not taken back; a
    vehicle to which nothing was written is no failure.
    """
    if (job_id is None) != whom.every:
        raise click.UsageError("name the JOB, or give --all to take back every write of every vehicle")
    if whom.every:
        if whom.url is not None:
            raise click.UsageError("--all would take back what others wrote with this service: name the JOB")
        return run_every(whom, partial(_all_writes, wait=whom.wait_s), as_json=as_json)
    name = str(job_id)

    async def begin(client: AsyncClient, vehicle: VehicleModel) -> Begun:
        before = await job_of(client, name, whom, vehicle)
        await writable(client, vehicle, whom.wait_s)
        return Begun(await client.revert_job(name), before.updated_at, ours=False)

    return run_job(whom, begin, JobWish(write=True, as_json=as_json, revert=True), name)


async def _all_writes(door: Door, vehicle: VehicleModel, _screen: Screen, *, wait: float) -> Acted:
    """Take back every job that has written to this vehicle, the newest first: each finds the values that it wrote."""
    from mavcal.client.enums import JobState
    from mavcal.service.commands.hands_free import wait_for_job
    from mavcal.service.commands.headless import is_of, jobs_of

    client = door.client
    written = [job for job in await jobs_of(client, state=JobState.SUCCEEDED) if job.last_write is not None]
    ours = [job for job in sorted(written, key=lambda j: -j.updated_at) if await is_of(client, job, vehicle)]
    if not ours:
        text = "nothing was written to it by a job of this data directory"
        return Acted(good=True, text=text, document={"jobs": []})
    done: list[JobModel] = []
    for job in ours:
        await writable(client, vehicle, wait)
        await client.revert_job(job.id)
        done.append(await wait_for_job(client, job.id))
        if not taken_back(done[-1]):
            break  # an older one must not put values back over what is in doubt
    documents = [
        {"job": job.id, "kind": job.kind, "state": job.state.value, "text": _outcome_text(job)} for job in done
    ]
    lines = [f"job {job.id} ({job.kind}) is {job.state.value}: {_outcome_text(job)}" for job in done]
    waiting = [f"job {job.id} ({job.kind}) was not tried" for job in ours[len(done) :]]
    return Acted(taken_back(done[-1]), " ".join([*lines, *waiting]), {"jobs": documents})


def _outcome_text(job: JobModel) -> str:
    return "" if job.outcome is None else getattr(job.outcome, "text", "") or getattr(job.outcome, "cause", "")
