"""Lets commands ask a running service (``--url``) through the typed client, in place of a data directory."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from mavcal.service.commands.output import EXIT_USAGE, AnsweredNo, refused

if TYPE_CHECKING:
    from mavcal.client import AsyncClient, Client
    from mavcal.client.jobs import JobModel
    from mavcal.service.commands.screen import Screen

Command = TypeVar("Command", bound=Callable[..., Any])

DEFAULT_URL = "http://127.0.0.1:8765"

_key = click.option(
    "--key-file",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    default=None,
    help="File with the API key, where the service asks for one.",
)
_url = click.option("--url", default=None, metavar="URL", help=f"Ask the service that runs there, as {DEFAULT_URL}.")
_default_url = click.option(
    "--url", default=DEFAULT_URL, show_default=True, metavar="URL", help="Where the service runs."
)


def may_be_remote(command: Command) -> Command:
    """Add ``--url`` and ``--key-file`` to a command that can do without a service."""
    return _url(_key(command))


def remote(command: Command) -> Command:
    """Add ``--url`` and ``--key-file`` to a command that needs a service."""
    return _default_url(_key(command))


@contextmanager
def service_at(url: str, key_file: Path | None) -> Iterator[Client]:
    """A client of the service at `url`. Raises AnsweredNo for whatever it refuses."""
    from mavcal.client import Client

    with _noes(), Client(_address(url), key=_key_in(key_file)) as client:
        yield client


@asynccontextmanager
async def async_service_at(url: str, key_file: Path | None) -> AsyncIterator[AsyncClient]:
    """As :func:`service_at`, for asyncio."""
    from mavcal.client import AsyncClient

    with _noes():
        async with AsyncClient(_address(url), key=_key_in(key_file)) as client:
            yield client


async def followed(client: AsyncClient, job_id: str, screen: Screen, since: float = 0.0) -> JobModel:
    """Show what happens to a job until nothing goes on with it by itself; lines typed answer it.

    What happened up to the time `since` (s since 1970, by the clock of the service) is not shown.
    """
    from mavcal.client import ApiProblem
    from mavcal.client.events import StateEvent
    from mavcal.service.commands.headless import show_event
    from mavcal.service.commands.keyboard import keyboard

    async def answer(line: str) -> None:
        try:
            await client.answer_job(job_id, value=line)
        except ApiProblem as error:
            screen.line(f"    {error.detail}")

    job = await client.get_job(job_id)
    if rests(job):
        return job
    told = None
    async with keyboard(answer):
        async for message in client.follow_job(job_id):
            event = message.data
            if event.at > since:
                show_event(event.kind, event.data.model_dump(mode="json"), screen)
            if isinstance(event, StateEvent):
                if event.at > since and event.data.state != told:  # a state is said once
                    told = event.data.state
                    screen.line(f"    {told.value}")
                job = await client.get_job(job_id)  # the event may be an old one
                if rests(job):
                    break
    return job


def rests(job: JobModel) -> bool:
    """Whether nothing goes on with the job by itself: it has ended, or its plan waits to be accepted."""
    from mavcal.client.enums import JobState as State

    return job.state in {
        *(State.REVIEW, State.SUCCEEDED, State.REVERTED),
        *(State.FAILED, State.CANCELLED, State.INTERRUPTED),
    }


def came_well(job: JobModel) -> bool:
    """Whether the job has succeeded, or has a plan that waits and may be written."""
    from mavcal.client.enums import JobState as State

    waits = job.state == State.REVIEW and job.outcome is None and job.plan is not None and not job.plan.blockers
    return waits or job.state == State.SUCCEEDED


def show_came_of(job: JobModel, screen: Screen) -> None:
    """Where the job stands, and why."""
    outcome = job.outcome
    if outcome is None:
        said = f"its plan waits: `mavcal accept {job.id}` writes it" if job.plan is not None else ""
    elif outcome.kind == "result":
        said = outcome.text
    else:
        said = f"{outcome.cause} {outcome.remedy}"
    screen.line(f"{job.state.value}: {said}" if said else job.state.value, bold=True)
    for out in job.left_out:
        screen.line(f"left out: {out.sensor.value} {out.instance + 1}: {out.reason}")


def one_of(connect: str | None, url: str | None) -> None:
    """Raise UsageError unless either the vehicle or the service is named."""
    if (connect is None) == (url is None):
        raise click.UsageError("give --connect to write from here, or --url to have a running service write")


def _address(url: str) -> str:
    from urllib.parse import urlsplit

    try:
        parts = urlsplit(url)
        fine = parts.scheme in {"http", "https"} and bool(parts.hostname) and parts.port != 0
    except ValueError:
        fine = False
    if not fine:
        raise click.UsageError(f"--url {url!r} is no address of a service: write it as {DEFAULT_URL}")
    return url


def _key_in(file: Path | None) -> str | None:
    if file is None:
        return None
    try:
        key = file.read_text(encoding="ascii").strip()
    except (OSError, ValueError) as error:
        raise click.UsageError(f"--key-file {file} cannot be read: {error}") from None
    if len(key.split()) != 1:
        raise click.UsageError(f"--key-file {file} must hold one key and nothing else")
    return key


@contextmanager
def _noes() -> Iterator[None]:
    from mavcal.client import ApiProblem, UnexpectedAnswer, Unreachable

    try:
        yield
    except ApiProblem as error:
        raise refused(error) from None
    except Unreachable as error:
        raise AnsweredNo("unreachable", f"{error}; is `mavcal serve` running, and is --url its address?") from None
    except UnexpectedAnswer as error:
        raise AnsweredNo("unexpected-answer", str(error), EXIT_USAGE) from None
